"""The efficient score."""

import numpy as np
import pytest
from scipy.stats import norm

from napari_deltamic.evidence.linearised import Linearised
from napari_deltamic.evidence.score import block_sizes, blocks_of, equivalent_z, score

RNG = np.random.default_rng(0)
N = 4000
FITTED = RNG.normal(size=(N, 5))
BLOCKS = np.arange(N) // 100


def at(residual):
    return Linearised(FITTED, residual, np.ones(N), 3, np.zeros((5, 5)))


def test_no_effect_scores_like_a_normal_number():
    columns = RNG.normal(size=(N, 1)) + FITTED[:, :1]
    z = [score(at(RNG.normal(size=N)), columns, [BLOCKS]).z for _ in range(300)]
    assert abs(np.mean(z)) < 0.2
    assert 0.8 < np.std(z) < 1.1


def test_an_effect_is_estimated_whatever_the_fitted_numbers_took_of_it():
    columns = RNG.normal(size=(N, 1)) + FITTED[:, :1]
    residual = RNG.normal(size=N) + 0.2 * columns[:, 0] - FITTED @ np.array([0.2, 3, -2, 1, 0])
    found = score(at(residual), columns, [BLOCKS])
    assert found.z == pytest.approx(0.2 * np.sqrt(N), rel=0.15)
    assert found.estimate[0] == pytest.approx(0.2, rel=0.15)
    # Left out, it moves the first mode by as much as the two have in common.
    assert found.shape[0] == pytest.approx(0.2, rel=0.3)


def test_what_shape_explains_wholly_is_hidden():
    found = score(at(RNG.normal(size=N)), FITTED @ np.ones((5, 1)), [BLOCKS])
    assert found.hidden
    assert found.z == 0


def test_related_residuals_do_not_pass_for_evidence():
    columns = np.repeat(RNG.normal(size=(N // 100, 1)), 100, axis=0)
    z = [
        score(at(np.repeat(RNG.normal(size=N // 100), 100)), columns, [BLOCKS]).z
        for _ in range(100)
    ]
    assert np.std(z) < 1.6


def test_residuals_that_are_related_far_and_wide_count_once():
    far = np.arange(N) // 400
    columns = np.repeat(RNG.normal(size=(N // 400, 1)), 400, axis=0)
    residual = np.repeat(RNG.normal(size=N // 400), 400) + RNG.normal(size=N)
    found = score(at(residual), columns, [BLOCKS, far])
    assert abs(found.z) < 0.7 * abs(score(at(residual), columns, [BLOCKS]).z)
    assert found.near == score(at(residual), columns, [BLOCKS]).z


def test_blocks_grow_as_long_as_there_are_enough():
    sizes = block_sizes(np.arange(40**3), (40, 40, 40), np.ones(3))
    assert [b.max() + 1 for b in sizes] == [1000, 125, 27]
    assert len(block_sizes(np.arange(12**3), (12, 12, 12), np.full(3, 2.0))) == 1


def test_several_numbers_count_as_one_as_unlikely():
    assert equivalent_z(9.0, 1) == 3.0
    assert norm.sf(equivalent_z(20.0, 5)) * 2 == pytest.approx(0.00125, rel=0.01)
    assert equivalent_z(2000.0, 5) == pytest.approx(np.sqrt(2000), rel=0.02)
    assert equivalent_z(0.0, 3) == 0


def test_blocks_are_cubes():
    index = np.arange(4 * 6 * 6)
    blocks = blocks_of(index, (4, 6, 6), np.array([2, 3, 3]))
    assert len(np.unique(blocks)) == 8
    assert (np.bincount(blocks) == 18).all()
