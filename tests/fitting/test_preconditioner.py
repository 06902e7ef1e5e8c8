import sys

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from napari_deltamic import Mesh
from napari_deltamic.fitting.paper_optimiser import AdamUniform
from napari_deltamic.fitting.solvers.preconditioner import Preconditioner
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.connected import adjacency, pieces


@pytest.fixture
def mesh():
    return sphere((0, 0, 0), 1, subdivisions=1)


@pytest.fixture
def gradient(mesh):
    return torch.from_numpy(np.random.default_rng(0).normal(size=mesh.vertices.shape))


@pytest.fixture(params=["cholespy", "scipy"])
def library(request, monkeypatch):
    """Each of the two factorisations."""
    if request.param == "scipy":
        monkeypatch.setitem(sys.modules, "cholespy", None)
    else:
        pytest.importorskip("cholespy")


def test_solves_with_the_uniform_laplacian(mesh, gradient, library):
    neighbours = np.zeros((len(mesh.vertices),) * 2)
    for a, b in mesh.edges():
        neighbours[a, b] = neighbours[b, a] = 1
    laplacian = np.diag(neighbours.sum(1)) - neighbours
    expected = np.linalg.solve(np.eye(len(neighbours)) + 7 * laplacian, gradient.numpy())
    assert_allclose(Preconditioner(mesh, 7).solve(gradient), expected, atol=1e-12)


def test_takes_any_layout(mesh, gradient, library):
    solver = Preconditioner(mesh, 3)
    expected = solver.solve(gradient)
    assert_allclose(solver.solve(gradient.T.contiguous().T), expected)
    assert_allclose(solver.solve(gradient[:, :1]), expected[:, :1])


def test_keeps_the_mean_and_smooths(mesh, gradient, library):
    smooth = Preconditioner(mesh, 50).solve(gradient)
    assert_allclose(smooth.mean(0), gradient.mean(0), atol=1e-12)
    assert smooth.std(0).max() < 0.1 * gradient.std(0).min()


def test_no_smoothing_leaves_the_gradient(mesh, gradient):
    assert_array_equal(Preconditioner(mesh, 0).solve(gradient), gradient)


def test_pieces_do_not_mix(mesh, library):
    two = Mesh.merge([mesh, mesh.translated((5, 0, 0))])
    n = len(mesh.vertices)
    gradient = torch.zeros(2 * n, 3, dtype=torch.float64)
    gradient[0] = 1
    assert_array_equal(Preconditioner(two, 10).solve(gradient)[n:], 0)


def test_vertices_of_no_face(mesh, library):
    loose = Mesh(np.vstack([mesh.vertices, [[9, 9, 9]]]), mesh.faces)
    gradient = torch.ones(len(loose.vertices), 3, dtype=torch.float64)
    assert_allclose(Preconditioner(loose, 10).solve(gradient), gradient)
    assert pieces(loose).max() == 1


def test_adjacency_counts_an_edge_once():
    # Two faces share an edge; a third uses it once more.
    mesh = Mesh(np.eye(5, 3), [[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    matrix = adjacency(mesh).toarray()
    assert_array_equal(matrix, matrix.T)
    assert set(np.unique(matrix)) == {0, 1}


# ------------------------------------------------------------------------------ AdamUniform


def test_the_first_step_has_size_one(gradient):
    adam = AdamUniform(np.zeros(len(gradient), int), 3)
    step = adam.step(1e-6 * gradient)
    assert_allclose(step.abs().max(), 1)
    # One scale for all: the direction field keeps its shape.
    assert_allclose(step, gradient / gradient.abs().max())


def test_steady_gradients_keep_the_step_at_one(gradient):
    adam = AdamUniform(np.zeros(len(gradient), int), 3)
    for _ in range(50):
        step = adam.step(gradient)
    assert_allclose(step.abs().max(), 1)


def test_one_piece_does_not_hold_back_another(gradient):
    pieces = np.arange(len(gradient)) % 2
    scale = torch.from_numpy(np.where(pieces == 0, 1.0, 1e-9)[:, None])
    step = AdamUniform(pieces, 3).step(scale * gradient)
    for piece in (0, 1):
        assert_allclose(step[pieces == piece].abs().max(), 1)


def test_no_gradient_no_step():
    step = AdamUniform(np.array([0, 0, 1]), 3).step(torch.zeros(3, 3, dtype=torch.float64))
    assert_array_equal(step, 0)
    assert AdamUniform(np.arange(0), 1).step(torch.zeros(0, 1)).shape == (0, 1)
