"""Signs that a surface is leaving its cell."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from ...errors import listed
from ...geometry.mesh import Mesh


@dataclass(frozen=True)
class GrowthRules:
    """When a surface leaks, has shrunk to a point, or found nothing.

    Attributes
    ----------
    growth
        Times the area that the region's typical face grew: more than a sphere needs to become a cow
        (1.1), less than a cell that swallows a neighbour through a neck.
    point
        Widths of the PSF across: regions with less surface than such a sphere are no more than
        points, which say nothing about a shape (at 2.4 widths opposite membranes have one peak).
    explains_nothing
        Of the image: no more, and nothing was found.
    """

    growth: float = 2.5
    point: float = 3.0
    explains_nothing: float = 0.03


RULES = GrowthRules()


class GrowthAlarm:
    """Tells, once for each region, when its area has grown as only a leak makes it grow.

    A mesh that is attracted by a neighbour without a seed grows a neck and swallows it: some of its
    faces stretch a lot, most do not. A start that is merely too small stretches all alike.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._start = mesh.areas()
        self._before: dict[int, tuple[float, float]] = {}  # growth until the last remeshing
        self._told: set[int] = set()

    def remeshed(self, before: Mesh, after: Mesh) -> None:
        """Go on with other faces."""
        self._before = self._growth(before)
        self._start = after.areas()

    def check(self, mesh: Mesh) -> str:
        """A sentence for the user, or nothing."""
        grown = {
            region: total
            for region, (total, typical) in self._growth(mesh).items()
            if region not in self._told and total > RULES.growth * max(typical, 1.0)
        }
        self._told |= set(grown)
        if not grown:
            return ""
        cells = listed("cell", [f"{cell} ({ratio:.1f} times)" for cell, ratio in grown.items()])
        each = "each" if len(grown) > 1 else "the"
        return (
            f"the surface of {cells} has grown as if it leaked into a neighbour: "
            f"give {each} neighbour a seed, or start with less blur"
        )

    def _growth(self, mesh: Mesh) -> dict[int, tuple[float, float]]:
        """By region: growth of its area, and of its typical face."""
        areas, found = mesh.areas(), {}
        for region, rows in mesh.faces_by_region().items():
            own = rows[self._start[rows] > 0]
            if not len(own):
                continue
            total, typical = self._before.get(region, (1.0, 1.0))
            total *= float(areas[own].sum() / self._start[own].sum())
            found[region] = total, typical * float(np.median(areas[own] / self._start[own]))
        return found


def shrunken(mesh: Mesh, width: float) -> list[int]:
    """Regions with less surface than a sphere three widths of the PSF across, um: no more than
    points, which say nothing about a shape (at 2.4 widths opposite membranes have one peak)."""
    areas = mesh.areas()
    least = pi * (RULES.point * width) ** 2
    return [r for r, own in mesh.faces_by_region().items() if areas[own].sum() < least]


def why_stuck(explained: float, bounded: bool, points: list[int], cells: int) -> str:
    """What keeps a fit that has ended from being one, in plain words; empty where nothing does.

    explained : share of the image. bounded : whether the amplitude wanted to be negative. points :
    regions that are :func:`shrunken`, of so many cells. Some of them do not make the others worse.
    """
    if points and len(points) == cells:
        return f"stuck: {told_shrunken(points)}"
    if bounded or explained < RULES.explains_nothing:
        return (
            f"stuck: {explained:.0%} of the measured image is explained; "
            "do the seeds lie near bright membranes?"
        )
    return ""


def told_shrunken(points: list[int]) -> str:
    """A sentence about regions that are :func:`shrunken`; empty where none is."""
    if not points:
        return ""
    cells, has, it = listed("cell", points), "have", "them"
    if len(points) == 1:
        has, it = "has", "it"
    return f"{cells} {has} shrunk to a point: place {it} anew, or leave {it} out"
