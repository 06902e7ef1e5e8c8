"""Distances to what lies outside a mask are SciPy's, and so are the nearest voxels but for ties."""

import numpy as np
import pytest
import torch
from scipy import ndimage

from napari_deltamic.geometry import distance_transform as module
from napari_deltamic.geometry.distance_transform import distance_transform, nearest_outside


@pytest.fixture(params=["compiled", "missing"])
def loops(request, monkeypatch):
    if request.param == "missing":
        monkeypatch.setattr(module, "native", lambda: None)
    elif module.native() is None:
        pytest.skip("the compiled extension is missing")


def _mask(shape, kind):
    rng = np.random.default_rng(len(shape))
    smooth = ndimage.gaussian_filter(rng.normal(size=shape), 2)
    return {
        "blobs": smooth > np.quantile(smooth, 0.8),
        "holes": smooth < np.quantile(smooth, 0.8),
        "one voxel": np.arange(smooth.size).reshape(shape) != smooth.size // 3,
        "noise": rng.random(shape) > 0.5,
        "nothing": np.zeros(shape, bool),
    }[kind]


@pytest.mark.parametrize("kind", ["blobs", "holes", "one voxel", "noise", "nothing"])
@pytest.mark.parametrize("shape", [(12, 33, 47), (1, 40, 21), (30, 1, 5), (25, 37), (19,)])
def test_they_are_those_of_scipy(loops, shape, kind):
    mask, size = _mask(shape, kind), np.array([2.7, 0.31, 0.4])[: len(shape)]
    told = ndimage.distance_transform_edt(mask, size)
    np.testing.assert_allclose(distance_transform(mask, size), told, rtol=1e-12)
    distances, nearest = nearest_outside(mask, size)
    np.testing.assert_allclose(distances, told, rtol=1e-12)
    assert not mask.reshape(-1)[nearest].any()
    apart = np.indices(shape) - np.stack(np.unravel_index(nearest, shape))
    length = np.linalg.norm(apart * size.reshape(-1, *(1,) * len(shape)), axis=0)
    np.testing.assert_allclose(length, told, rtol=1e-12)


def test_near_ties_along_long_axes():
    """Two voxels that are nearly as far: which is nearer shows in the last digits."""
    long, size = 100_000, 0.3
    for more in (-1e-9, 1e-9):
        other = size * np.sqrt(20 * (1 + more))
        mask = np.ones((2, long), bool)
        mask[0, long - 20] = mask[1, long - 10] = False
        told = ndimage.distance_transform_edt(mask, (other, size))
        np.testing.assert_allclose(distance_transform(mask, (other, size)), told, rtol=1e-12)


def test_voxels_are_cubes_of_one_unless_told(loops):
    mask = _mask((9, 20, 30), "blobs")
    told = ndimage.distance_transform_edt(mask)
    np.testing.assert_allclose(distance_transform(mask), told, rtol=1e-12)
    np.testing.assert_allclose(distance_transform(mask, 0.5), told / 2, rtol=1e-12)


def test_of_any_layout(loops):
    mask = _mask((9, 20, 30), "blobs")
    assert np.array_equal(distance_transform(mask[::2].T), distance_transform(mask[::2]).T)


def test_where_nothing_lies_outside_it_is_the_diagonal(loops):
    distances, nearest = nearest_outside(np.ones((3, 4, 12), bool), 2.0)
    assert (distances == 26).all()
    assert (nearest == 0).all()
    assert distance_transform(np.ones((0, 4, 4), bool)).shape == (0, 4, 4)


def test_the_number_of_threads_changes_no_bit():
    mask, before, found = _mask((40, 120, 131), "holes"), torch.get_num_threads(), []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            found.append(nearest_outside(mask, (1.3, 0.9, 2.1)))
    finally:
        torch.set_num_threads(before)
    for distances, nearest in found[1:]:
        assert np.array_equal(distances, found[0][0])
        assert np.array_equal(nearest, found[0][1])
