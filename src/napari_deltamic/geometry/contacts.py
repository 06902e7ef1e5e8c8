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
    met = []
    for axis in range(labels.ndim):
        moved = np.moveaxis(labels, axis, 0)
        beside = np.stack([moved[:-1].ravel(), moved[1:].ravel()], axis=1)
        met.append(beside[(beside[:, 0] != beside[:, 1]) & (beside > OUTSIDE).all(axis=1)])
    pairs, row = unique_pairs(np.sort(np.concatenate(met).astype(np.int64), axis=1))
    return pairs, np.bincount(row, minlength=len(pairs)).astype(np.int64)
