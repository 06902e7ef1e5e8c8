"""A fit whose image shows a tilted PSF goes on with a Gaussian along other axes."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.fitting.job import FitInput, following
from napari_deltamic.fitting.model.imaging import Imaging
from napari_deltamic.fitting.rivals import psf_tails, psf_tilt
from napari_deltamic.fitting.rivals.found_psf import psf_from, values_of
from napari_deltamic.fitting.rivals.psf_tilt import HAS_HALO, of_any_axes, tilt_instead, tilt_of
from napari_deltamic.geometry import sphere
from napari_deltamic.measure.surface_distance import distance_to_surface
from napari_deltamic.results.moved_numbers import moved_numbers
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings
from napari_deltamic.scene.effects import Effects, Halo

GRID = nd.Grid((28, 32, 40), (0.3, 0.15, 0.15))
MIDDLE = (4.2, 2.4, 3.0)
TRUE = sphere(MIDDLE, 1.5, edge_length=0.2)
START = sphere(MIDDLE, 1.4, edge_length=0.3)
ALONG = nd.GaussianPSF((0.35, 0.2, 0.2))


def turned(degrees, long=0.6, across=0.16):
    """A Gaussian whose long axis is turned from Z towards X."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    axes = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return nd.GaussianPSF(covariance=axes.T @ np.diag([long, across, across]) ** 2 @ axes)


def image(optics):
    clean = nd.render(TRUE, GRID, optics, 1e-3).numpy()
    drawn = np.random.default_rng(0).poisson(4 + 60 * clean / clean.max())
    return drawn.astype(np.float32)


def begun(degrees, optics=ALONG, **further):
    settings = FitSettings(structure="membrane")
    return nd.fit(image(turned(degrees)), GRID, START, optics, settings=settings, **further)


@cache
def states(degrees):
    return list(begun(degrees))


def last(degrees):
    return states(degrees)[-1]


def off(state):
    """Voxel sides in the plane; mean over the true surface."""
    return np.mean(distance_to_surface(TRUE.vertices_numpy(), state.mesh)) / 0.15


@pytest.mark.parametrize("degrees", [35, -30])
def test_a_tilted_psf_is_found(degrees):
    state = last(degrees)
    found = state.optics.covariance
    assert not state.optics.diagonal
    assert torch.allclose(found, turned(degrees).covariance, atol=0.02)
    assert off(state) < 0.15


def test_one_along_the_axes_stays_along_them():
    state = last(0)
    assert not isinstance(state.optics, nd.GaussianPSF) or state.optics.diagonal


def test_the_fit_says_so_and_its_settings_hold_it():
    state, scene = last(35), SceneSettings(voxel_size=GRID.voxel_size, sigma=ALONG.sigma_um)
    settings = RunSettings(image="", scene=scene, seeds="")
    job = FitInput(settings, image(turned(35)), GRID, START, ALONG, None)
    again = following(job, state)
    assert not again.optics.diagonal
    assert torch.allclose(again.settings.scene.optics.build().covariance, state.optics.covariance)
    named = {number.name: number.now for number in moved_numbers(state, job)}
    assert named["PSF, tilt towards X"] == pytest.approx(35, abs=3)
    assert named["PSF, tilt towards Y"] == pytest.approx(0, abs=3)


@pytest.mark.parametrize("own", [False, True])
def test_a_checkpoint_goes_on_with_it(tmp_path, own):
    """Also with settings that hold the PSF as it was then, as a run that was ended writes them."""
    first = [state.optics.diagonal for state in states(35)].index(False)
    kept = states(35)[first + 5]
    kept.save(tmp_path / "state.npz")
    *_, resumed = begun(35, kept.optics if own else ALONG, resume=tmp_path / "state.npz")
    assert resumed.iteration == last(35).iteration
    np.testing.assert_allclose(
        resumed.mesh.vertices_numpy(), last(35).mesh.vertices_numpy(), atol=1e-6
    )


def tailed(degrees):
    """As a light sheet leaves it: a part of what the objective's cone would spread."""
    core = turned(degrees)
    wide = nd.GaussianPSF(covariance=core.covariance + 0.5**2 * torch.eye(3))
    clean = sum(s * nd.render(TRUE, GRID, p, 1e-3).numpy() for s, p in ((0.6, core), (0.4, wide)))
    drawn = np.random.default_rng(0).poisson(4 + 60 * clean / clean.max())
    return drawn.astype(np.float32)


def begun_tailed(optics=ALONG, **further):
    given = tailed(35), GRID, START, optics
    return nd.fit(*given, settings=FitSettings(structure="membrane"), **further)


