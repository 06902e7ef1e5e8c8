"""Fading and drift of slices, as hints."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

from napari_deltamic.evidence.slices import drift, fading

SIZE = (0.5, 0.2, 0.2)


def walls(slope=0.0, seed=0):
    """A pattern of walls that is the same in every slice, dimmer by a share per um."""
    rng = np.random.default_rng(3)
    plane = gaussian_filter(rng.normal(size=(64, 64)), 2)
    plane = 2 + 60 * np.exp(-((plane / plane.std() / 0.3) ** 2))
    dim = np.exp(-slope * SIZE[0] * np.arange(20))[:, None, None]
    return np.random.default_rng(seed).poisson(plane[None] * dim).astype(np.float32)


def test_fading_is_the_share_lost_per_um():
    found = fading(walls(0.05), SIZE[0])
    assert found.value == pytest.approx(0.05, abs=0.01)


def test_an_image_that_does_not_fade_says_so():
    found = fading(walls(), SIZE[0])
    assert abs(found.value) < 4 * max(found.error, 1e-3)


def test_a_slice_out_of_place_is_seen():
    image = walls()
    image[9] = shift(image[9], (2.0, 0.0), order=1, mode="nearest")
    _, jitter = drift(image, SIZE)
    assert jitter.value == pytest.approx(0.4 / np.sqrt(20), rel=0.5)


def test_slices_in_place_show_neither():
    lean, jitter = drift(walls(), SIZE)
    assert lean.value < 0.05
    assert not jitter.known


def test_a_steady_shift_is_the_lean():
    image = walls()
    for k in range(len(image)):
        image[k] = shift(image[k], (0.5 * k, 0.0), order=1, mode="wrap")
    lean, _ = drift(image, SIZE)
    assert lean.value == pytest.approx(0.5 * 0.2 / 0.5, rel=0.25)


@pytest.mark.parametrize("image", [np.zeros((20, 30, 30)), np.full((20, 30, 30), np.nan)])
def test_nothing_is_said_of_nothing(image):
    assert not fading(image, 0.5).known
    assert not drift(image, SIZE)[0].known
