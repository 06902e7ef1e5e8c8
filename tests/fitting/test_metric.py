"""The metric that descents start from."""

import numpy as np
import pytest

from napari_deltamic.fitting.model.shape import Shape
from napari_deltamic.fitting.model.variables import Variables
from napari_deltamic.fitting.objective.metric import Metric
from napari_deltamic.fitting.solvers.preconditioner import Preconditioners
from napari_deltamic.geometry import sphere

BALL = sphere((0, 0, 0), 1.0, subdivisions=1)
N = len(BALL.vertices)
OTHERS = np.zeros(2), np.zeros(2), np.zeros(1)  # insides, PSF, effects


def metric(model="smooth", fitted=True, pinned=None, stiffness=1.0, firmness=50.0, numbers=3):
    shape = Shape.begun(BALL, model)
    shape = shape if pinned is None else shape.with_pins(pinned)
    found = Metric(Preconditioners(), shape, 2.0, stiffness, firmness, 0.3, 1.0, fitted)
    a = np.random.default_rng(0).normal(size=(numbers, numbers))
    found.measure(a @ a.T + np.eye(numbers), np.array([4.0, 0.5]))
    return found


def dense(found, densities, scale=1.0):
    """The whole matrix: one column for each unknown."""
    zero = Variables(np.zeros((N, 3)), np.zeros(densities), *OTHERS)
    units = np.eye(len(zero.flat()))
    return np.stack([found.solve(zero.with_flat(e), scale).flat() for e in units], 1)


@pytest.mark.parametrize(("model", "densities"), [("smooth", N), ("interface", 1), ("uniform", 0)])
def test_it_is_symmetric_and_positive_definite(model, densities):
    matrix = dense(metric(model), densities)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(matrix).max())
    assert np.linalg.eigvalsh(matrix).min() > 0


def test_pinned_vertices_and_held_densities_stay():
    pinned = np.arange(N) < 5
    matrix = dense(metric(pinned=pinned, fitted=False), N)
    still = np.concatenate([np.repeat(pinned, 3), np.ones(N, bool), np.zeros(5, bool)])
    assert not matrix[still].any()
    assert not matrix[:, still].any()
    rest = matrix[np.ix_(~still, ~still)]
    assert np.linalg.eigvalsh(rest).min() > 0


def test_the_scale_is_that_of_the_surface_alone():
    found = metric()
    one, two = dense(found, N, 1.0), dense(found, N, 2.0)
    surface = 3 * N + N
    np.testing.assert_allclose(two[:surface], 2 * one[:surface], rtol=1e-12)
    np.testing.assert_array_equal(two[surface:], one[surface:])


def test_a_translation_moves_all_alike_and_a_stiff_surface_is_smoother():
    push = Variables(np.tile([1.0, 0, 0], (N, 1)), np.zeros(0), *OTHERS)
    rough = np.random.default_rng(1).normal(size=(N, 3))
    rough = Variables(rough - rough.mean(0), np.zeros(0), *OTHERS)
    kept = []
    for stiffness in (0.01, 1e6):
        found = metric("uniform", stiffness=stiffness)
        moved = found.solve(push, 1.0).vertices
        np.testing.assert_allclose(moved, np.tile(moved[0], (N, 1)), atol=1e-12)
        share = np.linalg.norm(found.solve(rough, 1.0).vertices) / np.linalg.norm(moved)
        kept.append(share)
    assert kept[1] < 0.1 * kept[0]


def test_where_the_image_says_nothing_it_stays_finite():
    assert np.isfinite(dense(metric(firmness=0.0), N)).all()
