"""Surfaces do not come to cross."""

import sys

import numpy as np
import pytest

from napari_deltamic import Change, Mesh, fit, geometry
from napari_deltamic.fitting.surface import collisions as module
from napari_deltamic.fitting.surface.collisions import CollisionGuard
from napari_deltamic.fitting.surface.triangle_quality import Remeshing
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.remeshing import Remeshed, can_remesh
from napari_deltamic.geometry.topology.crossings import crosses
from napari_deltamic.runs.settings import FitSettings
from synthetic import CENTER, GRID, OPTICS, RADIUS, VOXEL, apart, measured

pytestmark = pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
AT_ONCE = FitSettings(levels=(1.0,), max_iterations=10, collisions=True)


def balls(*centers, radius=1.0, subdivisions=3):
    return Mesh.merge([sphere(c, radius, subdivisions=subdivisions) for c in centers])


def guarded(mesh):
    guard = CollisionGuard()
    guard.watch(mesh)
    return guard


def moved(mesh, way, steps=1, guard=None):
    """The mesh after steps that the guard lets it take, all of them the same."""
    guard = guard or guarded(mesh)
    place = mesh.vertices_numpy()
    for _ in range(steps):
        place = guard.limited(place, place + way)
    return mesh.with_vertices(place)


@pytest.mark.parametrize(("step", "steps"), [(0.002, 80), (0.03, 10), (0.3, 1), (1.5, 1)])
def test_spheres_pushed_through_each_other_stop_at_contact(step, steps):
    pair = balls((0, 0, 0), (0, 0, 2.2))
    one = np.arange(len(pair.vertices)) < len(pair.vertices) // 2
    way = np.where(one, step, -step)[:, None] * np.array([0.0, 0.0, 1.0])
    freely = pair.with_vertices(pair.vertices_numpy() + steps * way)
    done = moved(pair, way, steps)
    assert not crosses(done)
    # The way of those in front ends in the middle; none has come to the other's side.
    z = done.vertices_numpy()[:, 2]
    assert (z[one & (np.abs(pair.vertices_numpy()[:, 2] - 1) < 0.05)] < 1.3).all()
    if step < 1:
        assert crosses(freely)
        gap = z[~one].min() - z[one].max()
        assert abs(gap) < 0.1
        # Far from the contact they have gone all the way.
        behind = one & (pair.vertices_numpy()[:, 2] < 0)
        assert np.allclose(done.vertices_numpy()[behind], freely.vertices_numpy()[behind])


def test_a_vertex_stops_at_the_opposite_wall_of_its_own_cell():
    ball = sphere((0, 0, 0), 1.0, subdivisions=3)
    top = int(ball.vertices_numpy()[:, 0].argmax())
    way = np.zeros((len(ball.vertices), 3))
    way[top] = [-2.6, 0, 0]
    way[ball.vertices_numpy()[:, 1] > 0.9] = [0, 0.1, 0]
    done = moved(ball, way)
    assert crosses(ball.with_vertices(ball.vertices_numpy() + way))
    assert not crosses(done)
    gone = done.vertices_numpy() - ball.vertices_numpy()
    assert -2 < gone[top, 0] < -1.5
    others = np.arange(len(gone)) != top
    np.testing.assert_allclose(gone[others], way[others])


def test_contact_does_not_stick():
    pair = balls((0, 0, 0), (0, 0, 2.2))
    one = np.arange(len(pair.vertices)) < len(pair.vertices) // 2
    way = np.where(one, 0.1, -0.1)[:, None] * np.array([0.0, 0.0, 1.0])
    guard = guarded(pair)
    there = moved(pair, way, 3, guard)
    back = guard.limited(there.vertices_numpy(), there.vertices_numpy() - way)
    assert np.array_equal(back, there.vertices_numpy() - way)


def test_what_does_not_collide_is_taken_to_the_bit():
    random = np.random.default_rng(0)
    mesh = balls((0, 0, 0), (0, 0, 9.0), (0, 9.0, 0))
    guard, place = guarded(mesh), mesh.vertices_numpy()
    for size in (1e-4, 1e-2, 0.5):
        steps = size * (random.normal(size=3) + 0.1 * place)
        end = place + steps
        assert guard.limited(place, end) is end
        place = end


def test_pairs_that_were_found_before_serve_only_where_they_hold():
    pair = balls((0, 0, 0), (0, 0, 2.3))
    one = np.arange(len(pair.vertices)) < len(pair.vertices) // 2
    guard, place = guarded(pair), pair.vertices_numpy()
    slow = np.where(one, 1e-4, 0.0)[:, None] * np.array([0.0, 1.0, 0.0])
    place = guard.limited(place, place + slow)
    fast = np.where(one, 0.4, 0.0)[:, None] * np.array([0.0, 0.0, 1.0])
    assert not crosses(pair.with_vertices(guard.limited(place, place + fast)))


