"""Whether the noise of an image is as blurred as the image."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from skimage.restoration import richardson_lucy

import napari_deltamic as nd
from napari_deltamic.fitting.model.noise_blur import is_sharpened, is_white
from napari_deltamic.geometry import sphere
from napari_deltamic.scene.light import INSIDES, structure_of

ONE = (1.0, 1.0, 1.0)
WHITE = np.random.default_rng(0).normal(size=(40, 50, 60))


def smoothed(by: float) -> np.ndarray:
    return gaussian_filter(WHITE, by)


@pytest.mark.parametrize("by", [0.4, 0.5, 0.8, 1.0, 1.5, 2.0])
def test_noise_is_compared_with_the_psf(by: float) -> None:
    assert is_sharpened(smoothed(by), (by, by, by), ONE)
    assert not is_sharpened(smoothed(by), (1.6 * by,) * 3, ONE)
    # In um, other voxels along Z.
    assert is_sharpened(smoothed(by), (3 * by, 0.2 * by, 0.2 * by), (3.0, 0.2, 0.2))


def test_white_noise_was_not_smoothed() -> None:
    assert is_white(WHITE)
    assert not is_sharpened(WHITE, (0.6, 0.6, 0.6), ONE)
    assert not is_white(smoothed(0.6))
    assert not is_white(gaussian_filter(WHITE, (0, 0, 1.0)))


def test_what_is_missing_does_not_count() -> None:
    holes = smoothed(1.0)
    holes[::7] = np.nan
    assert is_sharpened(holes, ONE, ONE)
    assert is_white(np.where(np.isnan(holes), np.nan, WHITE))


@pytest.mark.parametrize("left", [WHITE[:5, :5, :5], np.zeros((20, 20, 20)), WHITE * np.nan])
def test_too_few_voxels_or_no_noise_tell_nothing(left: np.ndarray) -> None:
    assert is_white(left)
    assert not is_sharpened(left, ONE, ONE)


@pytest.mark.parametrize("slices", [1, 3])
def test_an_axis_of_which_few_voxels_are_known_tells_nothing(slices: int) -> None:
    known = np.arange(40)[:, None, None] < slices
    assert is_white(np.where(known, WHITE, np.nan))
    assert not is_white(np.where(known, smoothed(1.0), np.nan))
    assert is_sharpened(np.where(known, smoothed(1.0), np.nan), (9.0, 1.0, 1.0), ONE)


@pytest.mark.slow
def test_the_bright_rim_of_a_deconvolved_nucleus_is_no_membrane() -> None:
    """With a membrane further in, it was more than 0.6 voxel too small."""
    grid, optics, radius = nd.Grid((26, 26, 26), (0.2,) * 3), nd.GaussianPSF(0.25), 1.5
    cell = sphere((2.5, 2.5, 2.5), radius, edge_length=0.25)
    shown = nd.scene.expected_image(cell, grid, optics, 1e-4, 1.0, 0.0, light=INSIDES)
    image = np.random.default_rng(1).poisson(60 * shown / shown.max() + 6)
    psf = np.zeros((13, 13, 13))
    psf[6, 6, 6] = 1
    psf = gaussian_filter(psf, 0.25 / 0.2)
    sharp = richardson_lucy(image / image.max(), psf, num_iter=20, clip=False) * image.max()
    start = sphere((2.6, 2.4, 2.5), 0.9 * radius, edge_length=0.3)
    *_, found = nd.fit(sharp.astype(np.float32), grid, start, nd.GaussianPSF(0.2))
    assert structure_of(found.light) == "interior"
    volume = found.mesh.region_volume(1) / cell.region_volume(1)
    assert (1 - np.cbrt(volume)) * radius / 0.2 < 0.3
