import numpy as np
import pytest
import torch

from napari_deltamic import GaussianPSF, Grid, InputError
from napari_deltamic.fitting.model.checks import check_image, check_mesh, check_psf
from napari_deltamic.geometry import sphere

GRID = Grid((4, 5, 6), (0.2, 0.1, 0.1), (1.0, 2.0, 3.0))


@pytest.fixture
def image():
    return np.random.default_rng(0).random(GRID.shape)


def refused(image, message):
    with pytest.raises(InputError, match=message) as error:
        check_image(image, GRID)
    assert "\n" not in str(error.value)


def test_takes_arrays_and_tensors_of_any_real_type(image):
    for pixels in (image, image.astype(np.float16), (image * 1e4).astype(np.uint16)):
        checked, known = check_image(pixels, GRID)
        assert checked.dtype == np.float32
        assert known.all()
    checked, _ = check_image(torch.from_numpy(image).requires_grad_(), GRID)
    np.testing.assert_allclose(checked, image, rtol=1e-6)


def test_missing_voxels(image):
    image[0, 0] = np.nan
    checked, known = check_image(image, GRID)
    assert np.isfinite(checked).all()
    assert not known[0, 0].any()
    assert known.sum() == image.size - 6
    assert np.isnan(image[0, 0]).all()  # the caller's image is left alone


def test_refuses_other_dimensions(image):
    refused(image[0], "3D image .* 2 dimensions")
    refused(image[None], "4 dimensions")


def test_refuses_an_empty_image():
    refused(np.zeros((0, 5, 6)), "empty")


@pytest.mark.parametrize("kind", [complex, bool, str, object])
def test_refuses_what_is_no_number(image, kind):
    refused(image.astype(kind), "real numbers")


def test_refuses_another_shape(image):
    refused(image[1:], r"shape \(3, 5, 6\), the grid \(4, 5, 6\)")


def test_refuses_infinite_voxels(image):
    image[0, 0, :3] = np.inf, -np.inf, np.nan
    refused(image, "2 infinite voxels")


def test_refuses_an_image_without_a_voxel(image):
    refused(np.full_like(image, np.nan), "missing")


def test_refuses_a_flat_image(image):
    flat = np.full_like(image, 7)
    flat[0] = np.nan
    refused(flat, "flat: every voxel is 7")


def test_mesh_must_meet_the_image():
    check_mesh(sphere((1.3, 2.2, 3.2), 0.1), GRID)
    check_mesh(sphere((1.3, 2.2, 3.6), 0.2), GRID)  # reaches in
    for axis in range(3):
        for side in (-5, 5):
            center = np.array([1.3, 2.2, 3.2])
            center[axis] += side
            with pytest.raises(InputError, match="outside the image") as error:
                check_mesh(sphere(center, 0.1), GRID)
            assert "\n" not in str(error.value)


def test_a_psf_far_wider_than_the_image_is_refused():
    check_psf(GaussianPSF((0.8, 0.3, 0.3)), GRID)
    with pytest.raises(InputError, match=r"5e\+03 um along Y, where the image is only 0.5 um wide"):
        check_psf(GaussianPSF((0.4, 5e3, 0.2)), GRID)
