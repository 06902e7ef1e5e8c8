"""The accuracy that noise asks for."""

import numpy as np
import pytest

from napari_deltamic import InputError
from napari_deltamic.fitting.model.default_accuracy import (
    COARSEST,
    FINEST,
    PRESETS,
    accuracy_for,
    accuracy_for_image,
    image_noise,
    preset_accuracy,
)
from napari_deltamic.fitting.model.likelihood import noise_ratio
from synthetic import measured


def test_noisier_images_need_less():
    noise = [0.0, 1e-4, 2e-3, 4e-3, 0.011, 0.02, 0.03, 0.07, 0.5]
    found = [accuracy_for(n) for n in noise]
    assert found == [1e-3, 1e-3, 2e-3, 4e-3, 1e-2, 2e-2, 2e-2, 2e-2, 2e-2]


@pytest.mark.parametrize("noise", [-0.1, float("nan"), float("inf")])
def test_noise_that_is_none(noise):
    with pytest.raises(InputError, match="noise must be"):
        accuracy_for(noise)


def test_the_law_keeps_below_a_third_of_the_noise():
    """What was measured, in voxels: scatter by noise, and shift by a rendering of an accuracy."""
    for noise in np.geomspace(0.004, 0.08, 20):
        shift = 0.03 * (accuracy_for(noise) / 0.1) ** 1.25
        assert shift < 1.2 * noise / 3


def test_names_on_the_dial():
    accuracies = [preset_accuracy(name, 0.003) for name in PRESETS]
    assert accuracies == [1.5e-2, 3e-3, 3e-4, 0]
    assert preset_accuracy("normal", 0.0) == FINEST
    assert preset_accuracy("quick", 0.5) == preset_accuracy("quick", 0.01) == COARSEST
    with pytest.raises(InputError, match="quick, normal, careful, exact"):
        preset_accuracy("best", 0.01)


def test_noise_of_an_image():
    image = measured(noise=0).astype(np.float32)
    everything = np.ones(image.shape, bool)
    assert image_noise(image) == pytest.approx(noise_ratio(image, everything), rel=1e-4)
    assert image_noise(measured()) < 1e-3
    holed = image.copy()
    holed[:, ::7] = np.nan
    assert image_noise(holed) == pytest.approx(image_noise(image), rel=0.05)
    half = everything.copy()
    half[:, :, 16:] = False
    wild = np.where(half, image, np.random.default_rng(0).normal(0, 500, image.shape))
    assert image_noise(wild, half) == pytest.approx(image_noise(image), rel=0.1)
    assert image_noise(wild) != pytest.approx(image_noise(image), rel=0.2)


def test_a_few_planes_of_a_large_image_do():
    rng = np.random.default_rng(0)
    image = rng.normal(0, 1, (60, 120, 120)) + 30 * (rng.random((60, 120, 120)) < 0.01)
    some, whole = image_noise(image), noise_ratio(image, np.ones(image.shape, bool))
    assert some == pytest.approx(whole, rel=0.02)
    assert accuracy_for_image(image) == accuracy_for(some)


def test_an_image_of_one_plane_or_of_nothing():
    assert image_noise(np.ones((1, 9, 9))) == 0
    assert accuracy_for_image(np.full((3, 5, 5), np.nan)) == FINEST
