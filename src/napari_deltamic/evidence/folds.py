"""Folds into a cell: where one label covers two cells, with a bright wall between them.

The fit has no wall to put there, so it folds the surface in until both sides of the fold form one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.triple import geometric_mean
from ..fitting.model.state import FitState
from ..geometry.mesh import OUTSIDE
from ..geometry.topology.thin_places import thin_places


@dataclass(frozen=True)
class FoldRules:
    """What counts as a fold.

    Attributes
    ----------
    narrow
        Largest distance between its sides, widths of the PSF: two membranes then look like one
        (C. M. Sparrow, 1916).
    share
        Least share of the cell's surface. Measured where labels of two cells were joined: 0.04 and
        0.05 (with insides, which are told as uneven, 0.01 and 0.02); in ten simulated tissues and
        cells with fingers at most 0.004, in a gland 0.02 to 0.04.
    """

    narrow: float = 2.0
    share: float = 0.04


RULES = FoldRules()


def folds(state: FitState) -> dict[int, tuple[float, float, float]]:
    """Where the largest fold of each cell is, (z, y, x) in um; cells without one are left out."""
    mesh, edge = state.mesh, state.mesh.median_edge()
    width = geometric_mean(state.optics.sigma_um)
    areas = mesh.areas()

    def folded(region: int, sides: tuple[int, ...]) -> bool:
        return len(sides) == 1 and sides[0] not in (OUTSIDE, region)

    places = thin_places(mesh, RULES.narrow * width, wanted=folded)
    found: dict[int, tuple[float, float, float]] = {}
    faces = mesh.faces_by_region()
    for place in sorted(places, key=lambda place: len(place.points)):  # the largest counts last
        (cell,) = place.sides
        # In a regular mesh, each vertex stands for an area of 0.87 edges squared.
        both = len(place.points) * np.sqrt(3) / 2 * edge**2
        if both > RULES.share * 2 * float(areas[faces[cell]].sum()):
            z, y, x = place.center.tolist()
            found[cell] = (z, y, x)
    return found
