"""Gain, read noise, offset and saturation from one image."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from napari_deltamic.evidence import camera
from napari_deltamic.evidence.camera import camera_from_image, failed_slices
from napari_deltamic.images.stacks import read_image


def stack(gain=2.0, offset=100.0, read=3.0, seed=0, peak=40.0):
    """A shell of light in 64^3 voxels, blurred by 1.3 voxels, as a camera counts it."""
    z, y, x = np.indices((64, 64, 64)) - 31.5
    radius = np.sqrt(z**2 + y**2 + x**2)
    light = 2 + peak * np.exp(-(((radius - 24) / 1.3) ** 2) / 2)
    rng = np.random.default_rng(seed)
    counts = offset + gain * rng.poisson(light) + read * rng.standard_normal(light.shape)
    return np.rint(counts).astype(np.uint16)


@pytest.mark.parametrize(("gain", "offset", "read"), [(2.0, 100.0, 3.0), (0.8, 300.0, 2.0)])
def test_gain_read_noise_and_offset_are_those_of_the_camera(gain, offset, read):
    found = camera_from_image(stack(gain, offset, read, peak=80.0))
    assert found.gain.value == pytest.approx(gain, rel=0.05)
    assert found.read_noise.value == pytest.approx(read, rel=0.15)
    assert found.offset.value == pytest.approx(offset, abs=gain)
    assert not found.saturation.known


def test_errors_are_as_large_as_the_scatter():
    values = [camera_from_image(stack(seed=k)).gain for k in range(6)]
    scatter = np.std([v.value for v in values])
    assert 0.4 * scatter < np.mean([v.error for v in values]) < 3 * scatter


def test_light_that_is_everywhere_is_no_read_noise():
    found = camera_from_image(stack(gain=1.0, offset=0.0, read=0.0))
    assert found.read_noise.value < 0.5
    assert found.offset.value == pytest.approx(0.0, abs=0.5)


def test_saturation_is_the_level_at_which_values_pile_up():
    image = np.minimum(stack(), 170)
    assert camera_from_image(image).saturation.value == 170


def test_floats_that_pile_up_are_seen_too():
    image = np.minimum(stack() / 7.0, 25.5)
    assert camera_from_image(image).saturation.value == 25.5


def test_voxels_left_out_do_not_count():
    image = stack().astype(np.float32)
    known = np.ones(image.shape, bool)
    known[:20] = False
    image[:20] = np.random.default_rng(0).normal(500, 200, image[:20].shape)
    assert camera_from_image(image, known).gain.value == pytest.approx(2.0, rel=0.1)


def test_large_stacks_of_floats_are_looked_at_in_their_middle(monkeypatch):
    image = stack().astype(np.float32)
    small = replace(camera.CAMERA, looked_at=image.size // 2)
    monkeypatch.setattr(camera, "CAMERA", small)
    assert camera_from_image(image).gain.value == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize(
    ("image", "why"),
    [
        (np.full((20, 30, 30), 7.0), "same value"),
        (np.zeros((3, 4, 4)), "too small"),
        (gaussian_filter(stack().astype(np.float32), 1.0), "related"),
        ((stack() > 150).astype(np.uint8), "grey levels"),
        (np.indices((20, 30, 30)).sum(0).astype(float), "noise"),
        (np.random.default_rng(0).normal(100, 5, (20, 40, 40)), "brightness"),
    ],
)
def test_where_the_image_cannot_tell_it_says_why(image, why):
    found = camera_from_image(image)
    assert not found.gain.known
    assert not found.read_noise.known
    assert why in found.gain.reason


def test_rescaled_values_have_no_gain_but_a_line():
    image = stack().astype(np.float32)
    image = (image - image.min()) / np.ptp(image)
    found = camera_from_image(image)
    assert not found.gain.known
    assert "0 to 1" in found.gain.reason
    assert found.line is not None


def test_dim_images_tell_that_noise_grows_but_not_the_gain():
    """With one variance for all, what is left of a dim membrane would be more than its noise."""
    found = camera_from_image(stack(gain=1.0, offset=20.0, read=2.0, peak=1.5))
    assert not found.gain.known
    assert "dim" in found.gain.reason
    assert found.line is not None
    assert found.line.variance(np.array([22.0, 24.5])) == pytest.approx([6.0, 8.5], rel=0.1)


def test_dark_values_that_were_cut_tell_no_offset():
    image = stack().astype(np.int32)
    found = camera_from_image(np.maximum(image - 106, 0).astype(np.uint16))
    assert not found.offset.known
    assert "cut" in found.offset.reason


def test_few_photons_are_not_taken_for_cut_values():
    image = np.random.default_rng(0).poisson(0.05 + 0 * stack(peak=0.0))
    assert "cut" not in camera_from_image(image).offset.reason


def test_slices_without_an_image_are_found():
    image = stack()
    image[[3, 60]] = 0
    assert failed_slices(image) == (3, 60)


@pytest.mark.parametrize(
    "name",
    [
        "vesicles_GUV",
        "celegans_tp33half_bgsub",
        "gland_WT_2017-12-04_1a",
        "gland_WT_2018-04-10_2a",
        "bead2.5um_EPFL_25pct",
    ],
)
def test_real_stacks_give_plausible_values_or_none(shared_data, name):
    image, _ = read_image(shared_data / "images" / f"{name}.tif")
    found = camera_from_image(image)
    image = image.astype(float)
    if found.gain.known:
        assert 0 < found.gain.value < np.ptp(image)
    if found.offset.known:
        assert (
            image.min() - np.ptp(image)
            < found.offset.value
            < np.median(image) + 0.1 * np.ptp(image)
        )
    if found.read_noise.known:
        assert 0 <= found.read_noise.value < 0.1 * np.ptp(image)
    for finding in (found.gain, found.read_noise, found.offset, found.saturation):
        assert finding.reason
