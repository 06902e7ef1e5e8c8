"""The bending energy of the lines where walls meet: a weak prior on their shape."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from .mesh import FloatArray, Mesh

_POINT = 1e-3  # share of the mean edge length: a shorter edge has no direction
# Share of the mean edge length. The energy divides by lengths: without a bound, the shortest edges
# would be held hardest, although their directions tell least about the line.
_SHORT = 0.5


class JunctionBending:
    """``1/2 width integral of k^2 ds`` along the junctions of a mesh, k being how much more they
    bend at a vertex than at its neighbours.

    That is the bending energy of a strip of wall of this width around each line, which the energy
    of walls leaves out: walls may meet at any angle, but lines of cells do not zigzag from vertex
    to vertex. At a vertex between edges of lengths l and m and directions t and u, a line bends by
    ``2 |u - t| / (l + m)`` over a length of (l + m) / 2 (M. Bergou et al., "Discrete elastic rods",
    2008, to first order in the angle). k is half the difference between that vector and the mean of
    those of both neighbours: all of it in a zigzag, none on a circle, such as the rim of a bubble.
    Where a vertex has no neighbour on its line, k is all of its bend. The energy has no unit.

    Parameters
    ----------
    mesh
        Only its connectivity and edge lengths are used. A vertex counts if exactly two of its edges
        belong to three faces or more; vertices where lines meet are free.
    width
        Of the strip, um.
    """

    def __init__(self, mesh: Mesh, width: float) -> None:
        self._count, self._width = len(mesh.vertices), width
        lines = mesh.edges()[mesh.edge_uses() > 2]
        ends = np.concatenate([lines, lines[:, ::-1]])
        ends = ends[np.argsort(ends[:, 0], kind="stable")]
        many = np.bincount(ends[:, 0], minlength=self._count)
        between = many[ends[:, 0]] == 2
        self._middle = ends[between][::2, 0]
        self._before, self._after = ends[between][::2, 1], ends[between][1::2, 1]
        self._weight = np.full(len(self._middle), self._width)
        if len(self._middle):
            _, _, first, second = self._directions(mesh.vertices_numpy())
            mean = float(np.concatenate([first, second]).mean())
            self._weight *= np.minimum(1.0, np.minimum(first, second) / (_SHORT * mean)) ** 2
        self._unlike = self._differences()

    def _differences(self) -> sp.csr_matrix:
        """Return (n, n) the matrix from bends to half their excess over the neighbours' mean."""
        n = len(self._middle)
        row = np.full(self._count, -1)
        row[self._middle] = np.arange(n)
        pairs = np.concatenate(
            [[row[self._before], row[self._middle]], [row[self._after], row[self._middle]]], 1
        )
        other, own = pairs[:, pairs[0] >= 0]
        near = np.bincount(own, minlength=n)
        values = np.concatenate([np.where(near > 0, 0.5, 1.0), -0.5 / near[own]])
        columns = np.concatenate([np.arange(n), other])
        return sp.csr_matrix((values, (np.concatenate([np.arange(n), own]), columns)), (n, n))

    def __call__(self, vertices: FloatArray) -> tuple[float, FloatArray]:
        """The energy and its gradient (V, 3) 1/um, at vertices (V, 3) um."""
        if not len(self._middle):
            return 0.0, np.zeros((self._count, 3))
        t, u, first, second = self._directions(vertices)
        whole = first + second
        turn = self._unlike @ (u - t)
        energies = self._weight * (turn**2).sum(1) / whole
        by_length = -(energies / whole)[:, None]
        by_turn = self._unlike.T @ ((2 * self._weight / whole)[:, None] * turn)
        by_first = _across(-by_turn, t) / first[:, None] + by_length * t
        by_second = _across(by_turn, u) / second[:, None] + by_length * u
        gradient = np.zeros((self._count, 3))
        np.add.at(gradient, self._before, -by_first)
        np.add.at(gradient, self._middle, by_first - by_second)
        np.add.at(gradient, self._after, by_second)
        return float(energies.sum()), gradient

    def curvature(self, vertices: FloatArray, directions: FloatArray) -> sp.csr_matrix:
        """Return (V, V) Gauss-Newton second derivatives, 1/um^2, as ``BendingEnergy`` does.

        vertices : (V, 3) um. directions : (V, 3) unit vectors along which vertices move.
        """
        _, _, first, second = self._directions(vertices)
        root = np.sqrt(2 * self._weight / (first + second))
        rows = np.arange(len(self._middle))
        values = np.concatenate([1 / first, -1 / first - 1 / second, 1 / second])
        columns = np.concatenate([self._before, self._middle, self._after])
        shape = len(rows), self._count
        turn = sp.coo_matrix((values, (np.tile(rows, 3), columns)), shape).tocsr()
        turn = sp.diags(root) @ self._unlike @ turn
        bend = (turn.T @ turn).tocoo()
        along = (directions[bend.row] * directions[bend.col]).sum(1)
        square = self._count, self._count
        return sp.coo_matrix((bend.data * along, (bend.row, bend.col)), square).tocsr()

    def _directions(
        self, vertices: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return unit vectors along the edges before and after each vertex, and their lengths."""
        one = vertices[self._middle] - vertices[self._before]
        two = vertices[self._after] - vertices[self._middle]
        first, second = (np.linalg.norm(e, axis=1) for e in (one, two))
        least = max(_POINT * float(np.concatenate([first, second, [0.0]]).mean()), 1e-300)
        first, second = np.maximum(first, least), np.maximum(second, least)
        return one / first[:, None], two / second[:, None], first, second


def _across(vectors: FloatArray, axis: FloatArray) -> FloatArray:
    """Return vectors (n, 3) without their components along unit vectors."""
    found: FloatArray = vectors - (vectors * axis).sum(1)[:, None] * axis
    return found
