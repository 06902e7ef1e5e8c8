"""A series that goes on knows what it knew; what is good is not lost to what is not."""

import importlib
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from movies import GRID, MIDDLE, NEAR, OPTICS, VOXEL, ball, drifting, tracked

from napari_deltamic import GaussianPSF
from napari_deltamic.fitting.rivals.light_cone import confocal_of, widefield_of
from napari_deltamic.geometry import Mesh
from napari_deltamic.scene.effects import Effects
from napari_deltamic.scene.light import INSIDES, MEMBRANES
from napari_deltamic.tracking import TrackSettings, track
from napari_deltamic.tracking.between_frames import BetweenFrames, structure_of_next
from napari_deltamic.tracking.frames import Frame

module = importlib.import_module("napari_deltamic.tracking.track")


@cache
def first_of_two():
    """The result of the first of two frames, for tests that go on from it."""
    return tracked(drifting(2))[:1]


def test_divisions_are_looked_for_right_after_going_on(monkeypatch):
    images = drifting(2)
    done = first_of_two()
    calls = []
    monkeypatch.setattr(module, "proposals", lambda *arguments: calls.append(1) or [])
    tracked(images, done=done)
    assert calls == [1, 1]  # in what the end of the fit left, and in what its start did


@pytest.mark.slow
def test_a_dark_frame_right_after_going_on_is_left_out():
    images = np.array(drifting(3))
    done = tracked(images[:2])
    images[2] = 2 + 0.1 * (images[2] - 2)
    (result,) = tracked(images, done=done)
    assert result.mesh is None
    assert "dark" in result.message


@pytest.mark.parametrize("series", [list, iter], ids=["sequence", "iterator"])
def test_going_on_starts_from_the_last_mesh_and_the_first_psf(series):
    """It is one microscope: from frame to frame the PSF would drift."""
    images = drifting(3)
    held = NEAR.model_copy(update={"fit_psf": False})
    states = track(images[:2], GRID, ball(), OPTICS, held)
    done = [state.done for state in states if state.done is not None]
    assert done[1].psf == pytest.approx(tuple(OPTICS.parameters().tolist()))
    wider = [
        replace(r, psf=tuple(p + more for p in r.psf))
        for r, more in zip(done, (0.1, 0.3), strict=True)
    ]
    settings = NEAR.model_copy(update={"fit_psf": True})
    first = next(track(series(images), GRID, ball(), OPTICS, settings, done=wider))
    assert first.frame == 2
    found = first.fit.optics.parameters().tolist()
    assert found == pytest.approx(list(wider[0].psf), rel=1e-2)
    assert len(first.fit.mesh.vertices) == len(done[1].mesh.vertices)


def tilted(sigma):
    z, y, x = sigma
    return GaussianPSF(covariance=[[z * z, 0, z * x / 2], [0, y * y, 0], [z * x / 2, 0, x * x]])


def test_a_tilted_psf_takes_over():
    past = BetweenFrames(GRID, ball(), OPTICS, first=0)
    for number, optics in enumerate((OPTICS, tilted(OPTICS.sigma_um), OPTICS)):
        state = SimpleNamespace(optics=optics, loss=0.1, light=MEMBRANES, dimmed=None)
        past.take(Frame.of(number, np.ones(GRID.shape), GRID), state, ball(), [])
        assert past.optics is optics


def test_the_psf_of_the_first_frame_stays_and_that_of_an_objective_takes_over():
    past = BetweenFrames(GRID, ball(), OPTICS, first=0)
    found = [OPTICS.with_parameters(OPTICS.parameters() + k) for k in (0.1, 0.2)]
    found += [confocal_of((0.3, 0.11, 0.11)), confocal_of((0.4, 0.12, 0.12))]
    kept = []
    for number, optics in enumerate(found):
        state = SimpleNamespace(optics=optics, loss=0.1, light=MEMBRANES, dimmed=None)
        past.take(Frame.of(number, np.ones(GRID.shape), GRID), state, ball(), [])
        kept.append(found.index(past.optics))
    assert kept == [0, 0, 2, 2]


