"""Cells come to touch, part and exchange neighbours while a fit runs."""

import numpy as np
import pytest

from napari_deltamic import Change, GaussianPSF, Grid, Mesh, fit, render
from napari_deltamic.geometry import remesh, sphere, torus
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.remeshing import can_remesh
from napari_deltamic.geometry.topology.crossings import crosses
from napari_deltamic.geometry.topology.rearranging import Rearranged
from napari_deltamic.inference import topology as module
from napari_deltamic.inference.run import Run
from napari_deltamic.measure import surface_distance
from napari_deltamic.settings import FitSettings

pytestmark = pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
VOXEL = 0.1
OPTICS = GaussianPSF(0.13)
SETTINGS = FitSettings(levels=(3.0, 1.5, 1.0))


def contacts(mesh):
    return {(int(min(p)), int(max(p))) for p in mesh.interfaces()[0] if min(p) > 0}


def photographed(truth, start):
    """Image with a peak of 40 photons, noise included, and its grid."""
    bounds = np.stack([truth.bounds(), start.bounds()])
    low, high = bounds[:, 0].min(0) - 0.6, bounds[:, 1].max(0) + 0.6
    shape = tuple(int(n) for n in np.ceil((high - low) / VOXEL) + 1)
    grid = Grid(shape, (VOXEL,) * 3, tuple(low))
    image = render(truth, grid, OPTICS, 1e-4).numpy().astype(np.float64)
    image = 2 + 40 * image.clip(0) / image.max()
    return np.random.default_rng(0).poisson(image), grid


def fitted(truth, start, settings=SETTINGS):
    image, grid = photographed(truth, start)
    states = list(fit(image, grid, start, OPTICS, settings=settings))
    assert not any(crosses(s.mesh) for s in states)
    last = states[-1]
    assert last.converged
    assert last.mesh.is_closed()
    return last, "; ".join(e for s in states for e in s.events)


def error(mesh, truth):
    return surface_distance(mesh, truth, 4000).mean / VOXEL


def four(half, edge, radius=0.75):
    """Four cells in a ring: 1 and 2 touch across it if ``half`` is small, else 3 and 4 do."""
    return foam(
        np.array([[0, 0, -half], [0, 0, half], [0, -0.6, 0], [0, 0.6, 0]]), np.full(4, radius), edge
    )


def dumbbell(neck, edge):
    """Two balls and a neck between them, along Z."""
    ball = remesh(sphere((0, 0, 0), 0.7, 0.08), 0.08).mesh
    places = ball.vertices_numpy() / 0.7
    along = places[:, 0].copy()
    wide = np.clip((np.abs(along) - 0.1) / 0.8, 0, 1) ** 1.5
    places[:, 1:] *= (neck + (1 - neck) * wide)[:, None]
    places[:, 0] *= 2
    return remesh(ball.with_vertices(0.7 * places), edge, apart=True).mesh


def beside(mesh, distance, radius):
    return Mesh.merge([mesh, sphere((0, distance, 0), radius, 0.2)])


def two_in_one(one, other):
    places = np.concatenate([one.vertices, other.vertices])
    return Mesh(places, np.concatenate([one.faces, other.faces + len(one.vertices)]))


def test_neighbours_are_exchanged():
    truth, start = four(0.75, 0.12), four(0.5, 0.2)
    assert contacts(truth) != contacts(start)
    last, told = fitted(truth, start)
    assert contacts(last.mesh) == contacts(truth)
    assert error(last.mesh, truth) < 0.15
    assert "3" in told
    assert "4" in told


def test_cells_that_come_to_touch_share_a_wall():
    truth = foam(np.array([[0, 0, -0.5], [0, 0, 0.5]]), np.array([0.65, 0.65]), 0.1)
    start = Mesh.merge([sphere((0, 0, -0.55), 0.45, 0.2), sphere((0, 0, 0.55), 0.45, 0.2)])
    last, told = fitted(truth, start)
    assert contacts(last.mesh) == {(1, 2)}
    assert error(last.mesh, truth) < 0.15
    assert told == "cell 1 touches cell 2"


def test_a_neck_is_pinched_off():
    apart = two_in_one(sphere((-0.75, 0, 0), 0.6, 0.12), sphere((0.75, 0, 0), 0.6, 0.12))
    truth, start = beside(apart, 1.9, 0.5), beside(dumbbell(0.3, 0.2), 1.9, 0.45)
    last, told = fitted(truth, start)
    assert error(last.mesh, truth) < 0.15
    assert told == "cell 1 was pinched off into 2 pieces"


def test_a_hole_closes():
    disc = sphere((0, 0, 0), 1.4, 0.14)
    flat = disc.with_vertices(disc.vertices_numpy() * (0.45, 1, 1))
    ring = remesh(torus((0, 0, 0), 1.0, 0.6, 0.1), 0.2).mesh
    hollow = ring.with_vertices(ring.vertices_numpy() * (0.9, 0.8, 0.8))
    truth, start = beside(flat, 2.1, 0.5), beside(hollow, 2.1, 0.45)
    last, told = fitted(truth, start)
    assert error(last.mesh, truth) < 0.15
    assert told == "a hole in cell 1 has closed"


def test_neighbours_stay_where_that_is_wanted():
    settings = SETTINGS.model_copy(update={"topology": False})
    start = four(0.5, 0.2)
    last, told = fitted(four(0.75, 0.12), start, settings)
    assert contacts(last.mesh) == contacts(start)
    assert told == ""


