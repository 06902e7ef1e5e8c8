"""Distinct pairs, as numpy finds them."""

import numpy as np
import pytest

from napari_deltamic.geometry.pairs import unique_pairs


@pytest.mark.parametrize("n", [0, 1, 500])
@pytest.mark.parametrize("largest", [3, 2**53])
def test_pairs_are_those_of_numpy(n, largest):
    pairs = np.random.default_rng(n).integers(0, largest, (n, 2))
    pairs[n // 2 :] = pairs[: n - n // 2]
    found, row = unique_pairs(pairs)
    rows, index = np.unique(pairs, axis=0, return_inverse=True)
    np.testing.assert_array_equal(found, rows)
    np.testing.assert_array_equal(row, index.reshape(-1))
    assert found.shape == (len(found), 2)
