"""How far the slices of a stack are apart."""

import numpy as np
import pytest
from scipy.ndimage import shift

from napari_deltamic.evidence.slices_apart import SlicesApart, slices_apart

RNG = np.random.default_rng(0)
Z, Y, X = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in (24, 40, 44)), indexing="ij")
SHOWN = 80 * np.exp(-((np.sqrt(4 * Z**2 + Y**2 + X**2) - 12) ** 2) / 8) + 5  # a shell
NOISE = RNG.normal(0, 3, SHOWN.shape)


def wobbling(by):
    moves = RNG.normal(0, by, (len(SHOWN), 2))
    return np.stack([shift(s, m, order=3) for s, m in zip(SHOWN - 5, moves, strict=True)]) + 5


def test_slices_that_fit_together_are_not_apart():
    found = slices_apart(SHOWN + NOISE, SHOWN)
    assert found.shift < 0.05
    assert found.brightness < 0.02


@pytest.mark.parametrize("by", [0.3, 0.7])
def test_a_stage_that_wobbles(by):
    found = [slices_apart(wobbling(by) + NOISE, SHOWN) for _ in range(6)]  # of 14 slices each
    assert np.mean([one.shift for one in found]) == pytest.approx(by, rel=0.3)
    assert max(one.brightness for one in found) < 0.1


def test_a_lamp_that_flickers():
    gains = np.exp(RNG.normal(0, 0.2, (6, len(SHOWN), 1, 1)))
    found = [slices_apart(SHOWN * each + NOISE, SHOWN) for each in gains]
    assert np.mean([one.brightness for one in found]) == pytest.approx(0.2, rel=0.3)
    assert max(one.shift for one in found) < 0.05


def test_a_drift_and_a_fading_are_not_meant():
    depth = np.arange(len(SHOWN)) / len(SHOWN)
    moved = np.stack([shift(s, (d, -d), order=3) for s, d in zip(SHOWN, depth, strict=True)])
    found = slices_apart(moved * np.exp(-depth)[:, None, None] + NOISE, SHOWN)
    assert found.shift < 0.05
    assert found.brightness < 0.02


def test_what_is_missing_does_not_count():
    left = X < 0
    seen = np.where(left, SHOWN, wobbling(0.7)) + NOISE
    assert slices_apart(np.where(left, seen, np.nan), SHOWN).shift < 0.06
    assert slices_apart(np.where(left, np.nan, seen), SHOWN).shift > 0.3


def test_what_noise_alone_would_move_does_not_count():
    faint = 0.02 * (SHOWN - 5) + 5
    found = [slices_apart(faint + RNG.permuted(NOISE, axis=0), faint) for _ in range(20)]
    assert np.count_nonzero([one.shift for one in found]) <= 1  # it moves them by 0.8
    assert np.count_nonzero([one.brightness for one in found]) <= 1


@pytest.mark.parametrize("shown", [SHOWN[:5], np.zeros((20, 8, 8)), SHOWN[:, :, :2]])
def test_too_little_tells_nothing(shown):
    found = slices_apart(shown + NOISE[tuple(slice(n) for n in shown.shape)], shown)
    assert np.isfinite([found.shift, found.brightness]).all()
    if len(shown) < 6:
        assert found == SlicesApart()
