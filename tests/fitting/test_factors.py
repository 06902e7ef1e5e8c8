"""Solvers: what stands in for cholespy, and where."""

import sys

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from scipy.sparse.linalg import splu

from napari_deltamic.fitting.solvers import factors
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.connected import adjacency


@pytest.fixture
def matrix():
    path = sp.diags([-np.ones(4), 3 * np.ones(5), -np.ones(4)], [-1, 0, 1])
    return path.tocoo()


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
