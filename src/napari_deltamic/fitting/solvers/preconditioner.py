"""Smoothing of a gradient over the surface: (I + lambda L)^-1, made once per connectivity."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor

from ...common.kept import Kept
from ...geometry.connected import adjacency
from ...geometry.mesh import Mesh
from .factors import MOST_HELD, Solve, on_host
from .polynomial_inverse import ROWS_A_PRODUCT, PolynomialInverse

# Weight of an edge that leaves a junction, where walls meet at an angle, once the surface is near:
# a wall moves with its junctions, but is not held straight across them. Lower ones were seen to
# leave slivers beside junctions; from afar, cells that do not move together swallow each other.
NEAR_JUNCTIONS = 0.3


class Preconditioner:
    """Solves (I + lambda L) x = b with the uniform Laplacian L = degree - adjacency.

    Edges that leave a junction, where three or more faces meet, can be made to weigh less, or the
    kink in an outer surface where a wall meets it would be rounded off for many iterations.

    Applying it twice to a gradient is the preconditioner of B. Nicolet, A. Jacobson, W. Jakob,
    "Large steps in inverse rendering of geometry", ACM Trans. Graph. 40, 2021. Small matrices and
    strong smoothing are solved by :mod:`.factors`, others by :mod:`.polynomial_inverse`.

    Parameters
    ----------
    mesh
        Its connectivity; positions do not matter.
    smoothing
        lambda; 0 leaves the gradient as it is.
    held
        (V,) bool: vertices where x is zero; around them it falls to zero smoothly.
    at_junctions
        Weight of edges that leave a junction.
    """

    def __init__(
        self,
        mesh: Mesh,
        smoothing: float,
        held: np.ndarray | None = None,
        at_junctions: float = 1.0,
    ) -> None:
        self.smoothing = smoothing
        self._held = None if held is None else torch.tensor(held[:, None])
        n = len(mesh.vertices)
        a = adjacency(mesh)
        if at_junctions != 1:
            a = _at_junctions(a, mesh, at_junctions)
        degree = np.asarray(a.sum(1)).ravel()
        matrix = (sp.eye(n) + smoothing * (sp.diags(degree) - a)).tocoo()
        if held is not None:
            # Their rows and columns become those of the identity: still symmetric.
            free = ~(held[matrix.row] | held[matrix.col]) | (matrix.row == matrix.col)
            matrix = sp.coo_matrix(
                (matrix.data[free], (matrix.row[free], matrix.col[free])), shape=(n, n)
            )
        self._solve = _solver(matrix)

    def solve(self, b: Tensor) -> Tensor:
        """(V, C) -> (V, C), float64."""
        if self._held is not None:
            b = torch.where(self._held, 0.0, b)
        return b if self.smoothing == 0 else self._solve(b)


class Preconditioners:
    """The preconditioners of the present triangles, each made once."""

    def __init__(self) -> None:
        self._faces = np.zeros((0, 3), np.int64)
        # Of displacements, of densities, and one of before; more are no use.
        self._made = Kept[Preconditioner](3)

    def of(
        self, mesh: Mesh, smoothing: float, held: np.ndarray | None, at_junctions: float
    ) -> Preconditioner:
        """See :class:`Preconditioner`."""
        if mesh.faces is not self._faces:
            self._faces = mesh.faces
            self._made.clear()
        key = smoothing, at_junctions, b"" if held is None else np.packbits(held).tobytes()
        return self._made.get(key, lambda: Preconditioner(mesh, smoothing, held, at_junctions))


def _solver(matrix: sp.coo_matrix) -> Solve:
    if matrix.shape[0] > MOST_HELD:
        inverse = PolynomialInverse(matrix, least=1.0)  # I and what has no negative eigenvalue
        if inverse.products <= matrix.shape[0] / ROWS_A_PRODUCT:
            return inverse
    return on_host(matrix)


def _at_junctions(a: sp.csr_matrix, mesh: Mesh, weight: float) -> sp.csr_matrix:
    junction = np.zeros(len(mesh.vertices), bool)
    junction[mesh.edges()[mesh.edge_uses() > 2]] = True
    if not junction.any():
        return a
    a = a.tocoo()
    leaves = junction[a.row] != junction[a.col]
    return sp.coo_matrix((np.where(leaves, weight, a.data), (a.row, a.col)), a.shape).tocsr()
