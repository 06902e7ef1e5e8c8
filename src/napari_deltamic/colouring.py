"""The colour of each region, the same in the viewer, the table and the pictures of a report."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from .geometry import Mesh
from .geometry.mesh import OUTSIDE

# Bright on grey, and far from each other also for the colour-blind.
COLOURS = (
    (255, 176, 0),
    (86, 180, 233),
    (255, 97, 136),
    (0, 214, 143),
    (240, 228, 66),
    (178, 132, 255),
    (255, 120, 40),
    (120, 255, 255),
)
_SHADES = ((0.45, 255), (0.45, 0))  # so much of white, or of black, in them
# The colours, then the same lighter and darker: only where a region has many neighbours.
PALETTE: tuple[tuple[int, int, int], ...] = COLOURS + tuple(
    (round(r + part * (to - r)), round(g + part * (to - g)), round(b + part * (to - b)))
    for part, to in _SHADES
    for r, g, b in COLOURS
)


def plain_index(region: int) -> int:
    """The place in the palette of a region without neighbours."""
    return (region - 1) % len(COLOURS)


def colour_indices(*meshes: Mesh) -> dict[int, int]:
    """Places in :data:`PALETTE`: no two regions that are neighbours in any mesh share one.

    Neighbours have a wall in common, or boxes that overlap, as vesicles that touch do. Each region
    keeps the colour of its number where it can. Where a region has more neighbours than there are
    colours, those with which it has no wall may share its own.
    """
    walls: dict[int, set[int]] = {}
    near: dict[int, set[int]] = {}
    regions: set[int] = set()
    for mesh in meshes:
        own, low, high = _boxes(mesh)
        regions |= set(own.tolist())
        sides = mesh.regions[(mesh.regions != OUTSIDE).all(axis=1)]
        _join(walls, np.unique(sides, axis=0))
        over = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=2)
        _join(near, own[np.argwhere(np.triu(over, 1))])
    found: dict[int, int] = {}
    for region in sorted(regions):
        found[region] = _free(region, found, walls.get(region, set()), near.get(region, set()))
    return found


def colour_of(region: int, indices: Mapping[int, int]) -> tuple[int, int, int]:
    """RGB of a region; that of its number where it is not among the indices."""
    return PALETTE[indices.get(region, plain_index(region))]


def _free(region: int, found: Mapping[int, int], walls: set[int], near: set[int]) -> int:
    order = [plain_index(region), *range(len(PALETTE))]
    for neighbours in (walls | near, walls):
        taken = {found[other] for other in neighbours if other in found}
        for index in order:
            if index not in taken:
                return index
    return plain_index(region)


def _join(graph: dict[int, set[int]], pairs: NDArray[np.int64]) -> None:
    for a, b in pairs.tolist():
        graph.setdefault(a, set()).add(b)
        graph.setdefault(b, set()).add(a)


def _boxes(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Regions (R,), and the corners of the boxes around them, (R, 3) each, um."""
    sides = np.concatenate([mesh.regions[:, 0], mesh.regions[:, 1]])
    corners = mesh.vertices_numpy()[np.concatenate([mesh.faces, mesh.faces])]
    order = np.argsort(sides, kind="stable")
    regions, starts = np.unique(sides[order], return_index=True)
    low = (
        np.minimum.reduceat(corners.min(axis=1)[order], starts) if len(starts) else np.zeros((0, 3))
    )
    high = np.maximum.reduceat(corners.max(axis=1)[order], starts) if len(starts) else low
    inside = regions != OUTSIDE
    return regions[inside], low[inside], high[inside]
