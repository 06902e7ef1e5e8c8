"""The colour of each region, the same in the viewer, the table and the pictures of a report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh
from ..geometry.contacts import contacts, label_contacts
from ..geometry.mesh import OUTSIDE
from ..runs.seed_checks import voxels_of

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
_SHADES = ((0.45, 255), (0.45, 0))  # share of white, or of black, mixed in
# The colours, then lighter and darker ones: used only where a region has many neighbours.
PALETTE: tuple[tuple[int, int, int], ...] = COLOURS + tuple(
    (round(r + part * (to - r)), round(g + part * (to - g)), round(b + part * (to - b)))
    for part, to in _SHADES
    for r, g, b in COLOURS
)

Graph = Mapping[int, set[int]]
_VOXELS = 2e6  # in larger arrays of labels, only every second, third... voxel is looked at


def plain_index(region: int) -> int:
    """Return the index in the palette of a region without neighbours."""
    return (region - 1) % len(COLOURS)


def colour_indices(*meshes: Mesh) -> dict[int, int]:
    """Return an index in :data:`PALETTE` for each region; neighbours in any mesh differ.

    Neighbours have a wall in common, or boxes that overlap, as vesicles that touch do. Each region
    keeps the colour of its number where it can. If a region has more neighbours than there are
    colours, those with which it shares no wall may have its colour.
    """
    walls: dict[int, set[int]] = {}
    near: dict[int, set[int]] = {}
    regions: set[int] = set()
    for mesh in meshes:
        own, low, high = _boxes(mesh)
        regions |= set(own.tolist())
        _join(walls, contacts(mesh))
        over = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=2)
        _join(near, own[np.argwhere(np.triu(over, 1))].tolist())
    return _chosen(sorted(regions), walls, near)


def label_indices(labels: NDArray[np.integer]) -> dict[int, int]:
    """Return the same for labels (Z, Y, X): labels that touch get different colours; 0 is no label.

    In a large array not all voxels are looked at: labels of a few voxels may be missed.
    """
    step = max(1, round(float(np.cbrt(labels.size / _VOXELS))))
    few = np.asarray(labels)[::step, ::step, ::step]
    walls: dict[int, set[int]] = {}
    _join(walls, label_contacts(few)[0].tolist())
    return _chosen(sorted(voxels_of(few)), walls, {})


def colour_of(region: int, indices: Mapping[int, int]) -> tuple[int, int, int]:
    """Return the RGB of a region; that of its number if it is not among the indices."""
    return PALETTE[indices.get(region, plain_index(region))]


def _chosen(regions: Sequence[int], walls: Graph, near: Graph) -> dict[int, int]:
    """Choose colours for ascending regions; those with a wall in common differ."""
    found: dict[int, int] = {}
    for region in regions:
        found[region] = _free(region, found, walls.get(region, set()), near.get(region, set()))
    if any(found[a] == found[b] for a in walls for b in walls[a]):
        # A cell with all colours around it: so it comes first, and its neighbours after it.
        found = {}
        for region in _smallest_last(regions, walls):
            found[region] = _free(region, found, walls.get(region, set()), set())
    return found


def _smallest_last(regions: Sequence[int], walls: Graph) -> list[int]:
    """Order regions so that each has few neighbours before it: about 13 in a foam of any size."""
    left = {region: set(walls.get(region, ())) for region in regions}
    order = []
    while left:
        least = min(left, key=lambda region: len(left[region]))
        order.append(least)
        for other in left.pop(least):
            left[other].discard(least)
    return order[::-1]


def _free(region: int, found: Mapping[int, int], walls: set[int], near: set[int]) -> int:
    order = [plain_index(region), *range(len(PALETTE))]
    for neighbours in (walls | near, walls):
        taken = {found[other] for other in neighbours if other in found}
        for index in order:
            if index not in taken:
                return index
    return plain_index(region)


def _join(graph: dict[int, set[int]], pairs: Iterable[Sequence[int]]) -> None:
    for a, b in pairs:
        graph.setdefault(a, set()).add(b)
        graph.setdefault(b, set()).add(a)


def _boxes(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return regions (R,) and the lowest and highest corners of their boxes, (R, 3) um each."""
    a, b, c = mesh.vertices_numpy()[mesh.faces.T]
    sides = np.concatenate([mesh.regions[:, 0], mesh.regions[:, 1]])
    order = np.argsort(sides, kind="stable")
    face = order % max(len(mesh.faces), 1)
    regions, starts = np.unique(sides[order], return_index=True)
    low = high = np.zeros((0, 3))
    if len(starts):
        low = np.minimum.reduceat(np.minimum(np.minimum(a, b), c)[face], starts)
        high = np.maximum.reduceat(np.maximum(np.maximum(a, b), c)[face], starts)
    inside = regions != OUTSIDE
    return regions[inside], low[inside], high[inside]
