"""Meshes with shared walls as Surface layers: each cell its own colour, up to where cells meet.

A layer has one value per vertex. Where walls meet, vertices belong to several of them, and colours
would run into one another; so such vertices are drawn several times, and joined again when the
layer is read.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ...geometry.pairs import unique_pairs
from .frame import OWN

COPIES = "copies"  # key under OWN: of which vertices those after the first V are copies


@dataclass(frozen=True, eq=False)
class Apart:
    """A mesh as it is drawn.

    mesh : of which this is true, as of others with its triangles.
    copies : (C,) vertices of the mesh that follow on its V vertices once more.
    faces : (F, 3), in the order in which they are drawn.
    order : (F,) which face of the mesh each of them is.
    sides : (V + C, 2) the two regions that each vertex drawn lies between, ascending.
    """

    mesh: Mesh
    copies: NDArray[np.int64]
    faces: NDArray[np.int64]
    order: NDArray[np.int64]
    sides: NDArray[np.int64]

    @classmethod
    def of(cls, mesh: Mesh) -> Apart:
        """A mesh with copies of the vertices at which surfaces between different regions meet."""
        n = len(mesh.vertices)
        sides = np.sort(mesh.regions, axis=1)
        pairs, pair = unique_pairs(sides)
        key = mesh.faces * len(pairs) + pair.reshape(-1, 1)
        keys, drawn = np.unique(key, return_inverse=True)
        vertex, which = np.divmod(keys, len(pairs))
        first = np.ones(len(keys), bool)
        first[1:] = vertex[1:] != vertex[:-1]
        number = np.where(first, vertex, n + np.cumsum(~first) - 1)
        copies = vertex[~first]
        between = np.zeros((n + len(copies), 2), np.int64)
        between[number] = pairs[which]
        faces = number[drawn.reshape(-1, 3)]
        order = np.arange(len(faces))
        return cls(mesh, copies, mesh.faces if not len(copies) else faces, order, between)

    def seen(self, chosen: Collection[int], mesh: Mesh, along: NDArray[np.float64]) -> Apart:
        """The same with the faces in the order in which a view along a direction needs them.

        Faces of the chosen regions come first; of the others, which are translucent, the nearest
        come first: they hide what lies behind, so that no place is seen through two of them.
        """
        if not chosen:
            return self
        own = np.isin(self.mesh.regions[self.order], list(chosen)).any(axis=1)
        depth = (mesh.vertices_numpy() @ along)[mesh.faces[self.order]].sum(axis=1)
        kept = np.lexsort((depth, ~own))
        return replace(self, faces=self.faces[kept], order=self.order[kept])

    def vertices(self, mesh: Mesh) -> NDArray[np.float32]:
        """(V + C, 3) float32."""
        vertices = mesh.vertices_numpy().astype(np.float32)
        return np.concatenate([vertices, vertices[self.copies]]) if len(self.copies) else vertices


def joined(
    vertices: NDArray[Any], faces: NDArray[Any], metadata: dict[str, Any]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Vertices and faces of a layer, without the copies noted in its metadata."""
    copies = metadata.get(OWN, {}).get(COPIES)
    n = len(vertices) - (0 if copies is None else len(copies))
    if copies is None or not len(copies) or n <= int(np.max(copies)):
        return vertices, faces
    if not np.array_equal(vertices[n:], vertices[copies]):
        return vertices, faces  # edited since
    return vertices[:n], np.where(faces < n, faces, copies[np.maximum(faces - n, 0)])