@cache
def states_tailed():
    return list(begun_tailed())


def test_its_tails_are_found_as_a_halo():
    state = states_tailed()[-1]
    assert not state.optics.diagonal
    assert state.effects.halo.fraction == pytest.approx(0.4, abs=0.1)
    assert off(state) < 0.12
    assert last(35).effects.halo is None


def test_the_halo_around_a_tilted_one_is_found_too():
    """As in the next frame of a series, which begins with the PSF of the one before."""
    states = list(begun_tailed(turned(35)))
    assert any(HAS_HALO in state.message for state in states)
    assert states[-1].effects.halo.fraction == pytest.approx(0.4, abs=0.1)
    plain = nd.fit(image(turned(35)), GRID, START, turned(35), settings=FitSettings())
    assert all(state.effects.halo is None for state in plain)


def test_settings_hold_the_halo_and_let_it_go_again():
    scene = SceneSettings(voxel_size=GRID.voxel_size, sigma=ALONG.sigma_um)
    settings = RunSettings(image="", scene=scene, seeds="")
    job = FitInput(settings, tailed(35), GRID, START, ALONG, None)
    again = following(job, states_tailed()[-1])
    assert again.settings.scene.effects.names == ("halo",)
    assert following(again, states_tailed()[-1]) is again
    back = following(again, states_tailed()[0])
    assert back.settings.scene.effects.names == ()


@pytest.mark.parametrize("own", [False, True])
def test_a_checkpoint_goes_on_with_a_halo(tmp_path, own):
    first = [state.optics.diagonal for state in states_tailed()].index(False)
    kept = states_tailed()[first + 5]
    kept.save(tmp_path / "state.npz")
    given = {"optics": kept.optics, "effects": kept.effects} if own else {}
    *_, resumed = begun_tailed(**given, resume=tmp_path / "state.npz")
    end = states_tailed()[-1]
    assert resumed.iteration == end.iteration
    assert resumed.effects.halo == end.effects.halo
    np.testing.assert_allclose(resumed.mesh.vertices_numpy(), end.mesh.vertices_numpy(), atol=1e-6)


def test_where_it_began_comes_back_from_plain_values():
    optics = turned(20)
    assert torch.equal(psf_from(values_of(optics)).covariance, optics.covariance)
    assert values_of(ALONG) is None


def test_the_axes_of_one_may_turn_freely():
    """Widths across are held alike only along the axes of the image."""
    along, free = (
        Imaging(psf, Effects(), psf, True, False).prior_curvature()
        for psf in (ALONG, of_any_axes(ALONG))
    )
    assert along[1, 2] != 0
    assert free[1, 2] == 0
    assert (free[3:] == 0).all()


def test_how_tilted():
    assert tilt_of(ALONG) == pytest.approx(0)
    assert tilt_of(of_any_axes(ALONG)) == pytest.approx(0)
    assert tilt_of(turned(45, 0.6, 0.2)) == pytest.approx((0.36 - 0.04) / (0.36 + 0.04))


@pytest.mark.parametrize(("degrees", "stops"), [(0.0, True), (5.0, True), (15.0, False)])
def test_steps_end_where_it_turns_too_little(monkeypatch, degrees, stops):
    """Whatever they gain: that may be what the fit had left to gain."""
    asked = []

    def stepped(rival, hopeless=None):
        if hopeless is None:
            return rival, 1
        asked.append(hopeless(rival))
        rival.fitted = rival.fitted.seen_through(turned(degrees, 0.4, 0.2))
        asked.append(hopeless(rival))
        return rival, 1

    class Fitted(SimpleNamespace):
        effects = Effects(halo=Halo())  # no other is tried

        def seen_through(self, optics):
            return Fitted(optics=optics, first_optics=ALONG)

    def begun(terms, fitted, factored):
        rival = SimpleNamespace(fitted=fitted)
        rival.anew = lambda: rival
        return rival

    monkeypatch.setattr(psf_tilt, "begun", begun)
    monkeypatch.setattr(psf_tilt, "stepped", stepped)
    monkeypatch.setattr(psf_tilt, "share_left", lambda rival, image: 0.5)
    monkeypatch.setattr(psf_tails, "share_left", lambda rival, image: 1 - 0.1 * len(asked))
    terms = SimpleNamespace(settings=FitSettings(), second=None, level=SimpleNamespace(grid=GRID))
    tilt_instead(None, terms, Fitted(optics=ALONG, first_optics=ALONG), None)
    assert asked == [False, stops]
