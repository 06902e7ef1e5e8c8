"""Membranes that a fit of insides has taken for insides that reach further out."""

from dataclasses import replace

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.evidence.fainter_membranes import _with_membranes, fainter_membranes
from napari_deltamic.evidence.predicted_error import predicted_error
from napari_deltamic.fitting import fit
from napari_deltamic.fitting.job import FitInput
from napari_deltamic.fitting.uncertainty import curvature as limits
from napari_deltamic.fitting.uncertainty.errors_of_measures import posed_at
from napari_deltamic.fitting.uncertainty.responses import responses_of
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings
from synthetic import CENTER, GRID, OPTICS, RADIUS

FURTHER = 0.065  # um: half a width of the PSF


def ended(membrane, photons=100.0, draw=2, **more):
    """A fit of the inside alone: image, settings, and where it ends."""
    ball = sphere(CENTER, RADIUS, subdivisions=3)
    shining = (nd.Solid(ball), nd.Surface(ball, membrane)) if membrane else (nd.Solid(ball),)
    scene = nd.Scene(shining, OPTICS)
    image = nd.simulate(scene, GRID, photons=photons, background=5.0, seed=draw).image
    settings = FitSettings(levels=(1.0,), structure="interior", **more)
    *_, state = fit(image, GRID, ball, OPTICS, settings=settings)
    return image, settings, state


@pytest.fixture(scope="module")
def hidden():
    return ended(FURTHER, fit_psf=True)


def radius(state):
    return np.cbrt(state.mesh.volumes()[1] * 3 / (4 * np.pi))


def inwards(state, moved):
    """um, in the mean over the surface."""
    out = state.mesh.vertices_numpy() - CENTER
    return -float(np.mean((moved * out).sum(1) / np.linalg.norm(out, axis=1)))


def found(image, settings, state):
    posed = posed_at(image, GRID, state, settings)
    return fainter_membranes(posed, responses_of(posed, state, settings), state)


def test_a_membrane_is_taken_for_an_inside_that_reaches_further(hidden):
    """What makes the other tests worth their name: the fit is wrong, and explains the image."""
    image, _, state = hidden
    assert radius(state) - RADIUS == pytest.approx(FURTHER, rel=0.2)
    left = (image - state.rendered()).ravel()
    assert left @ left == pytest.approx(image.sum(), rel=0.02)


def test_what_is_tried_looks_like_the_fit(hidden):
    """With the surface where it truly is: what differs is small beside what membranes add."""
    image, settings, state = hidden
    posed = posed_at(image, GRID, state, settings)
    width = float(np.prod(state.optics.sigma_um) ** (1 / 3))
    other, _ = _with_membranes(posed, state, FURTHER / width)
    assert other.optics.sigma_um == pytest.approx(OPTICS.sigma_um, rel=0.1)
    before, after = (state.amplitude * posed.shown(s) for s in (state, other))
    inside = replace(other, light=replace(other.light, membrane=0.0))
    without = state.amplitude * posed.shown(inside)
    assert np.linalg.norm(after - before) < 0.2 * np.linalg.norm(without - before)


@pytest.mark.parametrize("most", [None, 10])
def test_it_is_told_how_far_the_surface_may_be_off(hidden, most, monkeypatch):
    if most:
        monkeypatch.setattr(limits, "_MOST_VERTICES", most)
    other = found(*hidden)
    assert other.gain > -1
    assert inwards(hidden[2], other.moved) > 0.35 * FURTHER


def predicted(hidden, structure):
    image, settings, state = hidden
    scene = SceneSettings(voxel_size=GRID.voxel_size, sigma=OPTICS.sigma_um)
    fit = settings.model_copy(update={"structure": structure})
    run = RunSettings(image="", seeds="", scene=scene, fit=fit)
    return predicted_error(FitInput(run, image, GRID, state.mesh, OPTICS, None), state)


def test_the_predicted_error_has_it(hidden):
    found = predicted(hidden, "auto")
    assert found.lacks == "light of membranes"
    assert found.whole.alternative > 0.35 * FURTHER


def test_it_has_not_where_the_user_says_that_insides_alone_shine(hidden):
    found = predicted(hidden, "interior")
    assert found.lacks != "light of membranes"
    assert found.whole.total < 0.2 * FURTHER


@pytest.mark.slow
def test_a_known_psf_tells_them_apart():
    """Of six draws, in the mean; at 100 photons the faintest is as likely as none."""
    moved = []
    for draw in range(6):
        image, settings, state = ended(0.0, 1000.0, draw)
        other = found(image, settings, state)
        moved.append(0.0 if other is None else inwards(state, other.moved))
    assert np.mean(moved) < 0.25 * FURTHER


@pytest.mark.slow
def test_photons_tell_them_apart():
    few, many = (ended(0.0, n, fit_psf=True) for n in (100.0, 5000.0))
    few, many = (inwards(one[2], found(*one).moved) if found(*one) else 0.0 for one in (few, many))
    assert many < few


@pytest.mark.slow
def test_membranes_alone_are_no_insides():
    ball = sphere(CENTER, RADIUS, subdivisions=3)
    made = nd.simulate(nd.Scene.of(ball, OPTICS), GRID, photons=100.0, background=5.0, seed=2)
    *_, state = fit(made.image, GRID, ball, OPTICS, settings=FitSettings(levels=(1.0,)))
    assert found(made.image, FitSettings(levels=(1.0,)), state) is None
