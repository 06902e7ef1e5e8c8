import numpy as np
import pytest
from scipy import ndimage

from napari_deltamic.common.widened_mask import widened_mask


@pytest.mark.parametrize("far", [(0, 1, 2), (3, 0, 7), (40, 5, 6)])
def test_a_widened_mask_is_a_box_around_each_voxel(far):
    mask = np.random.default_rng(0).random((9, 20, 31)) > 0.995
    before = mask.copy()
    told = ndimage.maximum_filter(mask, [2 * n + 1 for n in far], mode="constant")
    assert np.array_equal(widened_mask(mask, far), told)
    assert np.array_equal(mask, before)
