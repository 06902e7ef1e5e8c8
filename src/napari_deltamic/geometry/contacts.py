"""Contacts: the only definition of what it means that two cells touch.

Two cells of a mesh touch if they share a wall, however small: a face with one of them on either
side. Cells whose separate membranes lie close to each other do not touch. Two labels touch where
faces of voxels lie between them; the caller decides how many make a contact. The outside is not a
cell.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .mesh import OUTSIDE, IntArray, Mesh
from .pairs import unique_pairs

# Up to this many possible pairs, a table counts the faces of each; beyond, they are sorted. Chosen:
# a table of 32 MB.
_MANY = 4_000_000

Pair = tuple[int, int]  # two regions, the smaller number first


def walls(mesh: Mesh) -> set[Pair]:
    """Return the pairs of regions with a face between them, including pairs with outside (0)."""
    return {(b, a) for a, b in mesh.interfaces()[0].tolist()}


def contacts(mesh: Mesh) -> set[Pair]:
    """Return the pairs of cells that touch."""
    return between_cells(walls(mesh))


def between_cells(pairs: Iterable[Pair]) -> set[Pair]:
    """Return the pairs of regions of which both are cells, each with the smaller number first."""
    return {(min(pair), max(pair)) for pair in pairs if OUTSIDE not in pair}


def wall_areas(mesh: Mesh) -> dict[Pair, float]:
    """Return the wall area (um^2) between each pair of regions, including the outside (0)."""
    pairs, wall = mesh.interfaces()
    areas = np.bincount(wall, mesh.areas(), len(pairs)).tolist()
    return {(b, a): area for (a, b), area in zip(pairs.tolist(), areas, strict=True)}


def contact_areas(mesh: Mesh) -> dict[Pair, float]:
    """Return the area (um^2) of each contact between cells."""
    return {pair: area for pair, area in wall_areas(mesh).items() if OUTSIDE not in pair}


def neighbours(mesh: Mesh) -> dict[int, list[int]]:
    """Return the sorted neighbours of each cell; an empty list for a cell that touches none."""
    found: dict[int, list[int]] = {region: [] for region in mesh.region_ids().tolist()}
    for a, b in sorted(contacts(mesh)):
        found[a].append(b)
        found[b].append(a)
    return {region: sorted(others) for region, others in found.items()}


def faces_of_voxels(
    labels: NDArray[np.integer], *images: NDArray[Any]
) -> Iterator[list[tuple[NDArray[Any], NDArray[Any]]]]:
    """Yield, for each axis, the values on both sides of the voxel faces between two labels.

    They are two (n,) arrays of the labels, then two of each image. The background (0) does not
    count as a label.
    """
    for axis in range(labels.ndim):
        lines = [np.moveaxis(values, axis, 0) for values in (labels, *images)]
        before, after = lines[0][:-1], lines[0][1:]
        meet = before != after
        meet &= np.minimum(before, after) > OUTSIDE
        yield [(values[:-1][meet], values[1:][meet]) for values in lines]


def label_contacts(labels: NDArray[np.integer]) -> tuple[IntArray, IntArray]:
    """Return (N, 2) pairs of touching labels, the smaller first, and (N,) the voxel faces between.

    The background (0) does not count as a label.
    """
    smaller, larger = [], []
    for [(a, b)] in faces_of_voxels(labels):
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
    """Return (n,) rows of edges in which three walls meet, and (n, 3) the sorted regions there."""
    face_edges = mesh.face_edges().reshape(-1)
    three = mesh.edge_uses() == 3
    slots = np.flatnonzero(three[face_edges])
    faces = slots[np.argsort(face_edges[slots], kind="stable")] // 3
    around = np.sort(mesh.regions[faces].reshape(-1, 6), axis=1)
    # Each of the three regions must bound two of the three faces; elsewhere the mesh is open.
    closed = (around[:, ::2] == around[:, 1::2]).all(1)
    return np.flatnonzero(three)[closed], around[closed, ::2]
