"""Neighbours that a cell has swallowed through a neck are let go once the fit has ended."""

from dataclasses import replace

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.fitting.checkpoint import problem_in
from napari_deltamic.fitting.model.fitted import Fitted
from napari_deltamic.fitting.model.problem import Problem
from napari_deltamic.fitting.successor import LET_GO
from napari_deltamic.fitting.voxels.ground_again import RULES, ground_again, with_ground
from napari_deltamic.fitting.voxels.letting_go import let_neighbours_go
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.labels.meshes import mesh_from_labels
from napari_deltamic.geometry.labels.voxels import voxel_labels
from napari_deltamic.geometry.topology.crossings import crosses
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene.effects import Effects
from napari_deltamic.scene.light import Light

GRID = nd.Grid((24, 24, 44), (0.2, 0.2, 0.2))
OPTICS = nd.GaussianPSF(0.24)
MIDDLE, BESIDE = (2.3, 2.3, 2.3), (2.3, 2.3, 5.6)
CELL, OTHER = sphere(MIDDLE, 1.4, edge_length=0.3), sphere(BESIDE, 1.2, edge_length=0.3)


def dumbbell(third: int = 0) -> nd.Mesh:
    """The cell and the other one as one region, joined by a neck; third : a region behind it."""
    places = np.moveaxis(np.indices(GRID.shape), 0, -1) * 0.2
    labels = voxel_labels(nd.Mesh.merge([CELL, OTHER]), GRID.shape, GRID.voxel_size).clip(max=1)
    neck = (np.linalg.norm(places[..., :2] - MIDDLE[:2], axis=-1) < 0.35) & (
        abs(places[..., 2] - 4.0) < 0.8
    )
    labels = np.where(neck, 1, labels).astype(np.int32)
    if third:
        far = (np.linalg.norm(places - BESIDE, axis=-1) < 1.9) & (places[..., 2] > 5.9)
        labels[far & (labels == 0)] = third
    return mesh_from_labels(labels, GRID.voxel_size)


def image() -> np.ndarray:
    given = GRID, OPTICS, 1e-3, 1.0, 0.0
    both = sum(nd.scene.expected_image(m, *given, light=Light(1.0, 0.5)) for m in (CELL, OTHER))
    photons = 100 * np.maximum(both, 0) / both.max() + 4
    return np.random.default_rng(0).poisson(photons).astype(np.float32)


def problem(anew: int | None = 0) -> Problem:
    return replace(Problem.of(image(), GRID), anew=anew)


def ended(mesh: nd.Mesh) -> Fitted:
    return Fitted.begun(mesh, OPTICS, Effects(), "smooth", "both")


def test_the_cell_stays_and_the_other_becomes_foreign():
    found = let_neighbours_go(problem(), CELL, ended(dumbbell()))
    assert found is not None
    further, mesh = found
    assert mesh.volumes()[1] == pytest.approx(CELL.volumes()[1], rel=0.06)
    assert (mesh.edge_uses() == 2).all()
    assert not crosses(mesh)
    labels = {
        name: voxel_labels(one, GRID.shape, GRID.voxel_size) > 0
        for name, one in (("cell", CELL), ("other", OTHER))
    }
    assert further.counted[labels["cell"]].all()
    assert further.foreign[labels["other"]].all()
    assert ground_again(further, ended(mesh)) is None
    assert let_neighbours_go(further, CELL, ended(dumbbell())) is not None


def test_a_neck_thinner_than_voxels_goes_too():
    """Neither part holds a voxel of it: it would stay as a spike, half as long."""
    size, beside = 0.1, np.array([2.3, 2.3, 6.2])
    places = np.moveaxis(np.indices((48, 48, 88)), 0, -1) * size
    balls = [np.linalg.norm(places - c, axis=-1) < r for c, r in ((MIDDLE, 1.4), (beside, 1.2))]
    axis = np.linalg.norm(places[..., :2] - MIDDLE[:2], axis=-1)
    neck = (axis < 0.12) & (places[..., 2] > 2.3) & (places[..., 2] < 6.2)
    mesh = mesh_from_labels((balls[0] | balls[1] | neck).astype(np.int32), (size,) * 3)
    _, cut = let_neighbours_go(problem(), CELL, ended(mesh))
    assert cut.vertices_numpy()[:, 2].max() < 2.3 + 1.4 + 0.35  # the diagonal of a voxel
    assert cut.volumes()[1] == pytest.approx(CELL.volumes()[1], rel=0.06)


def test_what_the_start_had_stays():
    assert let_neighbours_go(problem(), dumbbell(), ended(dumbbell())) is None
    assert let_neighbours_go(problem(), CELL, ended(CELL)) is None


def test_a_cell_that_touches_another_one_stays():
    assert let_neighbours_go(problem(), CELL, ended(dumbbell(third=2))) is None


def test_voxels_that_are_given_stay():
    assert let_neighbours_go(problem(None), CELL, ended(dumbbell())) is None


def test_neighbours_are_let_go_so_often_and_stay_foreign():
    given, times = problem(), 0
    while found := let_neighbours_go(given, CELL, ended(dumbbell())):
        given, times = found[0], times + 1
        assert given.let_go.max() == times
        assert given.anew == 0  # light of cells is still asked for again
        assert not with_ground(given, np.ones(GRID.shape, bool), 1).counted[given.let_go > 0].any()
    assert times == RULES.times


def test_a_fit_that_grows_through_a_neck_goes_on_without_the_other(tmp_path):
    """All voxels count, so the surface grows into the other cell."""
    given, everywhere = (image(), GRID, CELL, OPTICS), np.ones(GRID.shape, bool)
    settings = FitSettings(levels=(1.0,), structure="both")
    states = list(nd.fit(*given, settings=settings, counted=everywhere, counted_may_change=True))
    assert max(state.mesh.volumes()[1] for state in states) > 1.5 * CELL.volumes()[1]
    assert states[-1].mesh.volumes()[1] == pytest.approx(CELL.volumes()[1], rel=0.02)
    assert sum(LET_GO in state.message for state in states) == 1
    # A checkpoint keeps what was let go.
    states[-1].save(tmp_path / "kept.npz")
    kept = dict(np.load(tmp_path / "kept.npz"))
    given_once = problem_in(kept, problem())
    assert given_once.let_go.max() == 1
    np.testing.assert_array_equal(given_once.counted, states[-1].counted)
    with pytest.raises(InputError, match="its neighbours are of another image"):
        problem_in({**kept, "let_go": kept["let_go"][1:]}, problem())
