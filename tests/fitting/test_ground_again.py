"""Light that was taken for another object's, asked again where a fit has ended."""

from dataclasses import replace

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.fitting.job import FitInput, following
from napari_deltamic.fitting.model.fitted import Fitted
from napari_deltamic.fitting.model.problem import Problem
from napari_deltamic.fitting.successor import OWN_LIGHT
from napari_deltamic.fitting.voxels.ground_again import RULES, ground_again
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.labels.voxels import voxel_labels
from napari_deltamic.measure.surface_distance import distance_to_surface
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings
from napari_deltamic.scene.effects import Effects
from napari_deltamic.scene.light import Light

GRID = nd.Grid((24, 24, 40), (0.2, 0.2, 0.2))
MIDDLE, BESIDE = (2.3, 2.3, 2.3), (2.3, 2.3, 6.0)
OPTICS = nd.GaussianPSF((0.24, 0.24, 0.24))
CELL = sphere(MIDDLE, 1.4, edge_length=0.3)
OTHER = sphere(BESIDE, 1.2, edge_length=0.3)


def image() -> np.ndarray:
    """A bright cell, and another one that has no mesh."""
    given = GRID, OPTICS, 1e-3, 1.0, 0.0
    both = sum(nd.scene.expected_image(m, *given, light=Light(0.0, 1.0)) for m in (CELL, OTHER))
    photons = 100 * np.maximum(both, 0) / both.max() + 4
    return np.random.default_rng(0).poisson(photons).astype(np.float32)


def ground() -> np.ndarray:
    """(Z, Y, X) bool: without a side of the cell, nor the other one."""
    _, y, x = np.indices(GRID.shape) * 0.2
    return (x < 4.2) & (y < 2.5)


def problem() -> Problem:
    return replace(Problem.of(image(), GRID, ground()), anew=0)


def ended(mesh: nd.Mesh) -> Fitted:
    return Fitted.begun(mesh, OPTICS, Effects(), "smooth", "interior")


def test_what_is_left_of_a_cell_is_its_own():
    found = ground_again(problem(), ended(CELL))
    assert found is not None
    inside = voxel_labels(CELL, GRID.shape, GRID.voxel_size) > 0
    assert found.counted[inside].all()
    assert found.anew == 1
    assert (found.counted | ~ground()).all()  # nothing is lost
    assert not (found.counted & found.foreign).any()


def test_another_cell_stays_one():
    found = ground_again(problem(), ended(CELL))
    inside = voxel_labels(OTHER, GRID.shape, GRID.voxel_size) > 0
    assert found.foreign[inside].mean() > 0.95


def test_a_cell_in_its_own_light_goes_on_with_that(monkeypatch):
    away = sphere((2.3, 1.6, 2.3), 0.8, edge_length=0.3)
    asked = []
    module = "napari_deltamic.fitting.voxels.ground_again"
    monkeypatch.setattr(f"{module}.counted_voxels", lambda *given: asked.append(given))
    assert ground_again(problem(), ended(away)) is None
    assert not asked  # it would take seconds, and there is nothing to gain


@pytest.mark.parametrize("anew", [None, RULES.times])
def test_what_is_given_or_was_asked_often_is_not_asked(anew):
    assert ground_again(replace(problem(), anew=anew), ended(CELL)) is None
    assert ground_again(replace(problem(), foreign=None), ended(CELL)) is None


def fitted(may_change=True, **further):
    begin = sphere((2.3, 2.0, 2.3), 1.2, edge_length=0.4)
    settings = FitSettings(structure="interior", levels=(1.0,))
    given = image(), GRID, begin, OPTICS
    return list(
        nd.fit(
            *given,
            settings=settings,
            counted=ground(),
            counted_may_change=may_change,
            **further,
        )
    )


def off(state) -> float:
    """Voxels."""
    away = np.asarray(distance_to_surface(CELL.vertices_numpy(), state.mesh))
    return float(np.sqrt(np.mean(away**2))) / 0.2


def test_a_fit_goes_on_with_it(tmp_path):
    states = fitted()
    last = states[-1]
    assert last.converged
    assert any(OWN_LIGHT in state.message for state in states)
    assert [state.iteration for state in states] == sorted({s.iteration for s in states})
    assert off(last) < 0.15 < off(fitted(may_change=False)[-1])
    # Whoever judges it judges by these voxels.
    settings = RunSettings(
        image="a.tif", seeds="b.tif", scene=SceneSettings(voxel_size=GRID.voxel_size)
    )
    job = FitInput(settings, image(), GRID, CELL, OPTICS, ground())
    assert following(job, last).counted is last.counted
    assert following(job, states[0]) is job
    # A checkpoint keeps them.
    last.save(tmp_path / "kept.npz")
    resumed = fitted(resume=tmp_path / "kept.npz")
    np.testing.assert_array_equal(resumed[-1].counted, last.counted)
    assert off(resumed[-1]) < 0.15
    kept = dict(np.load(tmp_path / "kept.npz"))
    np.savez(tmp_path / "damaged.npz", **{**kept, "counted": kept["counted"][1:]})
    with pytest.raises(InputError, match="of another image"):
        fitted(resume=tmp_path / "damaged.npz")


def test_voxels_that_are_given_stay():
    assert all(state.counted is None for state in fitted(may_change=False))


def test_a_finger_that_was_left_out_is_the_cells_own():
    """The surface ended beside it, so none of it lies in light of other objects."""
    middle, round_cell = np.array(MIDDLE), sphere(MIDDLE, 1.4, subdivisions=5)
    ahead = (round_cell.vertices_numpy() - middle) / 1.4
    angle = np.arccos(np.clip(ahead[:, 2], -1, 1))
    longer = 1 + 1.8 * np.exp(-0.5 * (angle / 0.2) ** 2)
    fingered = round_cell.with_vertices(middle + 1.4 * ahead * longer[:, None])
    light = nd.scene.expected_image(fingered, GRID, OPTICS, 1e-3, 1.0, 0.0)
    pixels = np.random.default_rng(0).poisson(100 * light / light.max() + 4).astype(np.float32)
    body = np.indices(GRID.shape)[2] * 0.2 < 4.4
    before = replace(Problem.of(pixels, GRID, body), anew=0)
    found = ground_again(before, ended(round_cell))
    assert found is not None
    finger = np.s_[10:13, 10:13, 24:29]
    assert light[finger].min() > 0.2 * light.max()
    assert found.counted[finger].all()
    assert not before.counted[finger].any()
    blank = replace(before, image=np.where(body, pixels, 4).astype(np.float32))
    assert ground_again(blank, ended(round_cell)) is None
