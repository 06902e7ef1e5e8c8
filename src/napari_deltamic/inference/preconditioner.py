"""Smoothing of a gradient over the surface: (I + lambda L)^-1, factored once per connectivity."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from ..geometry.mesh import Mesh


def adjacency(mesh: Mesh) -> sp.csr_matrix:
    """(V, V) 0/1 matrix of the mesh's edges."""
    edges = mesh.edges()
    n = len(mesh.vertices)
    ones = np.ones(len(edges))
    half = sp.coo_matrix((ones, (edges[:, 0], edges[:, 1])), shape=(n, n))
    return (half + half.T).tocsr()


def components(mesh: Mesh) -> np.ndarray:
    """(V,) number of the connected piece that each vertex belongs to."""
    return connected_components(adjacency(mesh), directed=False)[1]


class Preconditioner:
    """Solves (I + lambda L) x = b with the uniform Laplacian L = degree - adjacency.

    Applying it twice to a gradient is the preconditioner of B. Nicolet, A. Jacobson, W. Jakob,
    "Large steps in inverse rendering of geometry", ACM Trans. Graph. 40, 2021. Sparse Cholesky
    (cholespy); SciPy's LU where that package is missing.

    Parameters
    ----------
    mesh
        Its connectivity; positions do not matter.
    smoothing
        lambda; 0 leaves the gradient as it is.
    held
        (V,) bool: vertices where x is zero; around them it falls to zero smoothly.
    """

    def __init__(self, mesh: Mesh, smoothing: float, held: np.ndarray | None = None) -> None:
        self.smoothing = smoothing
        self._held = held
        n = len(mesh.vertices)
        a = adjacency(mesh)
        degree = np.asarray(a.sum(1)).ravel()
        matrix = (sp.eye(n) + smoothing * (sp.diags(degree) - a)).tocoo()
        if held is not None:
            # Their rows and columns become those of the identity: still symmetric.
            free = ~(held[matrix.row] | held[matrix.col]) | (matrix.row == matrix.col)
            matrix = sp.coo_matrix(
                (matrix.data[free], (matrix.row[free], matrix.col[free])), shape=(n, n)
            )
        self._solve = _cholesky(matrix) or splu(matrix.tocsc(), permc_spec="COLAMD").solve

    def solve(self, b: np.ndarray) -> np.ndarray:
        """(V, C) -> (V, C), float64."""
        if self._held is not None:
            b = np.where(self._held[:, None], 0.0, b)
        if self.smoothing == 0:
            return b
        return self._solve(np.ascontiguousarray(b, dtype=np.float64))


def _cholesky(matrix: sp.coo_matrix):  # type: ignore[no-untyped-def]
    try:
        from cholespy import CholeskySolverD, MatrixType
    except ImportError:
        return None
    solver = CholeskySolverD(
        matrix.shape[0],
        matrix.row.astype(np.int32),
        matrix.col.astype(np.int32),
        matrix.data.astype(np.float64),
        MatrixType.COO,
    )

    def solve(b: np.ndarray) -> np.ndarray:
        x = np.zeros_like(b)
        solver.solve(b, x)
        return x

    return solve
