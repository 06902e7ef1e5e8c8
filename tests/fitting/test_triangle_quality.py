"""Remeshing while a fit runs."""

import numpy as np
import pytest

from napari_deltamic import Change, InputError, Mesh, fit
from napari_deltamic.fitting.surface.growth_alarm import GrowthAlarm
from napari_deltamic.fitting.surface.triangle_quality import Remeshing, gaps
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.remeshing import can_remesh, smallest_angles
from napari_deltamic.runs.settings import FitSettings
from synthetic import CENTER, GRID, OPTICS, RADIUS, VOXEL, apart, measured

pytestmark = pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
SETTINGS = FitSettings(levels=(3.0, 1.0), structure="membrane")


@pytest.fixture(scope="module")
def image():
    return measured()


def squeezed(factor=12.0, subdivisions=3):
    """A start whose triangles become slivers: long along Z, where the cell is round."""
    ball = sphere(CENTER, 0.75 * RADIUS, subdivisions=subdivisions)
    away = ball.vertices_numpy() - CENTER
    turned = away + factor * 0.3 * away[:, [1]] * np.array([0.0, 0.0, 1.0])
    return ball.with_vertices(turned + CENTER)


def ends(states):
    *_, last = states
    return last


@pytest.fixture(scope="module")
def remeshed(image, tmp_path_factory):
    """The states of a fit whose slivers go, and a checkpoint of it."""
    states, kept = [], tmp_path_factory.mktemp("remeshed") / "kept.npz"
    for state in fit(image, GRID, squeezed(), OPTICS, settings=SETTINGS):
        if state.iteration == 45:
            state.save(kept)
        states.append(state)
    return states, kept


def test_slivers_go_and_the_fit_converges(remeshed):
    start = squeezed()
    last = remeshed[0][-1]
    assert (smallest_angles(start) < 15).mean() > 0.02
    assert (smallest_angles(last.mesh) < 15).mean() < 0.02
    assert last.converged
    assert apart(last.mesh) < 0.06
    assert 0.7 < last.mesh.median_edge() / start.median_edge() < 1.6


@pytest.mark.slow
def test_not_where_it_is_not_wanted(image):
    kept = ends(
        fit(image, GRID, squeezed(), OPTICS, settings=SETTINGS.model_copy(update={"remesh": False}))
    )
    assert len(kept.mesh.vertices) == len(squeezed().vertices)
    good = sphere(CENTER, 0.75 * RADIUS, subdivisions=3)
    assert np.array_equal(ends(fit(image, GRID, good, OPTICS)).mesh.faces, good.faces)


@pytest.mark.slow
@pytest.mark.parametrize("density", ["smooth", "interface"])
def test_the_density_goes_along(image, density):
    settings = SETTINGS.model_copy(update={"density": density})
    last = ends(fit(image, GRID, squeezed(), OPTICS, settings=settings))
    assert last.density.shape == (len(last.mesh.faces),)
    assert last.converged
    assert apart(last.mesh) < 0.08


@pytest.mark.slow
def test_pinned_vertices_stay_and_are_told(image):
    states = fit(image, GRID, squeezed(), OPTICS, settings=SETTINGS)
    first = next(states)
    pinned = first.mesh.vertices_numpy()[:, 0] > CENTER[0] + 0.5 * RADIUS
    there = {tuple(v) for v in first.mesh.vertices_numpy()[pinned]}
    states.send(Change(pinned=pinned))
    last = ends(states)
    assert not np.array_equal(last.mesh.faces, first.mesh.faces)  # remeshed, as many or not
    # Edges between two pinned vertices may have been split.
    assert there <= {tuple(v) for v in last.mesh.vertices_numpy()[last.pinned]}


def test_a_resumed_fit_ends_as_the_other(image, remeshed):
    states, kept = remeshed
    again = ends(fit(image, GRID, squeezed(), OPTICS, settings=SETTINGS, resume=kept))
    assert again.iteration == states[-1].iteration
    np.testing.assert_array_equal(again.mesh.faces, states[-1].mesh.faces)
    np.testing.assert_allclose(
        again.mesh.vertices_numpy(), states[-1].mesh.vertices_numpy(), atol=1e-4 * VOXEL
    )


