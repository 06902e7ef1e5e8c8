"""The ways in which the vertices of a surface change its shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ...geometry.mesh import FloatArray, IntArray, Mesh
from ..objective.convergence import vertex_normals

# Of the sum of squares of the normals of the walls that meet: what moves them by less is a move
# along a junction. Chosen: walls that meet at 26 degrees or more count as two, since 120 are usual.
_ACROSS = 0.05


@dataclass(frozen=True, eq=False)
class Directions:
    """One along the normal inside a wall, two across a junction, three where junctions meet.

    Attributes
    ----------
    vertex
        (D,) to which each belongs, increasing.
    way
        (D, 3) unit vectors.
    count
        Vertices.
    """

    vertex: IntArray
    way: FloatArray
    count: int

    @classmethod
    def of(cls, mesh: Mesh, vertices: FloatArray) -> Directions:
        """The directions of a mesh whose vertices are at (V, 3)."""
        normals = vertex_normals(vertices, mesh.faces)
        own: list[FloatArray] = [normal[None] for normal in normals]
        for number, across in _at_junctions(mesh, vertices).items():
            values, ways = np.linalg.eigh(across)
            own[number] = ways.T[values > _ACROSS * values.sum()]
        vertex = np.repeat(np.arange(len(own)), [len(ways) for ways in own])
        return cls(vertex.astype(np.int64), np.concatenate(own), len(own))

    def displaced(self, along: FloatArray) -> FloatArray:
        """(V, 3) of displacements (D,) along each."""
        each = along[:, None] * self.way
        sums = [np.bincount(self.vertex, each[:, k], self.count) for k in range(3)]
        return np.stack(sums, 1)

    def along(self, by_vertices: FloatArray) -> FloatArray:
        """(D,) of gradients or displacements (V, 3)."""
        found: FloatArray = (by_vertices[self.vertex] * self.way).sum(1)
        return found

    def restricted(self, matrix: sp.csr_matrix) -> sp.csr_matrix:
        """(D, D) of a matrix (V, V) that acts on each coordinate alike."""
        pick = sp.coo_matrix(
            (np.ones(len(self.vertex)), (self.vertex, np.arange(len(self.vertex)))),
            (self.count, len(self.vertex)),
        ).tocsr()
        found = (pick.T @ matrix @ pick).tocoo()
        turned = (self.way[found.row] * self.way[found.col]).sum(1)
        return sp.coo_matrix((found.data * turned, (found.row, found.col)), found.shape).tocsr()


def _at_junctions(mesh: Mesh, vertices: FloatArray) -> dict[int, FloatArray]:
    """(3, 3) sums of n n' over the walls that meet, for each vertex where more than one does."""
    _, wall = mesh.interfaces()
    corners = vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = len(vertices)
    keys, index = np.unique(np.repeat(wall, 3) * size + mesh.faces.ravel(), return_inverse=True)
    each = np.repeat(normal, 3, axis=0)
    sums = np.stack([np.bincount(index, each[:, k], len(keys)) for k in range(3)], 1)
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    sums = np.divide(sums, length, out=np.zeros_like(sums), where=length > 0)
    at = keys % size
    several = np.bincount(at, minlength=size)[at] > 1
    found: dict[int, FloatArray] = {}
    for vertex, n in zip(at[several].tolist(), sums[several], strict=True):
        found[vertex] = found.get(vertex, np.zeros((3, 3))) + np.outer(n, n)
    return found
