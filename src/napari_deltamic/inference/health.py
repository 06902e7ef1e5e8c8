"""Signs that a surface is leaving its cell."""

from __future__ import annotations

import numpy as np

from ..geometry.mesh import Mesh

_GROWTH = 2.5  # times the area that the region's typical face grew: more than a sphere needs to
# become a cow (1.1), less than a cell that swallows a neighbour through a neck


class GrowthAlarm:
    """Tells, once for each region, when its area has grown as only a leak makes it grow.

    A mesh that is attracted by a neighbour without a seed grows a neck and swallows it: some of its
    faces stretch a lot, most do not. A start that is merely too small stretches all alike.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._start = mesh.areas()
        self._told: set[int] = set()

    def check(self, mesh: Mesh) -> str:
        """A sentence for the user, or nothing."""
        areas = mesh.areas()
        grown = {}
        for region in (int(r) for r in np.unique(mesh.regions) if r):
            own = (mesh.regions == region).any(1) & (self._start > 0)
            if region in self._told or not own.any():
                continue
            growth = areas[own].sum() / self._start[own].sum()
            typical = float(np.median(areas[own] / self._start[own]))
            if growth > _GROWTH * max(typical, 1.0):
                grown[region] = growth
        self._told |= set(grown)
        if not grown:
            return ""
        listed = ", ".join(f"{region} ({ratio:.1f} times)" for region, ratio in grown.items())
        return (
            f"the surface of region {listed} has grown as if it leaked into a neighbour: "
            "give the neighbour a seed, or start with less blur"
        )
