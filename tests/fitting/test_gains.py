"""Gains of one fit over another, cell by cell."""

from types import SimpleNamespace

import numpy as np
import pytest

from napari_deltamic.fitting.model.tempering import block_centres, block_sums
from napari_deltamic.fitting.rivals.gains import gains_over, leaves_without_one, without_one


def objective(mine, its, cells):
    """What it leaves in its blocks, and what others do."""
    return SimpleNamespace(
        nats_left=lambda other, evened: (2 if evened else 1) * np.stack([mine, its]),
        cells_of_blocks=lambda: np.asarray(cells),
    )


def test_gains_are_those_of_each_cell():
    nats, cells = np.arange(1.0, 8), np.array([3, 5, 3, 9, 5, 3, 9])
    one, other = objective(nats, 2 * nats, cells), objective(3 * nats, 2 * nats, cells)
    evened, measured = gains_over(one, other)
    np.testing.assert_array_equal(measured.sum(axis=1), [1 + 3 + 6, 2 + 5, 4 + 7])
    assert (measured**2).sum() == (nats**2).sum()
    np.testing.assert_array_equal(evened, 2 * measured)


def test_the_cell_that_says_most_is_left_out():
    gains = [np.diag([1.0, 2, 9, -20]), np.diag([30.0, 2, 9, 0])]
    evened, measured = (g.sum(axis=1).tolist() for g in without_one(gains))
    assert (evened, measured) == ([1, 2, -20], [2, 9, 0])
    few = [np.diag([1.0, 50, 2])] * 2
    np.testing.assert_array_equal(without_one(few), few)


def test_what_is_left_without_the_cell_that_is_explained_best():
    mine, its, cells = np.array([1.0, 2, 3, 1]), np.array([2.0, 2, 4, 90]), [1, 2, 3, 4]
    one, other = objective(mine, its, cells), objective(its, mine, cells)
    assert leaves_without_one(one, other) == pytest.approx(6 / 8)
    few = [1, 1, 3, 4]
    both = objective(mine, its, few), objective(its, mine, few)
    assert leaves_without_one(*both) == pytest.approx(7 / 98)


@pytest.mark.parametrize("widths", [(0.9, 1.3, 2.0), (0.2, 0.3, 0.4)])
def test_centres_are_those_of_the_blocks(widths):
    shape = 13, 20, 9
    centres = block_centres(shape, widths)
    inside = centres[(centres <= np.array(shape) - 1).all(axis=1)][:30]
    voxels = np.ravel_multi_index(tuple(np.floor(inside + 0.5).astype(int).T), shape)
    at = [int(block_sums(np.ones(1), voxels[[k]], shape, widths).argmax()) for k in range(9)]
    np.testing.assert_allclose(centres[at], inside[:9])
    assert len(centres) == len(block_sums(np.ones(1), voxels[[0]], shape, widths))
