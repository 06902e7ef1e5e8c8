"""What a fit takes as it is meant, or refuses with a reason."""

import numpy as np
import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.errors import InputError, RepairWarning
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.labels.voxels import voxel_labels
from napari_deltamic.runs.settings import FitSettings

GRID, OPTICS = nd.Grid((12, 13, 14), (0.5, 0.4, 0.4)), nd.GaussianPSF((0.6, 0.5, 0.5))
CENTRE = (2.7, 2.4, 2.6)
SHORT = FitSettings(levels=(2.0, 1.0), max_iterations=5)


@pytest.fixture(scope="module")
def image():
    return nd.render(sphere(CENTRE, 1.5, edge_length=0.5), GRID, OPTICS).numpy() + 0.1


def start():
    return sphere(CENTRE, 1.2, edge_length=0.6)


def fitted(image, mesh=None, settings=SHORT):
    *_, last = nd.fit(image, GRID, mesh or start(), OPTICS, settings=settings)
    return last


def test_masks_of_masked_arrays_count(image):
    hidden = np.zeros(image.shape, bool)
    hidden[:, :4] = True
    spoilt = np.where(hidden, 50.0, image)
    one = fitted(np.ma.MaskedArray(spoilt, hidden))
    other = fitted(np.where(hidden, np.nan, image))
    assert np.array_equal(one.mesh.vertices, other.mesh.vertices)
    whole = np.ma.MaskedArray((100 * spoilt).astype(np.uint16), hidden)
    fitted(whole)


@pytest.mark.parametrize("factor", [1e-30, 1e-20, 1e-15, 1e19, 1e30, 1e60])
def test_values_beyond_single_precision_are_refused(image, factor):
    with pytest.raises(InputError, match="multiply it by a number"):
        fitted(image.astype(np.float64) * factor)


@pytest.mark.parametrize("factor", [1e-6, 1e14])
def test_the_unit_of_the_image_does_not_matter(image, factor):
    one, other = fitted(image), fitted(image.astype(np.float64) * factor)
    assert other.loss == pytest.approx(one.loss, rel=1e-3)
    assert np.allclose(other.mesh.vertices, one.mesh.vertices, atol=1e-4)


@pytest.mark.parametrize("likelihood", ["robust", "paper"])
def test_gradients_that_the_caller_turned_off(image, likelihood):
    settings = SHORT.model_copy(update={"likelihood": likelihood})
    with torch.no_grad():
        one = fitted(image, settings=settings)
        assert not torch.is_grad_enabled()
    assert np.array_equal(one.mesh.vertices, fitted(image, settings=settings).mesh.vertices)
    with torch.inference_mode(), pytest.raises(InputError, match="inference_mode"):
        fitted(image, settings=settings)


def test_a_mesh_that_is_inside_out_is_turned(image):
    mesh = start()
    turned = nd.Mesh(mesh.vertices, mesh.faces[:, ::-1], mesh.regions)
    with pytest.warns(RepairWarning, match="turned 1 inside-out surface"):
        labels = voxel_labels(turned, GRID.shape, GRID.voxel_size)
    assert np.array_equal(labels, voxel_labels(mesh, GRID.shape, GRID.voxel_size))
    assert labels.mean() > 0.02
    with pytest.warns(RepairWarning, match="turned 1 inside-out surface"):
        found = fitted(image, turned)
    assert found.mesh.region_volume(1) > 0
