"""Which PSFs are narrower than voxels can tell."""

import numpy as np
import pytest

from napari_deltamic.optics.narrow import RULES, narrower_than_told

VOXEL = (0.4, 0.2, 0.2)


@pytest.mark.parametrize(
    ("sigma", "narrow"),
    [((0.4, 0.2, 0.2), False), ((0.23, 0.2, 0.2), True), ((0.4, 0.2, 0.11), True)],
)
def test_each_axis_counts(sigma, narrow):
    assert narrower_than_told(sigma, VOXEL) == narrow


def test_what_its_otf_is_at_the_largest_wavenumber():
    assert np.exp(-((np.pi * RULES.voxels) ** 2) / 2) == pytest.approx(0.17, abs=0.005)
