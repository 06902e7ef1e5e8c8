"""Contacts: what it means that two cells touch, here and nowhere else.

Two cells of a mesh touch where they share a wall: a face has one on either side, however small the
wall is. Cells whose own membranes lie close to each other do not touch. Two labels touch where
faces of voxels lie between them; how many make a contact is for the caller to say. The outside is
no cell.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from .mesh import OUTSIDE, IntArray, Mesh
from .pairs import unique_pairs

# Pairs of numbers, which are counted by number rather than sorted; chosen: a table of 32 MB.
_MANY = 4_000_000

Pair = tuple[int, int]  # two regions, the smaller number first


def walls(mesh: Mesh) -> set[Pair]:
    """Pairs of regions with a face between them, those with the outside (0) included."""
    return {(b, a) for a, b in mesh.interfaces()[0].tolist()}


def contacts(mesh: Mesh) -> set[Pair]:
    """Pairs of cells that touch."""
    return between_cells(walls(mesh))


def between_cells(pairs: Iterable[Pair]) -> set[Pair]:
    """Those of some pairs of regions, in any order, that are contacts: both are cells."""
    return {(min(pair), max(pair)) for pair in pairs if OUTSIDE not in pair}


def wall_areas(mesh: Mesh) -> dict[Pair, float]:
    """um^2 between each pair of regions, the outside (0) included."""
    pairs, wall = mesh.interfaces()
    areas = np.bincount(wall, mesh.areas(), len(pairs)).tolist()
    return {(b, a): area for (a, b), area in zip(pairs.tolist(), areas, strict=True)}


def contact_areas(mesh: Mesh) -> dict[Pair, float]:
    """um^2 of each contact."""
    return {pair: area for pair, area in wall_areas(mesh).items() if OUTSIDE not in pair}


def neighbours(mesh: Mesh) -> dict[int, list[int]]:
    """The cells that each cell touches, in order; an empty list for those that touch none."""
    found: dict[int, list[int]] = {region: [] for region in mesh.region_ids().tolist()}
    for a, b in sorted(contacts(mesh)):
        found[a].append(b)
        found[b].append(a)
    return {region: sorted(others) for region, others in found.items()}


def label_contacts(labels: NDArray[np.integer]) -> tuple[IntArray, IntArray]:
    """Pairs (N, 2) of labels that touch, the smaller first, and the voxel faces between them (N,).

    Background (0) is no label.
    """
    smaller, larger = [], []
    for axis in range(labels.ndim):
        before, after = ((slice(None),) * axis + (s,) for s in (slice(None, -1), slice(1, None)))
        one, other = labels[before], labels[after]
        meet = one != other
        meet &= np.minimum(one, other) > OUTSIDE
        a, b = one[meet], other[meet]
        smaller.append(np.minimum(a, b))
        larger.append(np.maximum(a, b))
    low, high = (np.concatenate(side).astype(np.int64) for side in (smaller, larger))
    several = int(high.max(initial=0)) + 1
    if several**2 > _MANY:
        pairs, row = unique_pairs(np.stack([low, high], axis=1))
        return pairs, np.bincount(row, minlength=len(pairs)).astype(np.int64)
    faces = np.bincount(low * several + high)
    found = np.flatnonzero(faces)
    return np.stack(np.divmod(found, several), axis=1).astype(np.int64), faces[found]


def junction_edges(mesh: Mesh) -> tuple[IntArray, IntArray]:
    """Rows of the edges in which three walls meet, and the three regions around each, increasing.

    (n,) and (n, 3).
    """
    face_edges = mesh.face_edges().reshape(-1)
    three = mesh.edge_uses() == 3
    slots = np.flatnonzero(three[face_edges])
    faces = slots[np.argsort(face_edges[slots], kind="stable")] // 3
    around = np.sort(mesh.regions[faces].reshape(-1, 6), axis=1)
    # Each region is on one side of two of the faces; elsewhere the mesh is open.
    closed = (around[:, ::2] == around[:, 1::2]).all(1)
    return np.flatnonzero(three)[closed], around[closed, ::2]
