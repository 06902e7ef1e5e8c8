"""Solvers of a sparse symmetric system that is factored once: where the right-hand sides are."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache

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
_RIGHT = 1e-9  # largest residual of a solver that is trusted, of the right-hand side


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


def on_device(matrix: sp.coo_matrix, device: torch.device) -> Solve | None:
    """Triangular solves on a GPU (cholespy); None where they cannot be had.

    That package computes on the first GPU alone, ends the process where it does not find the
    driver under the name that it knows, and prints errors instead of raising them: hence the
    conditions, and the first solution is checked.
    """
    if device.type != "cuda" or device.index not in (None, 0) or not driver_is_found():
        return None
    try:
        from cholespy import CholeskySolverD, MatrixType

        entries = (torch.from_numpy(a).to(device) for a in _entries(matrix))
        solver = CholeskySolverD(matrix.shape[0], *entries, MatrixType.COO)
    except (ImportError, TypeError, ValueError, RuntimeError):
        return None

    def solved(b: Tensor) -> Tensor:
        b = b.detach().to(torch.float64).contiguous()
        x = torch.zeros_like(b)
        with _default_stream(device):
            solver.solve(b, x)
        return x

    return solved if _is_right(solved, matrix, device) else None


def _is_right(solve: Solve, matrix: sp.coo_matrix, device: torch.device) -> bool:
    b = np.cos(np.arange(3.0 * matrix.shape[0])).reshape(-1, 3)
    x = solve(torch.from_numpy(b).to(device)).cpu().numpy()
    return bool(np.abs(matrix @ x - b).max(initial=0.0) <= _RIGHT)


# The name under which cholespy asks for the driver; not every system has it, Windows never.
DRIVER = "cuda.dll" if sys.platform == "win32" else "libcuda.so"


@cache
def driver_is_found() -> bool:
    """Whether cholespy finds the driver."""
    try:
        ctypes.CDLL(DRIVER)
    except OSError:
        return False
    return True


@contextmanager
def _default_stream(device: torch.device) -> Iterator[None]:
    """cholespy computes on the default stream, which does not wait for torch's others."""
    current, default = torch.cuda.current_stream(device), torch.cuda.default_stream(device)
    if current == default:
        yield
        return
    default.wait_stream(current)
    yield
    current.wait_stream(default)
