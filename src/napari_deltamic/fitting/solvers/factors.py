"""Solvers of a sparse symmetric system that is factored once: where the right-hand sides are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
import torch
from scipy.sparse.linalg import splu
from torch import Tensor

Solve = Callable[[Tensor], Tensor]  # (V, C) -> (V, C), float64, on the same device

# cholespy lets no other thread of Python run while it factors, and a window stands still, measured:
# 0.06 s at so many rows, 0.13 s at 9,600 and 0.3 s at 17,000 (a core of 2.1 GHz). SciPy's LU lets
# them, and takes a third less; its solutions take twice as long, which is little: 4 ms at 9,600.
MOST_HELD = 6000


def on_host(matrix: sp.coo_matrix) -> Solve:
    """Sparse Cholesky (cholespy), or SciPy's LU where the matrix is large or that package missing.

    Measured by ``benchmarks.fallback``.
    """
    solve = (_cholesky(matrix) if matrix.shape[0] <= MOST_HELD else None) or _lu(matrix)

    def solved(b: Tensor) -> Tensor:
        given = np.ascontiguousarray(b.detach().cpu().numpy(), dtype=np.float64)
        return torch.from_numpy(solve(given)).to(b.device)

    return solved


def _lu(matrix: sp.coo_matrix) -> Callable[[np.ndarray], np.ndarray]:
    # Orders as for a symmetric matrix, without pivots: half the fill, and half the time.
    lu = splu(
        matrix.tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    return lu.solve


def _cholesky(matrix: sp.coo_matrix) -> Callable[[np.ndarray], np.ndarray] | None:
    try:
        from cholespy import CholeskySolverD, MatrixType
    except ImportError:
        return None
    solver = CholeskySolverD(matrix.shape[0], *_entries(matrix), MatrixType.COO)

    def solve(b: np.ndarray) -> np.ndarray:
        x = np.zeros_like(b)
        solver.solve(b, x)
        return x

    return solve


def _entries(matrix: sp.coo_matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows, columns = matrix.row.astype(np.int32), matrix.col.astype(np.int32)
    return rows, columns, matrix.data.astype(np.float64)