def test_what_crosses_at_the_start_is_told_once_and_left_alone():
    trio = balls((0, 0, 0), (0.01, 0.02, 1.5), (0, 2.2, 0))
    guard = guarded(trio)
    assert "regions 1 and 2 cross:" in guard.remark()
    guard.watch(trio)
    assert guard.remark() == ""
    # The two that cross may come apart, while the third is still held off.
    third = len(trio.vertices) // 3
    way = np.zeros((len(trio.vertices), 3))
    way[third : 2 * third, 2] = 0.1
    way[2 * third :, 1] = -0.05
    done = moved(trio, way, 11, guard)
    np.testing.assert_allclose(
        done.vertices_numpy()[third : 2 * third], (trio.vertices_numpy() + 11 * way)[third:-third]
    )
    assert not crosses(done)
    # Once apart they are guarded as well.
    assert not crosses(moved(done, -2 * way, 10, guard))


def test_a_surface_that_crosses_itself_is_told():
    ball = sphere((0, 0, 0), 1.0, subdivisions=3)
    place = ball.vertices_numpy().copy()
    place[place[:, 0].argmax()] = [-2, 0.05, 0.03]  # or edges would meet exactly
    assert "the surface of region 1 crosses itself:" in guarded(ball.with_vertices(place)).remark()


def test_far_too_long_a_step_is_cut_not_turned():
    ball = sphere((0, 0, 0), 1.0, subdivisions=2)
    way = np.broadcast_to([0.0, 30.0, 0.0], ball.vertices_numpy().shape)
    gone = moved(ball, way).vertices_numpy() - ball.vertices_numpy()
    np.testing.assert_allclose(gone[:, [0, 2]], 0, atol=1e-12)
    assert 1 < gone[:, 1].min() <= gone[:, 1].max() < 6
    np.testing.assert_allclose(gone[:, 1], gone[0, 1])


def test_steps_that_are_not_finite_are_not_asked_about():
    ball = sphere((0, 0, 0), 1.0, subdivisions=1)
    end = np.full((len(ball.vertices), 3), np.nan)
    assert guarded(ball).limited(ball.vertices_numpy(), end) is end


def degenerate(name, subdivisions):
    """A mesh of badly placed vertices, and a step as wild."""
    random = np.random.default_rng(0)
    ball = sphere((0, 0, 0), 1.0, subdivisions=subdivisions)
    place = ball.vertices_numpy()
    noise = random.normal(size=place.shape)
    place, size = {
        "crumpled": (place + 0.3 * noise, 0.05),
        "flat": (place * [1e-5, 1, 1], 0.05),
        "needle": (place * [1e-5, 1e-5, 1], 0.05),
        "nearly a point": (place * 1e-9, 1e-9),
        "a point": (place * 0, 0.05),
        "a vertex far away": (np.where(np.arange(len(place))[:, None] == 5, 1e6, place), 0.05),
        "far too long steps": (place, 50),
    }[name]
    step = size * random.normal(size=place.shape)
    return ball.with_vertices(place), step, len(place) + len(ball.edges()) + len(ball.faces)


@pytest.mark.parametrize("subdivisions", [2, 3])
@pytest.mark.parametrize(
    "name",
    [
        "crumpled",
        "flat",
        "needle",
        "nearly a point",
        "a point",
        "a vertex far away",
        "far too long steps",
    ],
)
def test_the_work_of_a_step_is_at_most_proportional_to_the_mesh(name, subdivisions):
    mesh, step, parts = degenerate(name, subdivisions)
    guard, place = guarded(mesh), mesh.vertices_numpy()
    crossed = crosses(mesh)
    reached = guard.limited(place, place + step)
    assert guard.work <= 8000 * parts
    assert np.isfinite(reached).all()
    assert crossed or not crosses(mesh.with_vertices(reached))


def test_a_crowd_of_vertices_does_not_hold_back_the_others():
    crowd = sphere((0, 0, 0), 1e-7, subdivisions=3)
    mesh = Mesh.merge([crowd, sphere((0, 0, 3), 1.0, subdivisions=4)])
    others = np.arange(len(mesh.vertices)) >= len(crowd.vertices)
    step = 1e-3 * np.random.default_rng(0).normal(size=(len(mesh.vertices), 3))
    place = mesh.vertices_numpy()
    reached = moved(mesh, step).vertices_numpy()
    assert (np.abs(reached - place - step).max(1) < 1e-12)[others].mean() > 0.9


