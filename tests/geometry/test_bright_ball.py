"""A point gets the ball that is brighter than what is around it, where nothing else is found."""

import numpy as np
import pytest

from napari_deltamic.geometry import seeds_from_points
from napari_deltamic.geometry.labels import regions_at_points
from napari_deltamic.geometry.labels.bright_ball import bright_ball, stands_out
from napari_deltamic.geometry.refused import Refused

SIZE = np.array([0.3, 0.2, 0.2])
SHAPE = (32, 48, 48)
MIDDLE = np.array([16, 24, 24])


def distances(middle=MIDDLE):
    """(Z, Y, X) um."""
    places = np.moveaxis(np.indices(SHAPE), 0, -1)
    return np.linalg.norm((places - middle) * SIZE, axis=-1)


def image(radius=2.4, light=20.0, slope=60.0, photons=1.0, seed=0):
    """A ball of so much light, on a haze that fades with depth from so much to nothing."""
    haze = np.broadcast_to(slope * np.linspace(1, 0, SHAPE[0])[:, None, None], SHAPE)
    clean = photons * (5.0 + haze + light * (distances() < radius))
    return np.random.default_rng(seed).poisson(clean).astype(float)


@pytest.mark.parametrize("radius", [1.2, 2.4, 3.2])
@pytest.mark.parametrize("photons", [0.1, 1.0])
def test_a_nucleus_in_a_haze_that_fades_with_depth(radius, photons):
    stack = image(radius, photons=photons)
    ball = bright_ball(stack, SIZE, MIDDLE)
    assert ball.radius == pytest.approx(radius, rel=0.15)
    assert stands_out(stack, SIZE, ball)


def nothing_found(monkeypatch, labels=None):
    """As where neither darkness nor a threshold tells what a point lies in."""
    told = Refused("point 1 lies in no region", (1,))
    labels = np.zeros(SHAPE, np.int32) if labels is None else labels
    monkeypatch.setattr(regions_at_points, "closed_regions", lambda *_: (labels.copy(), {1: told}))
    return told


def test_a_point_in_it_is_enough(monkeypatch):
    nothing_found(monkeypatch)
    mesh = seeds_from_points(image(2.4, photons=0.3), SIZE, [MIDDLE * SIZE])
    assert mesh.region_volume(1) == pytest.approx(4 / 3 * np.pi * 2.4**3, rel=0.3)


@pytest.mark.slow
def test_a_region_that_was_found_stays():
    """Of a nucleus with a bright nucleolus under the point, all."""
    stack = image(3.0, slope=0) + 60 * (distances() < 1.0)
    labels, left = regions_at_points.regions_at(stack, SIZE, MIDDLE[None], [1])
    assert not left
    assert (labels == 1).sum() * np.prod(SIZE) > 0.7 * 4 / 3 * np.pi * 3.0**3


def test_a_ball_does_not_reach_into_the_region_of_another_point(monkeypatch):
    other = np.zeros(SHAPE, np.int32)
    other[tuple(MIDDLE + np.array([0, 0, 10]))] = 2
    told = nothing_found(monkeypatch, other)
    given = image(2.4, slope=0), SIZE, MIDDLE[None], [1]
    labels, left = regions_at_points.regions_at(*given)
    assert left == [told]
    np.testing.assert_array_equal(labels, other)


def test_noise_is_none():
    found = [bright_ball(image(light=0, slope=0, seed=k), SIZE, MIDDLE) for k in range(20)]
    assert found == [None] * 20


def test_light_that_rises_towards_the_point_is_none():
    assert bright_ball(100 - distances(), SIZE, MIDDLE) is None


def test_a_point_beside_a_ball_has_none():
    beside = MIDDLE + np.array([0, 16, 0])
    assert distances()[tuple(beside)] > 2.4
    assert bright_ball(image(2.4, slope=0), SIZE, beside) is None


@pytest.mark.parametrize("apart", [14, 17])
def test_a_point_between_two_balls_has_none(apart):
    """The ball that holds both is the brightest."""
    both = sum(distances(MIDDLE + np.array([0, 0, side])) < 2.2 for side in (-apart, apart))
    stack = np.random.default_rng(0).poisson(5.0 + 30 * both).astype(float)
    assert bright_ball(stack, SIZE, MIDDLE) is None


@pytest.mark.parametrize(("others", "stands"), [(0, True), (200, False)])
def test_what_is_far_dimmer_than_other_things_does_not_stand_out(others, stands):
    stack = image(2.0, slope=0)
    stack[:, :24, :12] += others
    assert stands_out(stack, SIZE, bright_ball(stack, SIZE, MIDDLE)) is stands


def test_a_point_at_what_does_not_stand_out_is_told(monkeypatch):
    stack = image(2.0, slope=0)
    stack[:, :24, :12] += 200
    told = nothing_found(monkeypatch)
    labels, left = regions_at_points.regions_at(stack, SIZE, MIDDLE[None], [1])
    assert left == [told]
    assert not labels.any()


def test_a_stack_of_few_slices():
    flat = image(2.4, slope=0)[12:20]
    ball = bright_ball(flat, SIZE, np.array([4, 24, 24]))
    assert ball.radius == pytest.approx(2.4, rel=0.2)
    assert bright_ball(flat[:, :3, :3], SIZE, np.array([4, 1, 1])) is None
    thin = np.array([0.05, 0.2, 0.2])  # less high than a block of the ball
    assert stands_out(flat[:3], thin, bright_ball(flat[:3], thin, np.array([1, 24, 24])))
