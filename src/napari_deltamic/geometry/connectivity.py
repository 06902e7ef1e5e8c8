"""Which vertices a mesh's faces join, which regions they separate, and what follows from that."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from ..errors import InputError
from .arrays import IntArray, checked_integers
from .pairs import unique_pairs

OUTSIDE = 0
LARGEST_REGION = 1 << 40  # so that pairs of regions and edges have a number


class Connectivity:
    """Checked faces and regions; shared between meshes that differ only in where vertices are."""

    def __init__(self, faces: Any, regions: Any, n_vertices: int) -> None:
        self.n_vertices = n_vertices
        self.faces = checked_integers(faces, 3, "faces")
        if len(self.faces) == 0:
            raise InputError("the mesh is empty: it has no faces")
        low, high = int(self.faces.min()), int(self.faces.max())
        if low < 0 or high >= n_vertices:
            bad = low if low < 0 else high
            raise InputError(
                f"a face refers to vertex {bad}, but the mesh has vertices 0 to {n_vertices - 1}"
            )
        if regions is None:
            self.regions: IntArray = np.tile(np.array([1, OUTSIDE]), (len(self.faces), 1))
        else:
            self.regions = checked_integers(regions, 2, "regions")
        if len(self.regions) != len(self.faces):
            raise InputError(
                f"regions must have one row per face: {len(self.regions)} rows, "
                f"{len(self.faces)} faces"
            )
        if self.regions.min() < 0:
            raise InputError("region numbers must be 0 (outside) or positive")
        if self.regions.max() >= LARGEST_REGION:
            raise InputError(f"region {self.regions.max()} is too large a number")
        n_same = int((self.regions[:, 0] == self.regions[:, 1]).sum())
        if n_same:
            raise InputError(f"{n_same} faces have the same region on both sides")

    @cached_property
    def region_ids(self) -> IntArray:
        """Sorted region numbers, without the outside."""
        ids = self.ranks[0]
        return ids[ids != OUTSIDE]

    @cached_property
    def ranks(self) -> tuple[IntArray, IntArray]:
        """Sorted region numbers, with the outside if it is there; (F, 2) of both regions' place."""
        ids, rank = np.unique(self.regions, return_inverse=True)
        return ids, rank.reshape(-1, 2)

    @cached_property
    def faces_by_region(self) -> dict[int, IntArray]:
        """Increasing rows of the faces of each region, by its number; one pass for all regions."""
        sides = self.regions.ravel()
        order = np.argsort(sides, kind="stable")
        ids, first = np.unique(sides[order], return_index=True)
        rows = np.split(order // 2, first[1:])
        return {int(k): own for k, own in zip(ids, rows, strict=True) if k != OUTSIDE}

    @cached_property
    def interfaces(self) -> tuple[IntArray, IntArray]:
        """(P, 2) pairs of regions that share faces, and (F,) the row of each face's pair."""
        # Larger number first, so that both ways of writing a wall are one interface.
        return unique_pairs(np.sort(self.regions, axis=1)[:, ::-1])

    @cached_property
    def edges(self) -> tuple[IntArray, IntArray]:
        """(E, 2) edges, and (F, 3) the row of the edge opposite each corner."""
        corners = np.sort(self.faces[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2), axis=1)
        keys, index = np.unique(
            corners[:, 0] * self.n_vertices + corners[:, 1], return_inverse=True
        )
        edges = np.column_stack(np.divmod(keys, self.n_vertices)).astype(np.int64)
        return edges, index.reshape(-1, 3).astype(np.int64)

    @cached_property
    def edge_uses(self) -> IntArray:
        """(E,) number of faces that each edge belongs to."""
        edges, by_face = self.edges
        return np.bincount(by_face.ravel(), minlength=len(edges))

    @cached_property
    def open_regions(self) -> IntArray:
        """Numbers of the regions with an edge that an odd number of their faces share."""
        face_edges = self.edges[1]
        keys = np.concatenate(
            [(self.regions[:, side, None] * len(self.edges[0]) + face_edges) for side in (0, 1)]
        )
        keys, counts = np.unique(keys, return_counts=True)
        ids = np.unique(keys[counts % 2 == 1] // len(self.edges[0]))
        return ids[ids != OUTSIDE].astype(np.int64)