def test_without_the_extension_there_is_no_guard(monkeypatch):
    monkeypatch.setattr(module, "native", lambda: None)
    pair = balls((0, 0, 0), (0, 0, 1.5))
    guard = guarded(pair)
    end = pair.vertices_numpy() + 1
    assert guard.limited(pair.vertices_numpy(), end) is end
    assert guard.remark() == ""
    assert guard.allows(pair)
    start = sphere(CENTER, RADIUS, subdivisions=2)
    assert len(list(fit(measured(), GRID, start, OPTICS, settings=AT_ONCE))) > 0


# ----------------------------------------------------------------------------------- in fits


def touching():
    """Two cells that touch, their image, and spheres that start apart from each other."""
    z, y, x = CENTER
    left, right = (z, y - 0.56, x), (z, y + 0.56, x)
    cells = balls(left, right, radius=0.555, subdivisions=4)
    starts = balls((z, y - 0.62, x), (z, y + 0.6, x), radius=0.45, subdivisions=2)
    return cells, measured(mesh=cells), starts


@pytest.fixture(scope="module")
def two():
    return touching()


def fitted(two, collisions, **more):
    cells, image, starts = two
    settings = FitSettings(levels=(3.0, 1.0), collisions=collisions, **more)
    states = list(fit(image, GRID, starts, OPTICS, settings=settings))
    return states, apart(states[-1].mesh, cells)


@pytest.mark.slow
def test_cells_that_touch_do_not_cross(two):
    states, error = fitted(two, True)
    assert not any(crosses(s.mesh) for s in states)
    unguarded, other = fitted(two, False)
    assert any(crosses(s.mesh) for s in unguarded)  # or this shows nothing
    assert error < max(0.1, 1.1 * other)
    assert states[-1].converged


def test_without_the_extension_two_cells_are_fitted_as_they_are(two, monkeypatch):
    monkeypatch.setitem(sys.modules, "napari_deltamic.geometry._remesh", None)
    monkeypatch.delattr(geometry, "_remesh", raising=False)
    states, _ = fitted(two, True, max_iterations=10)
    assert len(states[-1].mesh.region_ids()) == 2
    assert states[-1].loss < states[0].loss / 3


def test_a_start_that_crosses_is_fitted_and_told():
    z, y, x = CENTER
    starts = balls((z, y - 0.3, x), (z, y + 0.3, x), radius=0.5, subdivisions=2)
    settings = AT_ONCE.model_copy(update={"topology": False})
    states = list(fit(measured(), GRID, starts, OPTICS, settings=settings))
    assert len(states) == 10
    assert "regions 1 and 2 cross" in states[0].message
    assert not any("cross:" in s.message for s in states[1:])


def test_a_start_that_crosses_is_repaired_and_told():
    z, y, x = CENTER
    starts = balls((z, y - 0.3, x), (z, y + 0.3, x), radius=0.5, subdivisions=2)
    states = list(fit(measured(), GRID, starts, OPTICS, settings=AT_ONCE))
    assert "cells 1 and 2 overlapped and now share a wall" in states[0].message
    assert not any(crosses(s.mesh) for s in states)


def test_a_change_may_cross_and_is_told(two):
    _, image, starts = two
    states = fit(image, GRID, starts, OPTICS, settings=AT_ONCE)
    first = next(states)
    place = first.mesh.vertices_numpy().copy()
    place[place[:, 1] > CENTER[1]] -= [0, 5 * VOXEL, 0]
    after = states.send(Change(mesh=first.mesh.with_vertices(place)))
    assert "regions 1 and 2 cross" in after.message
    assert not next(states).message


def test_the_guard_can_be_switched_off(two, monkeypatch):
    monkeypatch.setattr(module, "ceil", None)
    _, image, starts = two
    off = AT_ONCE.model_copy(update={"collisions": False})
    assert len(list(fit(image, GRID, starts, OPTICS, settings=off))) == 10
    with pytest.raises(TypeError):
        list(fit(image, GRID, starts, OPTICS, settings=AT_ONCE))


def test_a_remeshing_that_makes_surfaces_cross_is_not_taken(two, monkeypatch):
    _, image, starts = two
    crossing = balls((1.15, 1.3, 1.55), (1.15, 1.8, 1.55), radius=0.5, subdivisions=3)
    tried = []

    def renewed(self, mesh, carried, fixed, apart, flatness):
        tried.append(mesh)
        n = len(crossing.vertices)
        none = np.zeros((n, carried.shape[1])), np.zeros(n, bool), np.full(n, -1)
        return Remeshed(crossing, *none)

    monkeypatch.setattr(Remeshing, "wanted", lambda self, mesh, flatness: not tried)
    monkeypatch.setattr(Remeshing, "renewed", renewed)
    *_, last = fit(image, GRID, starts, OPTICS, settings=AT_ONCE)
    assert len(tried) == 1
    assert np.array_equal(last.mesh.faces, starts.faces)
