"""Labels that cut one cell in two, or make two cells one, are told by the fit that starts there."""

from dataclasses import replace

import numpy as np
import pytest

from napari_deltamic import GaussianPSF, Grid, Scene, Solid, Surface, fit, simulate
from napari_deltamic.evidence.folds import folds
from napari_deltamic.evidence.residual import analyse_residual
from napari_deltamic.evidence.unseen_walls import unseen_walls
from napari_deltamic.evidence.verdict_rules import RULES
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.labels.meshes import mesh_from_labels
from napari_deltamic.geometry.labels.voxels import voxel_labels
from napari_deltamic.geometry.remeshing import can_remesh
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene.light import MEMBRANES, Light

pytestmark = pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
GRID = Grid((34, 34, 46), (0.2, 0.2, 0.2))
OPTICS = GaussianPSF(0.25)
MIDDLE = np.array([3.3, 3.3, 4.5])
ONE = sphere(MIDDLE, 2.2, edge_length=0.3)
AWAY = np.array([0.0, 0.0, 1.5])
TWO = foam(np.array([MIDDLE - AWAY, MIDDLE + AWAY]), np.array([2.1, 2.1]), 0.3)


def fitted(mesh, labels, light=MEMBRANES):
    shining = []
    if light.membrane:
        shining.append(Surface(mesh, light.membrane))
    if light.interior:
        shining.append(Solid(mesh, light.interior))
    image = simulate(Scene(tuple(shining), OPTICS), GRID, photons=60, background=5.0, seed=3).image
    start = mesh_from_labels(labels, GRID.voxel_size)
    settings = FitSettings(levels=(1.0,), density="smooth", structure="auto")
    *_, last = fit(image, GRID, start, OPTICS, settings=settings)
    return last


def labels_of(mesh):
    return voxel_labels(mesh, GRID.shape, GRID.voxel_size)


def halved(labels):
    """The right half has a number of its own."""
    right = np.arange(labels.shape[2]) * GRID.voxel_size[2] > MIDDLE[2]
    return np.where((labels > 0) & right, 2, labels)


@pytest.mark.parametrize(
    "light",
    [
        Light(1.0, 0.0),
        *(pytest.param(one, marks=pytest.mark.slow) for one in (Light(0.0, 1.0), Light(1.0, 1.0))),
    ],
)
def test_a_wall_through_one_cell_is_hardly_seen(light):
    assert unseen_walls(fitted(ONE, halved(labels_of(ONE)), light)) == {1: 2, 2: 1}


@pytest.mark.parametrize(
    "light", [Light(1.0, 0.0), pytest.param(Light(1.0, 1.0), marks=pytest.mark.slow)]
)
def test_a_wall_that_shines_is_seen(light):
    last = fitted(TWO, labels_of(TWO), light)
    assert unseen_walls(last) == {}
    assert folds(last) == {}


@pytest.mark.slow
def test_insides_of_two_brightnesses_show_their_wall():
    uneven = Light(0.0, 1.0, ((1, 1.0), (2, 0.6)))
    last = fitted(TWO, labels_of(TWO), Light(0.0, 1.0))
    assert unseen_walls(last) == {1: 2, 2: 1}
    assert unseen_walls(replace(last, light=uneven)) == {}


def test_one_label_for_two_cells_makes_a_fold():
    found = folds(fitted(TWO, (labels_of(TWO) > 0).astype(int)))
    assert list(found) == [1]
    assert found[1] == pytest.approx(tuple(MIDDLE), abs=0.6)


def test_a_label_where_nothing_shines_is_not_shown():
    """A fit makes a shape of the noise there."""
    cell = sphere((3.3, 3.3, 2.8), 2.2, edge_length=0.3)
    empty = sphere((3.3, 3.3, 7.6), 1.1, edge_length=0.3)
    start = mesh_from_labels(labels_of(cell) + 2 * labels_of(empty), GRID.voxel_size)
    scene = Scene((Surface(cell, 1.0),), OPTICS)
    image = simulate(scene, GRID, photons=60, background=5.0, seed=3).image
    settings = FitSettings(levels=(1.0,), density="smooth", max_iterations=60)
    *_, last = fit(image, GRID, start, OPTICS, settings=settings)
    shown = analyse_residual(image, GRID, last).shown()
    assert shown[1] > 50
    assert shown[2] < RULES.shown
