"""Line segments and points: known transforms, quadrature, gradients, bad input."""

import mpmath
import numpy as np
import pytest
import torch
from any_wavevectors import filament_ft, point_ft
from numpy.testing import assert_allclose

import napari_deltamic as nd
from napari_deltamic.fourier.filament import (
    make_line_plan,
    path_segments,
)

RNG = np.random.default_rng(0)
PATH = np.cumsum(RNG.normal(size=(6, 3)), 0)
XI = RNG.normal(size=(12, 3)) * np.geomspace(1e-9, 40, 12)[:, None]
GRID = ((30, 32, 31), (0.1, 0.1, 0.1), (0.2, 0.2, 0.2))


def exact_segment(a, b, xi):
    """L exp(-i m.xi) sin(h)/h to 50 digits."""
    with mpmath.workdps(50):
        a, b, x = ([mpmath.mpf(float(k)) for k in p] for p in (a, b, xi))
        along = [q - p for p, q in zip(a, b, strict=True)]
        middle = [(p + q) / 2 for p, q in zip(a, b, strict=True)]
        h = mpmath.fdot(along, x) / 2
        share = mpmath.sin(h) / h if h else mpmath.mpf(1)
        length = mpmath.sqrt(mpmath.fdot(along, along))
        return complex(length * share * mpmath.expj(-mpmath.fdot(middle, x)))


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ((0, 0, 0), (0, 0, 2.0)),  # along an axis, at the origin
        ((1, 2, 3), (1, 2, 3 + 1e-9)),  # tiny
        ((-1e3, 5, 2), (2e3, 1, 0)),  # huge
        ((1e5, -1e5, 1e5), (1e5, -1e5, 1e5 + 1)),  # far from the origin
        ((0.3, 0.2, 0.1), (0.5, -0.4, 1.9)),
    ],
)
def test_a_segment_keeps_to_the_bar(a, b):
    u = filament_ft(np.array([a, b], float), [[0, 1]], XI).numpy()
    exact = np.array([exact_segment(a, b, xi) for xi in XI])
    phase = np.abs(XI) @ np.abs(np.array([a, b], float)).max(0)
    length = np.linalg.norm(np.subtract(b, a))
    assert (np.abs(u - exact) / length < np.maximum(1e-12, 4 * 2.0**-52 * phase)).all()


def test_zero_wavevector_gives_length_and_sum():
    w = RNG.uniform(0.5, 2, 5)
    length = np.linalg.norm(np.diff(PATH, axis=0), axis=1)
    zero = np.zeros((1, 3))
    assert filament_ft(PATH, path_segments(6), zero, w).item() == pytest.approx(length @ w)
    assert point_ft(PATH[:5], zero, w).item() == pytest.approx(w.sum())


def test_points_are_phases():
    w = RNG.uniform(0.5, 2, 6)
    assert_allclose(point_ft(PATH, XI, w), np.exp(-1j * XI @ PATH.T) @ w, atol=1e-12)


def test_a_filament_in_parts_is_the_same():
    middle = (PATH[:-1] + PATH[1:]) / 2
    finer = np.empty((11, 3))
    finer[::2], finer[1::2] = PATH, middle
    assert_allclose(
        filament_ft(finer, path_segments(11), XI), filament_ft(PATH, path_segments(6), XI),
        atol=1e-13,
    )  # fmt: skip


def test_gradients():
    v = torch.tensor(PATH, requires_grad=True)
    w = torch.tensor(RNG.uniform(0.5, 2, 5), requires_grad=True)
    xi = XI[4:9]
    assert torch.autograd.gradcheck(lambda v, w: filament_ft(v, path_segments(6), xi, w), (v, w))
    assert torch.autograd.gradcheck(lambda v, w: point_ft(v[:5], xi, w), (v, w))


def test_no_length_gives_nothing_and_pulls_nothing():
    v = torch.ones(2, 3, dtype=torch.float64, requires_grad=True)
    u = filament_ft(v, [[0, 1]], XI)
    (gradient,) = torch.autograd.grad(u.real.sum() + u.imag.sum(), v)
    assert not u.any()
    assert not gradient.any()


def test_a_path_needs_two_vertices():
    assert path_segments(4).tolist() == [[0, 1], [1, 2], [2, 3]]
    assert path_segments(2).tolist() == [[0, 1]]
    with pytest.raises(nd.InputError, match="two vertices or more"):
        path_segments(1)


@pytest.mark.parametrize("accuracy", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("length", [0.01, 0.5, 30.0])
def test_both_ways_agree_on_a_band(accuracy, length):
    """Short segments take one point, long ones many; both within what was asked."""
    v = np.array([[1.0, 1.2, 1.1], [1.0, 1.2, 1.1]]) + length * np.array([[0, 0, 0], [0.1, 0.2, 1]])
    segments = path_segments(2)
    boxes = []
    for method in ("closed form", "particle-mesh"):
        plan = make_line_plan(v, segments, *GRID, accuracy, method)
        boxes.append(plan.transform(torch.tensor(v), torch.tensor(segments), torch.ones(1)))
    z, y, x = plan.band.axes()
    otf = torch.exp(-0.5 * 0.2**2 * (z**2 + y**2 + x**2))
    exact, other = (box * otf for box in boxes)
    assert float((exact - other).norm() / exact.norm()) < accuracy
    assert plan.work.points > 0


def test_longer_segments_take_more_points():
    assert points(0.01) < points(0.5) < points(5.0) < 60


def points(length, **more):
    """How many a segment takes."""
    v = np.array([[0, 0, 0], [0, 0, length]])
    plan = make_line_plan(v, path_segments(2), *GRID, 1e-3, **more)
    return sum(len(rule.weights) * len(where) for rule, where in plan.rules)


def test_segments_that_may_grow_take_the_points_of_longer_ones():
    lengths = np.linspace(0.1, 3, 40)
    grown = [points(length, margin=1.3) for length in lengths]
    assert grown == [points(1.3 * length) for length in lengths]
    assert grown != [points(length) for length in lengths]


def test_bad_plans():
    with pytest.raises(nd.InputError, match="accuracy"):
        make_line_plan(PATH, path_segments(6), *GRID, 2.0)
    with pytest.raises(nd.InputError, match="method"):
        make_line_plan(PATH, path_segments(6), *GRID, 1e-3, "magic")
