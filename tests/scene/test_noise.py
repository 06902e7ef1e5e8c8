"""Noise: the statistics of a camera, and what it cannot hold."""

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.scene.effects import Camera
from napari_deltamic.scene.noise import detected, intensities

LIGHT = np.full((20, 30, 40), 50.0)


def noisy(camera=None, light=LIGHT, bits=16, seed=0):
    return detected(light, camera, np.random.default_rng(seed), bits)


def test_counts_are_poisson():
    image = noisy().astype(float)
    assert image.mean() == pytest.approx(50, abs=5 * np.sqrt(50 / image.size))
    assert image.var() == pytest.approx(50, rel=0.05)


def test_a_camera_scales_shifts_and_adds():
    camera = Camera(gain=2.5, offset=100.0, read_noise=6.0)
    image = noisy(camera, bits=32)
    assert image.dtype == np.float32
    assert image.mean() == pytest.approx(225, rel=2e-3)
    assert image.var() == pytest.approx(2.5**2 * 50 + 36, rel=0.05)
    assert camera.variance(intensities(LIGHT, camera)).mean() == pytest.approx(
        image.var(), rel=0.05
    )


def test_what_is_full_stays_full():
    image = noisy(Camera(saturation=52.0))
    assert image.max() == 52
    assert (image == 52).mean() > 0.3


@pytest.mark.parametrize(("bits", "kind"), [(8, "uint8"), (12, "uint16"), (16, "uint16")])
def test_bits_are_a_range(bits, kind):
    top = 2**bits - 1
    image = noisy(Camera(saturation=1e9), LIGHT / 50 * (top - 1), bits)
    assert image.dtype == np.dtype(kind)
    assert image.max() == top
    with pytest.raises(nd.InputError, match=f"{bits} bits hold {top}"):
        noisy(light=LIGHT / 50 * (top + 2), bits=bits)


def test_no_light_is_dark():
    assert not noisy(light=LIGHT * 0).any()
    assert not noisy(light=-LIGHT * 1e-9).any()  # what rendering leaves below 0


def test_more_photons_than_can_be_counted_are_refused():
    with pytest.raises(nd.InputError, match="too many"):
        noisy(light=LIGHT * 1e18, bits=32)


def test_the_same_seed_gives_the_same_bytes():
    camera = Camera(gain=1.5, read_noise=2.0)
    one, same, other = (noisy(camera, seed=s).tobytes() for s in (4, 4, 5))
    assert one == same != other


def test_without_read_noise_nothing_more_is_drawn():
    assert np.array_equal(noisy(Camera(gain=2.0)), 2 * noisy())


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_light_must_be_finite(bad):
    with pytest.raises(nd.InputError, match="not finite"):
        noisy(light=LIGHT * bad)


def test_bits_must_be_known():
    with pytest.raises(nd.InputError, match="bits must be"):
        noisy(bits=10)
