"""Nuclei in cytoplasm that shines, too, are fitted with a local background."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.fitting.model.problem import Problem
from napari_deltamic.fitting.rivals import lit_surroundings
from napari_deltamic.fitting.rivals.lit_surroundings import IS_LIT, RULES
from napari_deltamic.fitting.successor import EVEN
from napari_deltamic.fitting.voxels.local_background import with_local_background
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene.effects import Background, Effects
from napari_deltamic.scene.light import Light
from napari_deltamic.scene.render import offset

GRID = nd.Grid((26, 36, 36), (0.2, 0.2, 0.2))
MIDDLE = (2.5, 3.5, 3.5)
TRUE = sphere(MIDDLE, 1.3, edge_length=0.25)
BODY = sphere((2.5, 3.3, 3.6), 2.3, edge_length=0.4)
START = sphere(MIDDLE, 1.2, edge_length=0.35)
PSF = nd.GaussianPSF((0.35, 0.25, 0.25))
WIDE = nd.GaussianPSF((0.6, 0.45, 0.45))


@cache
def image(cytoplasm):
    lit = (nd.Solid(TRUE, 1 - cytoplasm), nd.Solid(BODY, cytoplasm))
    clean = nd.render_scene(nd.Scene(lit, PSF), GRID).numpy()
    drawn = np.random.default_rng(0).poisson(5 + 100 * clean / clean.max())
    return drawn.astype(np.float32)


def begun(cytoplasm=0.3, optics=WIDE, **further):
    given = image(cytoplasm), GRID, START, optics
    return nd.fit(*given, settings=FitSettings(levels=(1.0,)), **further)


@cache
def states(cytoplasm=0.3):
    return list(begun(cytoplasm))


def off(state):
    """Share by which the nucleus is too large."""
    return state.mesh.volumes()[1] / TRUE.volumes()[1] - 1


def first_with_it():
    return next(k for k, s in enumerate(states()) if s.local_background is not None)


def test_a_nucleus_in_cytoplasm_has_its_size():
    told = [IS_LIT in state.message for state in states()].index(True)
    assert abs(off(states()[told])) > 0.15
    assert first_with_it() == told + 1
    assert abs(off(states()[-1])) < 0.13
    assert states()[-1].converged
    assert not any(EVEN in state.message for state in states())


def test_one_on_dark_ground_has_none():
    assert all(state.local_background is None for state in states(0.0))
    assert not any(IS_LIT in state.message for state in states(0.0))


def test_the_rendered_image_has_it():
    state = states()[-1]
    without = replace(state, local_background=None).rendered()
    assert np.allclose(state.rendered() - without, state.local_background, atol=1e-3)
    left = image(0.3) - state.rendered()
    assert left.std() < 0.5 * (image(0.3) - without).std()
    assert np.allclose(state.without_local_background(image(0.3)) - without, left, atol=1e-3)


@pytest.mark.parametrize("after", [-3, 5])
def test_a_checkpoint_goes_on_with_it(tmp_path, after):
    """Held against the fit without it, too."""
    taken = states()[first_with_it() + after if after > 0 else after]
    taken.save(tmp_path / "kept.npz")
    resumed = list(begun(resume=tmp_path / "kept.npz"))
    assert np.array_equal(resumed[-1].mesh.vertices_numpy(), states()[-1].mesh.vertices_numpy())
    assert np.array_equal(resumed[-1].local_background, states()[-1].local_background)


def test_one_of_another_image_is_refused(tmp_path):
    states()[-1].save(tmp_path / "kept.npz")
    with np.load(tmp_path / "kept.npz") as kept:
        arrays = dict(kept)
    arrays["local_background"] = arrays["local_background"][1:]
    np.savez(tmp_path / "other.npz", **arrays)
    with pytest.raises(InputError, match="local background is of another image"):
        begun(resume=tmp_path / "other.npz")


def problem():
    return Problem.of(image(0.3), GRID)


def test_it_is_what_surrounds_the_cells_continued_across_them():
    found = with_local_background(problem(), START, PSF.sigma_um, Effects())
    around = found.local_background
    assert np.allclose(found.image + around, image(0.3), atol=1e-3)
    middle = tuple(np.rint(np.asarray(MIDDLE) / 0.2).astype(int))
    seen = image(0.3)
    assert around[middle] < 0.5 * (seen[middle] - np.median(seen))
    assert around[middle] > 0.1 * (seen[middle] - np.median(seen))
    assert abs(np.median(around[0])) < 3  # the even ground is the fit's


def test_where_nothing_beside_the_cells_counts_there_is_none():
    nowhere = np.zeros(GRID.shape, bool)
    nowhere[8:18, 12:24, 12:24] = True
    alone = replace(problem(), counted=nowhere)
    assert with_local_background(alone, START, PSF.sigma_um, Effects()) is None


def test_light_of_other_objects_is_no_background():
    bright = image(0.3).copy()
    bright[:, :, :8] += 500
    foreign = np.zeros(GRID.shape, bool)
    foreign[:, :, :8] = True
    given = replace(Problem.of(bright, GRID, ~foreign))
    found = with_local_background(given, START, PSF.sigma_um, Effects()).local_background
    assert found.max() < 100


def test_it_is_found_through_a_psf_that_is_held():
    given = image(0.3), GRID, START, PSF
    held = FitSettings(levels=(1.0,), fit_psf=False, structure="interior")
    found = list(nd.fit(*given, settings=held))
    even = next(s for s in reversed(found) if s.local_background is None)
    assert found[-1].local_background is not None
    assert found[-1].optics.sigma_um == PSF.sigma_um
    assert abs(off(found[-1])) < 0.7 * abs(off(even))


def test_what_effects_add_is_no_background():
    slope = Effects(background=Background(coefficients=(0.0, 0.0, 30.0)))
    added = offset(slope, GRID).numpy().astype(np.float32)
    assert np.ptp(added) > 50
    risen = Problem.of(image(0.3) + added, GRID)
    given = START, PSF.sigma_um
    plain = with_local_background(problem(), *given, Effects()).local_background
    found = with_local_background(risen, *given, slope).local_background
    assert np.allclose(found, plain, atol=0.01)


@pytest.mark.parametrize(("times", "begins"), [(0.99, True), (1.01, False)])
def test_a_trial_that_begins_far_off_takes_no_step(monkeypatch, times, begins):
    """In an embryo of 56 cells, whose membranes shine, its steps were a fifth of the fit."""
    ratios, trials = [times * RULES.hopeless, 2 * RULES.hopeless], []

    def stepped(rival):
        trials.append(rival)
        return rival, 7

    monkeypatch.setattr(lit_surroundings, "_left_over", lambda one, other: ratios)
    monkeypatch.setattr(lit_surroundings, "stepped", stepped)
    found = list(begun())
    assert bool(trials) == begins
    assert not any(IS_LIT in state.message for state in found)


@pytest.mark.parametrize(("interior", "lit"), [(1.0, True), (-1.0, False)])
def test_a_thick_bright_layer_is_no_light_around_cells(monkeypatch, interior, lit):
    """Taken for a local background around a dark inside, one ended 2.8 voxels off."""

    def stepped(rival):
        now = SimpleNamespace(light=Light(0.0, interior))
        return SimpleNamespace(now=now, fitted=rival.fitted, own_light=rival.own_light), 7

    monkeypatch.setattr(lit_surroundings, "stepped", stepped)
    monkeypatch.setattr(lit_surroundings, "explains_more_beside", lambda one, other: True)
    assert any(IS_LIT in state.message for state in begun()) == lit


@pytest.mark.parametrize(("wide", "lit"), [(1.2, True), (1.3, False)])
def test_what_leaves_the_psf_wide_is_no_light_around_cells(monkeypatch, wide, lit):
    """A local background made of their own light left nuclei with chromatin 8 % too small."""

    def stepped(rival):
        fitted = replace(rival.fitted, optics=nd.GaussianPSF(wide * np.array(WIDE.sigma_um)))
        now = SimpleNamespace(light=Light(0.0, 1.0))
        return SimpleNamespace(now=now, fitted=fitted, own_light=rival.own_light), 7

    monkeypatch.setattr(lit_surroundings, "stepped", stepped)
    monkeypatch.setattr(lit_surroundings, "explains_more_beside", lambda one, other: True)
    assert any(IS_LIT in state.message for state in begun()) == lit