def test_a_change_that_the_image_speaks_against_is_undone(monkeypatch):
    truth = four(0.6, 0.12)
    start = four(0.6, 0.2, radius=0.7)
    crushed = sphere((0, 0, 0), 0.3, 0.2)
    wrong = Mesh.merge([crushed.translated((0, 0, 2.0 * k)) for k in range(4)])
    tried = []

    def look(self, run):
        if run.iteration == 40 and not tried:
            tried.append(run.mesh)
            self._change(run, [])
        elif self._before is not None and run.iteration >= 60:
            self._judge(run)

    changed = Rearranged(wrong, ("cells fell apart",))
    monkeypatch.setattr(module, "give_way", lambda mesh, places, edge: changed)
    monkeypatch.setattr(module.TopologyKeeper, "look", look)
    settings = SETTINGS.model_copy(update={"levels": (1.0,), "max_iterations": 70})
    image, grid = photographed(truth, start)
    states = list(fit(image, grid, start, OPTICS, settings=settings))
    told = [e for s in states for e in s.events]
    assert told == ["cells fell apart", "undone, as the image speaks against it"]
    assert len(states[-1].mesh.vertices) == len(tried[0].vertices)


def test_a_change_at_the_end_of_a_fit_is_compared_with_the_loss_before_it(monkeypatch):
    start = four(0.6, 0.2, radius=0.7)
    image, grid = photographed(four(0.6, 0.12), start)
    crushed = Mesh.merge([sphere((0, 0, 2.0 * k), 0.3, 0.2) for k in range(4)])
    changed = Rearranged(crushed, ("cells fell apart",))

    def holds_up(self, run):
        return self._before is None and self._change(run, [])

    def look(self, run):
        if self._before is not None and run.iteration - self._before.iteration >= module._TRIAL:
            self._judge(run)

    monkeypatch.setattr(module, "give_way", lambda mesh, places, edge: changed)
    monkeypatch.setattr(module.TopologyKeeper, "holds_up", holds_up)
    monkeypatch.setattr(module.TopologyKeeper, "look", look)
    settings = SETTINGS.model_copy(
        update={"levels": (1.0,), "tolerance": 0.5, "max_iterations": 110}
    )
    told = [e for s in fit(image, grid, start, OPTICS, settings=settings) for e in s.events]
    assert told[:2] == ["cells fell apart", "undone, as the image speaks against it"]


@pytest.mark.parametrize("kind", ["pinned", "optics"])
def test_what_changes_from_outside_is_not_undone_with_the_topology(kind, monkeypatch):
    start = four(0.6, 0.2, radius=0.7)
    image, grid = photographed(four(0.6, 0.12), start)
    open_changes = []

    def look(self, run):
        if not run.iteration:
            self._change(run, [])
        open_changes.append(self._before)

    changed = Rearranged(start.translated((0, 0, 0)), ("nothing to speak of",))
    monkeypatch.setattr(module, "give_way", lambda mesh, places, edge: changed)
    monkeypatch.setattr(module.TopologyKeeper, "look", look)
    settings = SETTINGS.model_copy(update={"levels": (1.0,), "max_iterations": 3})
    states = fit(image, grid, start, OPTICS, settings=settings)
    next(states)
    pinned = np.arange(len(start.vertices)) < 9
    states.send(Change(pinned=pinned) if kind == "pinned" else Change(optics=GaussianPSF(0.14)))
    assert open_changes[0] is not None
    assert open_changes[1:] == [None]


def test_a_fit_of_the_psf_counts_its_steps_from_where_a_change_has_it_settle_again(monkeypatch):
    """As a fit does that is resumed from the checkpoint made there."""
    start = four(0.6, 0.2, radius=0.7)
    image, grid = photographed(four(0.6, 0.12), start)

    def look(self, run):
        if run.iteration == 0:
            run.losses = 4 * [1.0]
        elif run.iteration == 20:
            module._settle_again(run, 1)

    monkeypatch.setattr(module.TopologyKeeper, "look", look)
    monkeypatch.setattr(Run, "_settled", lambda self, last: False)
    settings = SETTINGS.model_copy(update={"levels": (1.0,), "max_iterations": 27, "fit_psf": True})
    widths = [s.optics.sigma_um for s in fit(image, grid, start, OPTICS, settings=settings)]
    moved = [k for k in range(1, len(widths)) if widths[k] != widths[k - 1]]
    # Every fifth moves it, as the state after it shows; four had passed at the beginning.
    assert moved == [1, 6, 11, 16, 25]


def test_pinned_places_do_not_change():
    truth = foam(np.array([[0, 0, -0.5], [0, 0, 0.5]]), np.array([0.65, 0.65]), 0.1)
    start = Mesh.merge([sphere((0, 0, -0.55), 0.5, 0.2), sphere((0, 0, 0.55), 0.5, 0.2)])
    image, grid = photographed(truth, start)
    states = fit(image, grid, start, OPTICS, settings=SETTINGS)
    next(states)
    pinned = np.abs(start.vertices_numpy()[:, 2]) < 0.15
    assert pinned.any()
    state = states.send(Change(pinned=pinned))
    for state in states:
        assert not state.events
    assert not contacts(state.mesh)
