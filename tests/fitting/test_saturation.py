"""Voxels that a camera cut."""

import numpy as np
import pytest
import torch
from scipy.stats import norm

from napari_deltamic import fit
from napari_deltamic.evidence.residual import analyse_residual
from napari_deltamic.fitting.model.saturation import (
    censored,
    cut_at,
    filled_in,
    saturation,
    share_cut,
    weights_below,
)
from napari_deltamic.runs.settings import FitSettings
from synthetic import GRID, OPTICS, apart, measured, start

SETTINGS = FitSettings(levels=(1.0,), density="uniform")


@pytest.mark.parametrize("dtype", [np.float32, np.uint8])
def test_what_is_cut_is_seen(dtype):
    light = np.random.default_rng(0).poisson(20, 40_000).astype(dtype)
    assert saturation(light) is None
    assert saturation(np.minimum(light, 30)) == 30
    assert cut_at(np.minimum(light, 30)) == 30
    assert cut_at(np.minimum(light, 36)) is None  # hardly a voxel
    assert saturation(light[:0]) is None
    assert cut_at(light[:0]) is None


def test_few_grey_levels_are_not_cut():
    assert cut_at(np.random.default_rng(0).poisson(0.5, 40_000).clip(max=4).astype(float)) is None


@pytest.mark.parametrize("expected", [2.0, 9.0, 10.0, 11.0, 16.0])
def test_the_parabola_has_slope_and_curvature_of_the_logarithm(expected):
    cut, spread, step = 10.0, 1.5, 1e-3

    def log(mean):
        return norm.logsf((cut - mean) / spread)

    value, factor = censored(np.array([expected]), np.array([spread]), cut)
    slope = (log(expected + step) - log(expected - step)) / (2 * step)
    curvature = (log(expected + step) - 2 * log(expected) + log(expected - step)) / step**2
    assert factor[0] * (value[0] - expected) / spread**2 == pytest.approx(slope, rel=1e-4)
    assert -factor[0] / spread**2 == pytest.approx(curvature, rel=1e-2, abs=1e-6)


def test_far_from_the_cut_it_stays_finite():
    means = np.array([-1e9, -1e3, 1e3, 1e9])
    value, factor = censored(means, np.full(4, 1e-3), 10.0)
    assert np.isfinite(value).all()
    assert ((factor >= 0) & (factor <= 1)).all()
    assert value[1] == pytest.approx(10.0, abs=1.0)
    assert factor[3] < 1e-100


@pytest.mark.parametrize("amplitude", [1.0, 3.0])
def test_a_model_that_exceeds_cut_voxels_is_as_bright_as_the_others_say(amplitude):
    shown = torch.linspace(0, 10, 101)
    true = amplitude * shown + 2
    full = true > 8
    measured = torch.where(full, 8.0, true)
    weights = torch.ones_like(shown)
    kept = weights_below(shown, measured, weights, full)
    assert (kept[full] == 0).all()
    assert (kept[~full] == 1).all()
    # Where it is darker than what was cut, they count.
    dim = torch.where(shown > 7, 0.1 * shown, shown)
    kept = weights_below(dim, measured, weights, full)
    assert (kept[full & (shown > 7)] == 1).all()


def test_what_is_cut_is_filled_in_by_what_is_brighter():
    image = np.minimum(measured(noise=1), 25)
    filled = filled_in(image, np.full(image.shape, 30.0))
    assert set(np.unique(filled[image == 25])) == {30.0}
    assert (filled[image < 25] == image[image < 25]).all()
    assert (filled_in(image, np.zeros(image.shape)) == image).all()
    assert 0.3 < share_cut(image) < 0.8
    assert share_cut(measured(noise=1)) == 0


@pytest.mark.slow
def test_a_cut_membrane_is_found_as_a_whole_one_is():
    """Six in ten bright voxels are cut. As they are, they widen the PSF by 14 % (measured)."""
    image, settings = measured(noise=1), FitSettings(levels=(1.0,), fit_psf=True)
    cut = np.minimum(image, 28)
    ends = [list(fit(one, GRID, start(), OPTICS, settings=settings))[-1] for one in (image, cut)]
    whole, found = ends
    assert apart(found.mesh) < apart(whole.mesh) + 0.02
    assert max(found.optics.sigma_um) == pytest.approx(max(whole.optics.sigma_um), rel=0.05)
    left = analyse_residual(cut, GRID, found)
    assert left.explained > 0.9


def test_a_fit_of_an_image_that_is_all_but_cut_stays_finite():
    image = np.minimum(measured(noise=1), 5)
    *_, end = fit(image, GRID, start(), OPTICS, settings=SETTINGS)
    assert np.isfinite(end.mesh.vertices_numpy()).all()
