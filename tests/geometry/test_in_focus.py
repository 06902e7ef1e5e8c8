"""Cells in widefield stacks, in which no dark ground lies above and below them."""

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.geometry import labels_from_points, sphere
from napari_deltamic.geometry.labels.bright_cells import cells_of
from napari_deltamic.geometry.labels.in_focus import RULES, have_rims, in_focus, is_widefield
from napari_deltamic.geometry.labels.voxels import voxel_labels
from napari_deltamic.optics import GaussianPSF, ScalarPSF
from napari_deltamic.scene.light import Light

GRID = nd.Grid((36, 64, 64), (0.4, 0.2, 0.2))
SIZE = np.array(GRID.voxel_size)
WIDEFIELD = ScalarPSF(0.9, 1.1, 1.33)
MIDDLES = [(6.0, 4.0, 4.4), (8.4, 8.6, 8.2)]
CELLS = nd.Mesh.merge([sphere(at, 1.9, edge_length=0.4) for at in MIDDLES])


def seen(optics, light):
    clean = nd.scene.expected_image(CELLS, GRID, optics, 1e-3, 1.0, 0.0, light=light)
    photons = 200 * np.maximum(clean, 0) / clean.max() + 10
    return np.random.default_rng(0).poisson(photons).astype(float)


@pytest.fixture(scope="module", params=[(1.0, 0.0), (0.0, 1.0)], ids=["membranes", "insides"])
def light(request):
    return Light(*request.param)


@pytest.fixture(scope="module")
def widefield(light):
    return seen(WIDEFIELD, light)


def overlaps(labels):
    """Intersection over union of each cell with the label at its middle."""
    true, found = voxel_labels(CELLS, GRID.shape, GRID.voxel_size), []
    for name, middle in enumerate(MIDDLES, 1):
        voxel = tuple(np.rint(np.array(middle) / SIZE).astype(int))
        cell, own = true == name, (labels == labels[voxel]) & (labels[voxel] > 0)
        found.append((cell & own).sum() / (cell | own).sum())
    return found


def test_points_name_the_cells_not_their_light_cones(widefield):
    assert min(overlaps(labels_from_points(widefield, SIZE, MIDDLES))) > 0.5


def test_find_cells_finds_them(widefield):
    found = cells_of(widefield, GRID.voxel_size)
    assert found.labels.max() == len(MIDDLES)
    assert min(overlaps(found.labels)) > 0.5


def test_stacks_that_section_optically_stay_as_they_are(light):
    image = seen(GaussianPSF((0.6, 0.25, 0.25)), light)
    assert in_focus(image, SIZE) is image


def test_a_few_slices_or_one_value_tell_nothing(widefield):
    assert is_widefield(widefield, SIZE)
    assert not is_widefield(widefield[: RULES.slices - 1], SIZE)
    assert not is_widefield(np.full((8, 8, 8), 3.0), SIZE)


def test_a_gap_between_light_cones_has_no_rim():
    image = seen(WIDEFIELD, Light(1.0, 0.0))
    labels = voxel_labels(CELLS, GRID.shape, GRID.voxel_size).astype(np.int32)
    labels[4:9, 40:52, 40:52] = 3
    assert have_rims(labels, in_focus(image, SIZE), SIZE).tolist() == [True, True, False]