@pytest.mark.slow
def test_what_shines_in_the_first_frame_does_in_all_others():
    states = track(drifting(3), GRID, ball(), OPTICS, NEAR.model_copy(update={"structure": "auto"}))
    done = [state.done for state in states if state.done is not None]
    assert [result.structure for result in done] == ["membrane"] * 3
    past = BetweenFrames(GRID, ball(), OPTICS, first=0)
    past.resume([replace(done[0], structure="both"), done[1]], NEAR)
    assert past.structure == "both"


def test_good_divisions_are_kept_where_others_are_not(monkeypatch):
    """Also in the last round: the bad one is left out, and the good one tried again."""
    shifts = (-4.0, 4.0)
    mesh = Mesh.merge([ball((0, 0, s), 3 * VOXEL) for s in shifts])
    past = BetweenFrames(GRID, mesh, OPTICS, first=0)
    tracker = module._Tracker(GRID, past, NEAR, TrackSettings(), Effects(), shared_ground=False)
    walls = [
        SimpleNamespace(
            cell=k + 1, point=MIDDLE + VOXEL * np.array([0, 0, s]), normal=np.array([0.0, 1, 0]),
            brightness=1.0,
        )
        for k, s in enumerate(shifts)
    ]  # fmt: skip

    def fitted(self, frame, start, *, wider=False):
        return SimpleNamespace(mesh=start.mesh), None
        yield

    def proposals(before, mesh):
        return [w for w in walls if w.cell in mesh.region_ids()]

    once = replace(module.RULES.divisions, rounds=1)
    monkeypatch.setattr(module, "RULES", replace(module.RULES, divisions=once))
    monkeypatch.setattr(module._Tracker, "_fit", fitted)
    monkeypatch.setattr(module, "Residual", lambda *arguments: None)
    monkeypatch.setattr(module, "proposals", proposals)
    monkeypatch.setattr(module, "explains", lambda before, after, cell, folded: cell == 1)
    events = []
    frame = Frame.of(1, np.ones(GRID.shape), GRID)
    states = tracker._divide(frame, SimpleNamespace(mesh=mesh), None, events)
    with pytest.raises(StopIteration) as end:
        next(states)
    assert [(e.kind, e.cell) for e in events] == [("divided", 1)]
    assert 2 in end.value.value.mesh.region_ids()


def test_padding_of_a_frame_is_not_known():
    image = 100 + np.random.default_rng(0).poisson(5.0, GRID.shape)
    image[:, :4] = 0
    frame = Frame.of(1, image, GRID)
    assert not frame.known[:, :4].any()
    assert frame.known[:, 4:].all()


@pytest.mark.parametrize(
    "made",
    [
        widefield_of,
        confocal_of,
        lambda sigma: widefield_of(sigma, 0.4),
        lambda sigma: confocal_of(sigma, -0.4),
        GaussianPSF,
        tilted,
    ],
)
def test_going_on_knows_the_psf_that_a_fit_found(made):
    """A frame whose fit went on with the PSF of an objective is followed by it."""
    done = first_of_two()
    found = made((0.3, 0.11, 0.11))
    past = BetweenFrames(GRID, ball(), OPTICS, first=0)
    numbers = tuple(found.parameters().tolist())
    past.resume([replace(done[0], psf=numbers, sigma_um=found.sigma_um)], NEAR)
    assert past.optics.parameters().tolist() == pytest.approx(numbers)
    assert type(past.optics) is type(found)
    past = BetweenFrames(GRID, ball(), OPTICS, first=0)
    past.resume([replace(done[0], psf=(0.1,))], NEAR)
    assert past.optics is OPTICS


@pytest.mark.parametrize(("dimmed", "next_one"), [(None, "interior"), (np.ones(1), "")])
def test_frames_after_one_with_dark_nuclei_ask_for_them(dimmed, next_one):
    """Insides alone would be fitted without nuclei, off by ten times as much as they are."""
    state = SimpleNamespace(light=INSIDES, dimmed=dimmed)
    assert structure_of_next(state) == next_one
