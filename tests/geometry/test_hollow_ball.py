"""Cells whose membrane shows only as a whole."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from napari_deltamic.geometry import labels_from_points
from napari_deltamic.geometry.labels import hollow_ball as module
from napari_deltamic.geometry.labels import regions_at_points
from napari_deltamic.geometry.labels.hollow_ball import hollow_ball

SIZE = np.array([0.4, 0.2, 0.2])
MIDDLE = np.array([12, 26, 24])


def image(photons, radius=1.6, shape=(24, 48, 52), seed=0, filled=False):
    """An uneven shell, or a ball, around the middle, on a background of 10 photons."""
    far = np.sqrt(
        sum(((n - m) * s) ** 2 for n, m, s in zip(np.indices(shape), MIDDLE, SIZE, strict=True))
    )
    light = (far < radius).astype(float) if filled else (np.abs(far - radius) < 0.15).astype(float)
    light *= np.linspace(0.6, 1.4, shape[2])
    light = gaussian_filter(light, 0.2 / SIZE)
    rng = np.random.default_rng(seed)
    return rng.poisson(10 + photons * light / light.max()).astype(float)


def test_it_is_found_where_no_level_closes():
    found = hollow_ball(image(6.0), SIZE, MIDDLE)
    assert found.radius == pytest.approx(1.6, rel=0.12)
    assert np.linalg.norm((found.middle - MIDDLE) * SIZE) < 0.3


def test_its_middle_is_found_from_beside_it():
    found = hollow_ball(image(8.0), SIZE, MIDDLE + np.array([0, 3, -2]))
    assert found.radius == pytest.approx(1.6, rel=0.12)
    assert np.linalg.norm((found.middle - MIDDLE) * SIZE) < 0.35


@pytest.mark.parametrize("seed", range(3))
def test_noise_and_filled_balls_have_none(seed):
    assert hollow_ball(image(0.0, seed=seed), SIZE, MIDDLE) is None
    assert hollow_ball(image(20.0, seed=seed, filled=True), SIZE, MIDDLE) is None


def test_ground_beside_it_has_none():
    assert hollow_ball(image(20.0), SIZE, np.array([12, 5, 45])) is None


def test_of_large_surroundings_some_voxels_are_enough(monkeypatch):
    monkeypatch.setattr(module, "RULES", module.HollowRules(most=20_000))
    assert hollow_ball(image(8.0), SIZE, MIDDLE).radius == pytest.approx(1.6, rel=0.15)


@pytest.mark.parametrize("shape", [(3, 3, 3), (3, 48, 52), (1, 8, 8)])
def test_stacks_that_are_too_small_for_one(shape):
    flat = np.random.default_rng(0).poisson(10, shape).astype(float)
    assert hollow_ball(flat, SIZE, np.array(shape) // 2) is None


def test_a_point_in_it_names_it():
    labels = labels_from_points(image(6.0), SIZE, [MIDDLE * SIZE])
    assert (labels == 1).sum() * np.prod(SIZE) == pytest.approx(4 / 3 * np.pi * 1.6**3, rel=0.35)


@pytest.mark.parametrize("blur", [1.0, 2.0])
def test_noise_that_was_smoothed_has_none(blur):
    for seed in range(12):
        noise = gaussian_filter(image(0.0, seed=seed), blur)
        assert hollow_ball(noise, SIZE, MIDDLE) is None


def test_whole_numbers_are_as_good():
    whole = np.minimum(image(20.0), 255).astype(np.uint8)
    same = hollow_ball(whole.astype(float), SIZE, MIDDLE)
    assert hollow_ball(whole, SIZE, MIDDLE).radius == same.radius


def small_cell():
    """A clear, uneven cell whose dark inside is a few voxels wide, and bright things beside it."""
    at = np.indices((25, 25, 25)) - 12
    light = np.exp(-(((np.linalg.norm(at, axis=0) - 3.6) / 1.6) ** 2) / 2) * (1 + 0.9 * at[2] / 12)
    for other in ((-7, -7, 5), (-12, -6, 0), (0, 3, -12), (8, 6, -8)):
        far = np.linalg.norm(at - np.reshape(other, (3, 1, 1, 1)), axis=0)
        light += 4 * np.exp(-((far / 2.5) ** 2) / 2)
    return np.random.default_rng(0).poisson(20 + 400 * light).astype(float)


def test_a_point_in_a_small_clear_cell_names_it(monkeypatch):
    stack, size, middle = small_cell(), np.ones(3), np.full(3, 12)
    assert hollow_ball(stack, size, middle) is None  # the cell itself looks like blurred noise
    assert hollow_ball(stack, size, middle, closed=True).radius == pytest.approx(3.6, rel=0.1)
    monkeypatch.setattr(regions_at_points, "_cells", lambda data, size: None)
    labels = labels_from_points(stack, size, [middle])
    assert np.cbrt(3 * np.count_nonzero(labels == 1) / 4 / np.pi) == pytest.approx(3.6, rel=0.2)
