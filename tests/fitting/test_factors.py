"""Solvers on a device: what stands in for cholespy's there, and when it is not trusted."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from scipy.sparse.linalg import splu, spsolve

from napari_deltamic.fitting import factors
from napari_deltamic.fitting.preconditioner import adjacency
from napari_deltamic.geometry import sphere

GPU = torch.device("cuda", 0)


class FakeSolver:
    """cholespy's for a GPU: it takes tensors and writes the solution into the second."""

    wrong = 0.0

    def __init__(self, n, rows, columns, entries, kind):
        assert all(isinstance(t, torch.Tensor) for t in (rows, columns, entries))
        assert rows.dtype == columns.dtype == torch.int32
        self.matrix = sp.coo_matrix((entries.numpy(), (rows.numpy(), columns.numpy())), (n, n))

    def solve(self, b, x):
        assert b.is_contiguous()
        x.copy_(torch.from_numpy(spsolve(self.matrix.tocsc(), b.numpy())) + self.wrong)


@pytest.fixture
def matrix():
    path = sp.diags([-np.ones(4), 3 * np.ones(5), -np.ones(4)], [-1, 0, 1])
    return path.tocoo()


@pytest.fixture
def cholespy(monkeypatch):
    """A cholespy for GPUs, whose tensors are on the CPU."""
    package = SimpleNamespace(CholeskySolverD=FakeSolver, MatrixType=SimpleNamespace(COO=0))
    monkeypatch.setitem(sys.modules, "cholespy", package)
    monkeypatch.setattr(factors, "driver_is_found", lambda: True)
    to = torch.Tensor.to
    monkeypatch.setattr(torch.Tensor, "to", lambda t, *a: t if a == (GPU,) else to(t, *a))
    monkeypatch.setattr(torch.cuda, "current_stream", lambda device: 0)
    monkeypatch.setattr(torch.cuda, "default_stream", lambda device: 0)


def test_without_cholespy_the_solution_is_the_same(monkeypatch):
    mesh = sphere((0, 0, 0), 3.0, subdivisions=3)
    a, n = adjacency(mesh), len(mesh.vertices)
    matrix = (sp.eye(n) + 20.0 * (sp.diags(np.asarray(a.sum(1)).ravel()) - a)).tocoo()
    b = torch.from_numpy(np.random.default_rng(0).normal(size=(n, 3)))
    with_it = factors.on_host(matrix)(b)
    monkeypatch.setitem(sys.modules, "cholespy", None)
    found = factors.on_host(matrix)(b)
    torch.testing.assert_close(found, with_it, rtol=1e-12, atol=1e-13)
    # An ordering for any matrix fills in more than twice as much.
    made = []
    monkeypatch.setattr(factors, "splu", lambda *a, **k: made.append(splu(*a, **k)) or made[0])
    factors.on_host(matrix)
    assert made[0].nnz < 0.7 * splu(matrix.tocsc(), permc_spec="COLAMD").nnz


@pytest.mark.parametrize("large", [False, True])
def test_a_large_matrix_does_not_hold_up_the_window(matrix, monkeypatch, large):
    made = []
    monkeypatch.setattr(factors, "_cholesky", lambda matrix: made.append(matrix))
    monkeypatch.setattr(factors, "MOST_HELD", 4 if large else 5)
    b = torch.arange(15.0, dtype=torch.float64).reshape(5, 3)
    torch.testing.assert_close(torch.from_numpy(matrix @ factors.on_host(matrix)(b).numpy()), b)
    assert bool(made) != large


def test_solves_on_the_device(matrix, cholespy):
    b = torch.randn(3, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).T
    found = factors.on_device(matrix, GPU)(b)
    torch.testing.assert_close(found, torch.from_numpy(spsolve(matrix.tocsc(), b.numpy())))


def test_a_solver_that_errs_is_not_trusted(matrix, cholespy, monkeypatch):
    """It prints errors of the driver, and goes on with what it has."""
    monkeypatch.setattr(FakeSolver, "wrong", 1e-6)
    assert factors.on_device(matrix, GPU) is None


def test_it_computes_on_the_first_gpu_alone(matrix, cholespy):
    assert factors.on_device(matrix, torch.device("cuda", 1)) is None
    assert factors.on_device(matrix, torch.device("cpu")) is None


def test_without_the_driver_by_its_name_it_is_not_called(matrix, monkeypatch):
    """It would end the process."""

    def absent(name):
        raise OSError(name)

    monkeypatch.setattr(factors.ctypes, "CDLL", absent)
    factors.driver_is_found.cache_clear()
    assert factors.on_device(matrix, GPU) is None
    factors.driver_is_found.cache_clear()


def test_other_streams_wait_for_the_default_one_and_back(monkeypatch):
    waits = []

    class Stream:
        def __init__(self, name):
            self.name = name

        def wait_stream(self, other):
            waits.append((self.name, other.name))

    monkeypatch.setattr(torch.cuda, "current_stream", lambda device: Stream("own"))
    monkeypatch.setattr(torch.cuda, "default_stream", lambda device: Stream("default"))
    with factors._default_stream(GPU):
        assert waits == [("default", "own")]
    assert waits[1:] == [("own", "default")]
