import numpy as np
import pytest

from napari_deltamic import fit
from napari_deltamic.fitting.model.hot_voxels import hot_told, hot_voxels, without_hot
from napari_deltamic.measure import surface_distance
from synthetic import GRID, OPTICS, VOXEL, measured, start


@pytest.fixture(scope="module")
def image():
    return measured()


@pytest.mark.parametrize("value", [pytest.param(200.0, marks=pytest.mark.slow), 65535.0])
def test_a_hot_voxel_is_left_out_and_told(image, value):
    spoilt = image.copy()
    spoilt[2, 3, 4] = spoilt[12, 15, 20] = value * image.max()
    states = list(fit(spoilt, GRID, start(1), OPTICS))
    assert "2 hot voxels" in states[0].message
    clean = list(fit(image, GRID, start(1), OPTICS))[-1]
    assert surface_distance(states[-1].mesh, clean.mesh).mean < 0.02 * VOXEL


def test_hot_voxels_at_the_border_are_found_and_missing(image):
    spoilt = np.round(image).astype(np.uint16)
    spoilt[0, 3, 4] = spoilt[12, 0, -1] = 60_000
    clean, number = without_hot(spoilt)
    assert number == 2
    assert np.argwhere(np.isnan(clean)).tolist() == [[0, 3, 4], [12, 0, 31]]
    assert without_hot(image) == (image, 0)


def test_one_is_told_as_one():
    assert hot_told(1) == "1 hot voxel, brighter than any PSF can make one, is left out"


def test_noise_and_membranes_are_not_hot(image):
    assert "hot" not in next(fit(image, GRID, start(1), OPTICS)).message


@pytest.mark.parametrize("photons", [0.02, 0.1])
def test_single_photons_are_not_hot(photons):
    image = np.random.default_rng(0).poisson(photons, (24, 24, 24)).astype(np.float32)
    image[5, 6, 7] = 60.0
    hot = hot_voxels(image, np.ones(image.shape, bool))
    assert np.argwhere(hot).tolist() == [[5, 6, 7]]


def test_camera_pixels_hot_in_every_slice_are_left_out(image):
    """Above and below them it is as bright, but not beside them."""
    spoilt = image.copy()
    pixels = [(6, 9), (6, 10), (15, 16), (0, 31)]
    for y, x in pixels:
        spoilt[:, y, x] += 0.5 * image.max()
    clean, number = without_hot(spoilt)
    assert number == len(pixels) * len(image)
    assert np.argwhere(np.isnan(clean).all(0)).tolist() == sorted(map(list, pixels))
    again, none = without_hot(clean)
    assert again is clean
    assert none == 0


def test_one_of_few_slices_is_no_hot_camera_pixel(image):
    for few in (image[:5], image.copy()):
        few[:5, 6, 9] += 0.5 * image.max()
        assert without_hot(few)[1] == 0


@pytest.mark.parametrize("noise", [0.01, 3.0])
@pytest.mark.parametrize("width", [0.6, 0.8, 1.2])
def test_vertical_fibres_are_not_hot(noise, width):
    rng = np.random.default_rng(1)
    at = np.arange(32)
    for _ in range(20):
        image = rng.normal(20, noise, (24, 32, 32))
        for y, x in rng.uniform(4, 27, (5, 2)):
            across = np.exp(-((at[:, None] - y) ** 2 + (at - x) ** 2) / (2 * width**2))
            image += 10 ** rng.uniform(0.5, 3) * across
        assert without_hot(image) == (image, 0)


@pytest.mark.slow
def test_hot_camera_pixels_beside_a_cell_move_nothing(image):
    spoilt = image.copy()
    for y, x in [(9, 16), (16, 9), (15, 17), (22, 20)]:
        spoilt[:, y, x] += 0.5 * image.max()
    fits = [list(fit(i, GRID, start(1), OPTICS))[-1] for i in (spoilt, image)]
    assert surface_distance(fits[0].mesh, fits[1].mesh).mean < 0.05 * VOXEL
