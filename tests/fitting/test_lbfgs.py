"""Limited-memory BFGS on objectives whose minimum is known."""

import numpy as np
import pytest

from napari_deltamic.fitting.solvers.lbfgs import Memory


def identity(gradient, scale):
    return scale * gradient


def quadratic(n=8):
    """Symmetric and positive definite, and where its least value lies."""
    rng = np.random.default_rng(0)
    q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return q @ np.diag(np.geomspace(1, 30, n)) @ q.T, rng.normal(size=n)


def descended(matrix, least, steps, memory=None):
    """Distances from the least, each step as long as the line asks for."""
    memory = Memory(identity, 1.0) if memory is None else memory
    x, found, free = np.zeros(len(least)), [], np.ones(len(least), bool)
    for _ in range(steps):
        gradient = matrix @ (x - least)
        way = memory.direction(gradient)
        step = -(gradient @ way) / (way @ matrix @ way) * way
        x = x + step
        memory.add(step, matrix @ step, free)
        found.append(np.linalg.norm(x - least) / np.linalg.norm(least))
    return found


def test_a_quadratic_is_minimised_in_as_many_steps_as_it_has_unknowns():
    found = descended(*quadratic(), 8)
    assert found[-1] < 1e-8
    assert found[4] > 1e-4  # or this shows nothing


def test_with_the_inverse_as_its_metric_one_step_suffices():
    matrix, least = quadratic()
    inverse = np.linalg.inv(matrix)
    memory = Memory(lambda gradient, scale: scale * inverse @ gradient, 1.0)
    assert descended(matrix, least, 1, memory)[0] < 1e-12


@pytest.mark.parametrize("curvature", [0.0, -1.0, np.nextafter(0, 1)])
def test_a_pair_without_curvature_is_dropped(curvature):
    memory = Memory(identity, 2.0)
    step = np.array([1.0, 0, 0])
    memory.add(step, np.array([curvature, 1.0, 0]), np.ones(3, bool))
    assert len(memory) == 0
    assert memory.scale == 2
    np.testing.assert_array_equal(memory.direction(step), -2 * step)


def test_a_direction_goes_down_whatever_was_seen():
    rng = np.random.default_rng(1)
    memory = Memory(identity, 1.0)
    for _ in range(40):
        memory.add(*rng.normal(size=(2, 6)), np.ones(6, bool))
        gradient = rng.normal(size=6)
        assert memory.direction(gradient) @ gradient < 0
    assert 0 < len(memory) <= 12


def test_the_last_pair_is_explained():
    """The secant equation: the direction for the change of the gradient is the step back."""
    memory = Memory(identity, 1.0)
    rng = np.random.default_rng(2)
    step = rng.normal(size=5)
    change = 3 * step + 0.1 * rng.normal(size=5)
    memory.add(step, change, np.ones(5, bool))
    np.testing.assert_allclose(memory.direction(change), -step, rtol=1e-6)


def test_the_scale_follows_the_free_unknowns_alone():
    memory = Memory(identity, 1.0)
    free = np.array([True, True, False])
    memory.add(np.array([1.0, 1.0, 1.0]), np.array([4.0, 4.0, 1e6]), free)
    assert memory.scale == pytest.approx(0.25)
    memory.forget()
    assert len(memory) == 0
    assert memory.scale == pytest.approx(0.25)


@pytest.mark.parametrize(("step", "change"), [(1e-47, 1.0), (1.0, 1e-47), (1.0, 1e40)])
def test_what_single_precision_cannot_hold_is_no_pair(step, change):
    """Else a direction was infinite: a fit of an image that told next to nothing failed."""
    memory = Memory(identity, 1.0)
    memory.add(np.full(3, step), np.full(3, change), np.ones(3, bool))
    assert np.isfinite(memory.direction(np.ones(3))).all()
    assert len(memory) == 0
