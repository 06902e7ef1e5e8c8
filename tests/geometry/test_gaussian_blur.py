"""The Gaussian filter is SciPy's, with no light beyond the border."""

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from napari_deltamic.geometry import gaussian_blur
from napari_deltamic.geometry.gaussian_blur import blurred


@pytest.fixture(params=["compiled", "missing"])
def loops(request, monkeypatch):
    if request.param == "missing":
        monkeypatch.setattr(gaussian_blur, "native", lambda: None)
    elif gaussian_blur.native() is None:
        pytest.skip("the compiled extension is missing")


@pytest.mark.parametrize("shape", [(5, 70, 131), (1, 3, 64), (129, 2, 7), (2, 9, 700)])
@pytest.mark.parametrize(
    "widths", [(0.3, 1.5, 4.0), (6.0, 0.7, 0.7), (1.2, 0.0, 0.0), (300.0, 90.0, 500.0)]
)
def test_it_is_that_of_scipy(loops, shape, widths):
    values = np.random.default_rng(0).normal(size=shape)
    found = blurred(values, widths, 3.0)
    told = gaussian_filter(values, widths, mode="constant", truncate=3.0)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, told, atol=1e-6)


def test_light_that_lies_beyond_the_border_costs_no_time():
    """A Gaussian wider than the stack has no more terms than the stack has voxels."""
    image = np.ones((3, 4, 5), np.float32)
    assert [len(w) for w in gaussian_blur.weights_within(image.shape, (1e4, 1.0, 0.0), 3.0)] == [
        *(3, 4, 0)
    ]


def test_a_stack_of_another_layout_is_blurred_alike():
    values = np.random.default_rng(0).normal(size=(9, 20, 30)).astype(np.float32)
    turned = np.asfortranarray(values)
    assert np.array_equal(blurred(turned, (1, 2, 3), 3.0), blurred(values, (1, 2, 3), 3.0))


def test_the_number_of_threads_changes_no_bit():
    values = np.random.default_rng(0).normal(size=(40, 120, 131)).astype(np.float32)
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            found.append(blurred(values, (1.3, 0.9, 2.1), 3.0))
    finally:
        torch.set_num_threads(before)
    assert all(np.array_equal(found[0], other) for other in found[1:])


def test_where_a_stack_lies_in_memory_changes_no_bit():
    values = np.random.default_rng(0).normal(size=(20, 70, 75)).astype(np.float32)
    found = blurred(values, (1.3, 0.9, 2.1), 3.0)
    room = np.empty(values.size + 32, np.float32)
    for first in range(0, 32, 5):
        moved = room[first : first + values.size].reshape(values.shape)
        moved[:] = values
        assert np.array_equal(blurred(moved, (1.3, 0.9, 2.1), 3.0), found)


def test_a_stack_without_voxels_stays_one():
    assert blurred(np.zeros((0, 4, 4)), (1, 1, 1), 3.0).shape == (0, 4, 4)
