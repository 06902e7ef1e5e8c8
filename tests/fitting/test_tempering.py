"""The variance of residuals, and how many voxels one independent voxel stands for."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from napari_deltamic.fitting.model.tempering import tempered_variance

SHAPE = (48, 64, 64)
WIDTHS = (1.2, 1.5, 1.5)


def tempered(residual, widths=WIDTHS, least=0.0, index=None):
    index = np.arange(residual.size) if index is None else index
    return tempered_variance(residual.ravel()[index], index, SHAPE, widths, least)


def white(seed=0):
    return np.random.default_rng(seed).normal(size=SHAPE)


def test_white_noise_stands_for_itself():
    found = [tempered(3 * white(s)) / 9 for s in range(4)]
    assert np.mean(found) == pytest.approx(1.05, abs=0.1)  # at least its variance: never below 1
    assert min(found) > 0.99


def test_correlated_noise_counts_as_often_as_it_is_correlated():
    """A Gaussian of width s correlates noise over (2 sqrt(pi) s)^3 voxels."""
    s = 0.8
    found = []
    for seed in range(4):
        noise = gaussian_filter(white(seed), s, mode="wrap")
        found.append(tempered(noise, (5, 5, 5)) / noise.var())
    volume = (2 * np.sqrt(np.pi) * s) ** 3
    # Blocks of 20 voxels end somewhere: at their faces less is alike.
    assert 0.6 * volume < np.mean(found) < 1.1 * volume


def test_a_bright_foreign_block_does_not_decide():
    noise = gaussian_filter(white(), 0.8, mode="wrap")
    before = tempered(noise)
    noise[:8, :8, :8] += 2 * noise.std()  # half a percent of the voxels
    assert tempered(noise) == pytest.approx(before, rel=0.05)


def test_voxels_may_lie_anywhere():
    noise, chosen = white(), np.flatnonzero(np.random.default_rng(1).random(white().size) < 0.3)
    assert tempered(noise, index=chosen) == pytest.approx(1.05, abs=0.15)


def test_it_is_never_less_than_the_least_nor_than_that_of_single_voxels():
    assert tempered(1e-9 * white(), least=0.5) == 0.5
    few = np.array([0, 5000, 90000])
    noise = white()
    assert tempered(noise, index=few) == pytest.approx(np.mean(noise.ravel()[few] ** 2))
    striped = white() * 0 + (-1.0) ** np.arange(SHAPE[2])  # sums over blocks vanish
    assert tempered(striped) == pytest.approx(1)
