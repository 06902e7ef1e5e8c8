import numpy as np
import pytest

from napari_deltamic import fit
from napari_deltamic.fitting.checks import hot_voxels
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


def test_noise_and_membranes_are_not_hot(image):
    assert "hot" not in next(fit(image, GRID, start(1), OPTICS)).message


@pytest.mark.parametrize("photons", [0.02, 0.1])
def test_single_photons_are_not_hot(photons):
    image = np.random.default_rng(0).poisson(photons, (24, 24, 24)).astype(np.float32)
    image[5, 6, 7] = 60.0
    hot = hot_voxels(image, np.ones(image.shape, bool))
    assert np.argwhere(hot).tolist() == [[5, 6, 7]]
