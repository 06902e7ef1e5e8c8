"""Padding is told from dark backgrounds."""

import numpy as np
import pytest
from scipy.ndimage import affine_transform, binary_erosion, gaussian_filter, median_filter

from napari_deltamic.images.padding import padding, without_padding

SHAPE = (20, 30, 34)
Z, Y, X = np.indices(SHAPE)
BALL = gaussian_filter(((Z - 10) ** 2 + (Y - 15) ** 2 + (X - 17) ** 2 < 36).astype(float), 1.2)


def stack(offset=100, photons=60.0, dark=4.0):
    return (offset + np.random.default_rng(0).poisson(dark + photons * BALL)).astype(np.uint16)


BORDERS = (Z < 3) | (Y < 4) | (X >= 30)
WEDGE = X + Z < 12
SLICE = Z == 7
MIDDLE = (np.array(SHAPE) - 1) / 2
TURN = np.array([[1, 0, 0], [0, np.cos(0.3), np.sin(0.3)], [0, -np.sin(0.3), np.cos(0.3)]])


@pytest.mark.parametrize("where", [BORDERS, WEDGE, SLICE, BORDERS | SLICE], ids=str)
@pytest.mark.parametrize("offset", [100, 5])
def test_what_nobody_measured_is_found(where, offset):
    image = np.where(where, 0, stack(offset)).astype(np.uint16)
    found = padding(image)
    assert found is not None
    assert not (found & ~where).any()
    assert (found & where).sum() > 0.98 * where.sum()
    known, told = without_padding(image)
    np.testing.assert_array_equal(np.isnan(known), found)
    np.testing.assert_array_equal(known[~found], image[~found])
    assert "padding, all of one value" in told
    assert known.dtype == np.float32


@pytest.mark.parametrize("order", [1, 3])
def test_what_was_turned_is_found_with_what_it_smeared(order):
    turned = affine_transform(
        stack().astype(np.float32), TURN, offset=MIDDLE - TURN @ MIDDLE, order=order
    )
    inside = affine_transform(np.ones(SHAPE), TURN, offset=MIDDLE - TURN @ MIDDLE, order=1)
    found = padding(turned)
    assert found[inside < 0.2].mean() > 0.97
    whole = binary_erosion(inside > 0.999, iterations=3, border_value=1)
    assert not found[whole].any()


def cut_off(image):
    return np.clip(image - np.median(image), 0, None)


PLAIN = stack(0).astype(float)
IMAGES = {
    "a camera's": stack(),
    "few photons": stack(0, 5.0, 0.3),
    "few photons, smoothed": median_filter(stack(0, 5.0, 0.3), 3),
    "background subtracted": cut_off(gaussian_filter(PLAIN, 1.0)),
    "stretched to 8 bits": np.clip(8 * cut_off(gaussian_filter(PLAIN, 0.7)), 0, 255).astype("u1"),
    "without noise": np.where(BALL < 1e-6, 0.0, BALL),
    "a mask": (BALL > 0.5).astype(np.uint8),
    "flat": np.zeros(SHAPE),
    "missing": np.full(SHAPE, np.nan),
}


@pytest.mark.parametrize("name", IMAGES)
def test_a_dark_background_is_none(name):
    image = IMAGES[name]
    assert padding(image) is None
    same, told = without_padding(image)
    assert same is image
    assert told == ""


def test_what_is_missing_already_stays_missing():
    image = np.where(BORDERS, 0, stack()).astype(np.float32)
    image[5, 15, 15] = np.nan
    known, _ = without_padding(image)
    assert np.isnan(known[5, 15, 15])
    assert np.isnan(known[BORDERS]).all()
