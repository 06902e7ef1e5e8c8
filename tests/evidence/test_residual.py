"""Where a fit does not explain the image."""

import numpy as np
import pytest
from evidence_scenes import CENTER, GRID, expected, fitted, photons
from scipy.ndimage import gaussian_filter

from napari_deltamic import Grid
from napari_deltamic.errors import InputError
from napari_deltamic.evidence import analyse_residual
from napari_deltamic.evidence.residual import smoothed
from napari_deltamic.scene.light import Light


def test_an_image_that_is_explained_leaves_noise(plain):
    image, state = plain
    found = analyse_residual(image, GRID, state)
    assert found.map.shape == image.shape
    assert np.nanstd(found.map) == pytest.approx(1, abs=0.15)
    assert len(found.spots) <= 1
    assert found.explained > 0.95
    assert found.cells[0].explained > 0.95


def test_a_cell_where_nothing_shines_is_not_shown(plain):
    image, state = plain
    noise = np.random.default_rng(2).poisson(5.0, image.shape).astype(np.float32)
    assert analyse_residual(image, GRID, state).cells[0].shown > 50
    assert abs(analyse_residual(noise, GRID, state).cells[0].shown) < 5


def test_a_cell_of_which_voxels_show_less_than_noise_is_shown_by_all_of_them():
    faint = np.random.default_rng(2).poisson(60 + 0.1 * expected()).astype(np.float32)
    assert analyse_residual(faint, GRID, fitted(faint)).cells[0].shown > 10


def test_a_spot_that_no_surface_explains_is_found_where_it_is(plain):
    _, state = plain
    spot = np.zeros(GRID.shape)
    at = (12, 16, 17)
    spot[at] = 1
    spot = gaussian_filter(spot, (1.4, 1.25, 1.25))
    image = np.random.default_rng(5).poisson(expected() + 40 * spot / spot.max()).astype(np.float32)
    found = analyse_residual(image, GRID, state)
    brightest = found.spots[0]
    assert np.allclose(brightest.position, np.array(at) * GRID.voxel_size, atol=0.5)
    assert brightest.z > found.threshold
    assert brightest.light > 0
    assert brightest.region == 1


def test_light_from_inside_is_left_unexplained():
    # Brighter than the other scenes: the cell is so small that 40 photons leave it at 4.3 of the 5.
    image = photons(light=Light(1.0, 0.15), seed=1, peak=60.0)
    found = analyse_residual(image, GRID, fitted(image))
    inside = tuple(int(c / d) for c, d in zip(CENTER, GRID.voxel_size, strict=True))
    assert found.map[inside] > 3
    assert found.cells[0].z > 5


def test_missing_voxels_stay_missing(plain):
    image = plain[0].copy()
    image[0, :5] = np.nan
    found = analyse_residual(image, GRID, plain[1])
    assert np.isnan(found.map[0, :5]).all()
    assert np.isfinite(found.map[1:]).all()


def test_hot_voxels_do_not_count_as_light_that_is_not_explained(plain):
    image, state = plain
    clean, spoilt = analyse_residual(image, GRID, state), image.copy()
    spoilt[12, 16, 10] = spoilt[12, 16, 24] = 100 * image.max()
    found = analyse_residual(spoilt, GRID, state)
    assert np.isnan(found.map[12, 16, 10])
    assert found.explained == pytest.approx(clean.explained, abs=0.01)
    assert len(found.spots) <= 1


def test_white_noise_keeps_its_size_at_the_border_and_beside_holes():
    rng = np.random.default_rng(0)
    known = rng.random((30, 40, 40)) < 0.8
    values = [
        smoothed(np.where(known, rng.normal(size=known.shape), 0), known, np.array([1.2, 1.5, 0.9]))
        for _ in range(30)
    ]
    spread = np.std(values, axis=0)
    assert np.median(spread[known]) == pytest.approx(1, abs=0.08)
    assert np.median(spread[0][known[0]]) == pytest.approx(1, abs=0.15)


def test_a_fit_of_another_image_is_refused(plain):
    image, state = plain
    with pytest.raises(InputError, match="shape"):
        analyse_residual(image[:10], Grid((10, 34, 34), GRID.voxel_size), state)
