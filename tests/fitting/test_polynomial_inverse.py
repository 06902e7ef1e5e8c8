"""The metric of large meshes: a polynomial in place of a factorisation."""

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from numpy.testing import assert_allclose, assert_array_equal

from napari_deltamic.fitting.solvers import preconditioner
from napari_deltamic.fitting.solvers.polynomial_inverse import ERROR, PolynomialInverse
from napari_deltamic.fitting.solvers.preconditioner import Preconditioner
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.connected import adjacency

LARGE = sphere((0, 0, 0), 1, subdivisions=5)  # 10,242 vertices


def smoothing_matrix(smoothing):
    a = adjacency(sphere((0, 0, 0), 1, subdivisions=2))
    degree = np.asarray(a.sum(1)).ravel()
    return (sp.eye(a.shape[0]) + smoothing * (sp.diags(degree) - a)).tocoo()


def operator(inverse, n):
    return inverse(torch.eye(n, dtype=torch.float64)).numpy()


@pytest.mark.parametrize("error", [0.1, ERROR, 1e-6])
@pytest.mark.parametrize("smoothing", [0.1, 1.0, 30.0])
def test_is_the_inverse_within_what_was_asked(smoothing, error):
    matrix = smoothing_matrix(smoothing)
    found = operator(PolynomialInverse(matrix, 1.0, error), matrix.shape[0])
    left = np.eye(matrix.shape[0]) - matrix @ found
    assert np.abs(np.linalg.eigvalsh((left + left.T) / 2)).max() <= error * (1 + 1e-9)


def test_is_symmetric_positive_and_linear():
    matrix = smoothing_matrix(5.0)
    inverse = PolynomialInverse(matrix, 1.0)
    found = operator(inverse, matrix.shape[0])
    assert_allclose(found, found.T, atol=1e-12)
    assert np.linalg.eigvalsh(found).min() > 0
    b = torch.from_numpy(np.random.default_rng(0).normal(size=(matrix.shape[0], 3)))
    before = b.clone()
    assert_allclose(inverse(b).numpy(), found @ b.numpy(), atol=1e-12)
    assert_array_equal(b, before)


def test_of_the_identity():
    b = torch.ones((4, 2), dtype=torch.float64)
    assert_allclose(PolynomialInverse(sp.eye(4).tocoo(), 1.0)(b), b, rtol=ERROR)


@pytest.mark.parametrize(("smoothing", "factored"), [(0.1, False), (50.0, True)])
def test_strong_smoothing_and_small_meshes_are_factored(monkeypatch, smoothing, factored):
    made = []
    exact = preconditioner.on_host
    monkeypatch.setattr(preconditioner, "on_host", lambda m: made.append(m) or exact(m))
    Preconditioner(LARGE, smoothing)
    assert bool(made) == factored
    Preconditioner(sphere((0, 0, 0), 1, subdivisions=3), smoothing)
    assert len(made) == 1 + factored


def test_pinned_vertices_stay():
    held = np.zeros(len(LARGE.vertices), bool)
    held[:100] = True
    b = torch.ones((len(held), 1), dtype=torch.float64)
    moved = Preconditioner(LARGE, 0.1, held).solve(b).numpy()[:, 0]
    assert not moved[held].any()
    assert moved[~held].min() > 0.3
