"""Signs that a surface is leaving its cell."""

from __future__ import annotations

import numpy as np

from ..geometry.mesh import Mesh

_GROWTH = 2.5  # times the starting area: more than a sphere needs to become a cow


class GrowthAlarm:
    """Tells, once for each region, when its area has grown as only a leak makes it grow.

    A mesh that is attracted by a neighbour without a seed grows a neck and swallows it.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._start = _areas(mesh)
        self._told: set[int] = set()

    def check(self, mesh: Mesh) -> str:
        """A sentence for the user, or nothing."""
        grown = {
            region: area / self._start[region]
            for region, area in _areas(mesh).items()
            if region not in self._told and area > _GROWTH * self._start[region]
        }
        self._told |= set(grown)
        if not grown:
            return ""
        listed = ", ".join(f"{region} ({ratio:.1f} times)" for region, ratio in grown.items())
        return (
            f"the surface of region {listed} has grown as if it leaked into a neighbour: "
            "give the neighbour a seed, or start with less blur"
        )


def _areas(mesh: Mesh) -> dict[int, float]:
    areas = mesh.areas()
    return {
        int(r): float(areas[(mesh.regions == r).any(1)].sum()) for r in np.unique(mesh.regions) if r
    }