def test_a_checkpoint_of_another_start_is_refused(image, tmp_path):
    next(fit(image, GRID, squeezed(), OPTICS, settings=SETTINGS)).save(tmp_path / "kept.npz")
    other = sphere(CENTER, RADIUS, subdivisions=2)
    with pytest.raises(InputError, match="another mesh"):
        fit(image, GRID, other, OPTICS, settings=SETTINGS, resume=tmp_path / "kept.npz")


def test_what_cannot_get_better_is_not_tried_for_ever():
    # A corner where four walls meet stays as it is: its slivers can only be left alone.
    mesh = squeezed(30.0, 1)
    remeshing = Remeshing(mesh, VOXEL)
    done = remeshing.renewed(
        mesh, np.zeros((len(mesh.vertices), 0)), np.ones(len(mesh.vertices), bool)
    )
    assert not remeshing.wanted(done.mesh, None)


def cigar():
    """Its mean curvature is 2 per um at the tips, and 0.27 around the middle."""
    return sphere((0, 0, 0), (8.0, 2.0, 2.0), edge_length=1.2)


def renewed(remeshing, mesh, flatness):
    n = len(mesh.vertices)
    return remeshing.renewed(mesh, np.zeros((n, 0)), np.zeros(n, bool), flatness=flatness).mesh


def test_edges_are_short_where_the_surface_is_curved_only():
    mesh, flatness = cigar(), 0.003
    remeshing = Remeshing(mesh, 0.3)
    assert not remeshing.wanted(mesh, flatness)  # the level has not moved it yet
    assert remeshing.wanted(mesh, flatness)
    after = renewed(remeshing, mesh, flatness)
    long = after.edge_lengths()
    height = np.abs(after.vertices_numpy()[after.edges()].mean(1)[:, 0])
    assert np.median(long[height > 7]) < 0.6 * np.median(long[height < 2])
    tips = gaps(after)[np.abs(after.vertices_numpy()[after.faces].mean(1)[:, 0]) > 7]
    assert np.median(tips) < 1.5 * flatness
    assert not remeshing.wanted(after, flatness)


def test_edges_are_made_shorter_twice_in_a_level_and_where_it_is_asked_for():
    mesh = cigar()
    remeshing, none = Remeshing(mesh, 0.3), Remeshing(mesh, 0.3)
    assert not any(none.wanted(mesh, None) for _ in range(3))
    remeshing.wanted(mesh, 0.01)
    for _ in range(2):
        assert remeshing.wanted(mesh, 0.01)
        renewed(remeshing, mesh, 0.01)
    assert not remeshing.wanted(mesh, 0.01)
    again = Remeshing(mesh, 0.3)
    again.resume(remeshing.to_dict())
    assert not again.wanted(mesh, 0.01)
    remeshing.begin_level(mesh, 0.0)
    assert not remeshing.wanted(mesh, 0.01)
    assert remeshing.wanted(mesh, 0.01)


def test_gaps_are_those_of_flat_faces_from_a_sphere():
    ball = sphere((0, 0, 0), 4.0, subdivisions=3)
    shares = np.random.default_rng(0).dirichlet(np.ones(3), 500)
    points = np.einsum("pk,fki->fpi", shares, ball.vertices_numpy()[ball.faces])
    inwards = 4.0 - np.linalg.norm(points, axis=2)
    # Less than they deviate: a fit bends the faces of neighbours towards each other.
    assert 0.6 < gaps(ball).mean() / inwards.std(1).mean() < 0.9


def test_growth_is_told_across_a_remeshing():
    ball = sphere((0, 0, 0), 1.0, subdivisions=3)

    def necked(mesh, length):
        out = mesh.vertices_numpy().copy()
        tip = out[:, 0] > 0.8
        out[tip] = out[tip] + [length, 0, 0]
        return mesh.with_vertices(out)

    alarm = GrowthAlarm(ball)
    half = necked(ball, 3.0)
    assert not alarm.check(half)
    alarm.remeshed(half, Mesh(half.vertices, half.faces))
    assert alarm.check(necked(half, 3.0))
