"""The curvature along normals against differences, dense formulas and independent noise."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.double_bubble import DoubleBubble

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.fitting.model.state import FitState
from napari_deltamic.fitting.uncertainty import curvature as module
from napari_deltamic.fitting.uncertainty.curvature import Curvature
from napari_deltamic.fitting.uncertainty.directions import Directions
from napari_deltamic.fitting.uncertainty.errors_of_measures import posed_at
from napari_deltamic.fitting.uncertainty.normal_jacobian import Colouring, normal_jacobian
from napari_deltamic.fitting.uncertainty.replicating import replicas_of
from napari_deltamic.fitting.uncertainty.responses import Exact
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import expected_image
from napari_deltamic.scene.effects import Background, Halo
from napari_deltamic.scene.light import Light
from synthetic import CENTER, GRID, OPTICS, RADIUS, measured

MESH = sphere(CENTER, RADIUS, subdivisions=3)


def state(mesh=MESH, optics=OPTICS, pinned=None):
    density = np.ones(len(mesh.faces))
    known = (1, 1, 1, mesh, optics, density, 0.0, 1.0, 0.0, 1.0)
    return FitState(*known, pinned=pinned)


def posed(mesh=MESH, noise=0, **settings):
    return posed_at(measured(noise=noise), GRID, state(mesh), FitSettings(**settings))


@pytest.fixture(scope="module")
def there():
    return posed()


@pytest.fixture(scope="module")
def curvature(there):
    return Curvature(there.posterior, there.at, MESH)


def dented(depth=0.06):
    """The sphere with a smooth dent of less than half a width of the PSF, um."""
    v = MESH.vertices_numpy()
    out = (v - CENTER) / RADIUS
    return MESH.with_vertices(v - depth * np.exp(4 * (out[:, :1] - 1)) * out)


def test_vertices_of_a_colour_are_out_of_reach_of_each_other():
    found = Colouring.of(MESH.vertices_numpy(), MESH.edges(), np.full(3, 0.13))
    assert 1 < found.count < len(MESH.vertices) / 3
    for colour in range(found.count):
        places = found.places[found.colour == colour]
        apart = np.linalg.norm(places[:, None] - places[None], axis=2)
        assert apart[apart > 0].min(initial=np.inf) > 2 * found.reach


def test_what_was_rendered_elsewhere_is_not_taken_for_what_is_there():
    """Columns of PSF and effects, where gradients were asked for last, and where they were not."""
    asked, other = posed(), posed()
    further = replace(asked.at, vertices=asked.at.vertices + 0.1)
    asked.posterior(asked.at)
    rows = np.arange(len(asked.posterior.views[0].voxels.index))
    for at in (asked.at, further):
        found, told = (one.posterior.imaging_columns(at, rows)[0] for one in (asked, other))
        assert found.size
        np.testing.assert_allclose(found, told, rtol=0, atol=1e-5 * np.abs(told).max())


def test_jacobian_is_that_of_single_vertices(there):
    normals = -MESH.vertices_numpy() + CENTER
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    colouring = Colouring.of(there.at.vertices, MESH.edges(), np.full(3, 0.13))
    ways = Directions(np.arange(len(normals)), normals, len(normals))
    (found,) = normal_jacobian(there.posterior, there.at, ways, colouring)
    step = 0.005
    for vertex in (0, 17, 200, 641):
        ends = []
        for sign in (1, -1):
            v = there.at.vertices.copy()
            v[vertex] += sign * step * normals[vertex]
            ends.append(there.posterior.images(replace(there.at, vertices=v))[0])
        exact = (ends[0] - ends[1]) / (2 * step)
        column = found[:, [vertex]].toarray()[:, 0]
        # What is out of reach is left out, and what others send in from there is added.
        assert np.linalg.norm(column - exact) < 0.06 * np.linalg.norm(exact)


def test_matrix_is_symmetric_and_positive_and_solved(curvature):
    matrix = curvature.matrix()
    np.testing.assert_array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix).min() > 0
    right = np.random.default_rng(0).normal(size=len(matrix))
    np.testing.assert_allclose(matrix @ curvature.solve(right), right, atol=1e-6)


@pytest.mark.parametrize("fit_psf", [False, True])
def test_elimination_is_that_of_one_large_system(fit_psf):
    """Surface, amplitude, background and PSF in one matrix: what noise moves, and the step."""
    there = posed(fit_psf=fit_psf)
    found = Curvature(there.posterior, there.at, MESH)
    columns = np.hstack([found._jacobian.toarray(), found._own])
    n = len(MESH.vertices)
    known = np.zeros((columns.shape[1],) * 2)
    prior = there.posterior.prior
    normals = found.directions.way
    bend = prior.bending.curvature(there.at.vertices, normals)
    known[:n, :n] = prior.stiffness * bend.toarray()
    if fit_psf:
        size = len(there.at.optics)
        known[-size:, -size:] = prior.imaging.prior_curvature()
    whole = columns.T @ (found._weights[:, None] * columns) + known
    change = found.residual
    pushed = np.linalg.solve(whole, columns.T @ (found._weights * change))[:n]
    np.testing.assert_allclose(found.follows(change), pushed, atol=1e-4 * np.abs(pushed).max())
    pull = np.zeros(len(whole))
    now = there.posterior(there.at).gradient
    pull[:n] = (now.vertices * normals).sum(1)
    if fit_psf:
        pull[-size:] = now.optics
    step, exact = found.newton_step(now), np.linalg.solve(whole, -pull)
    along = (step.vertices * normals).sum(1)
    np.testing.assert_allclose(along, exact[:n], atol=1e-4 * np.abs(exact[:n]).max())
    if fit_psf:
        np.testing.assert_allclose(step.optics, exact[-size:], rtol=1e-3)


def test_one_newton_step_gains_what_it_predicts():
    mesh = dented()
    there = posed(mesh)
    found = Curvature(there.posterior, there.at, mesh)
    before = there.posterior(there.at)
    step = found.newton_step(before.gradient)
    after = there.posterior(there.at.with_flat(there.at.flat() + step.flat()))
    predicted = -0.5 * float(before.gradient.flat() @ step.flat())
    assert before.value - after.value == pytest.approx(predicted, rel=0.3)


@pytest.mark.slow
def test_brightness_of_insides_follows_the_surface():
    """How far noise moves all of it, against differences of gradients and of images."""
    light = Light(1.0, 6.0)
    image = expected_image(MESH, GRID, OPTICS, 1e-4, 300.0, 2.0, light=light)
    given = replace(state(), light=light)
    there = posed_at(image, GRID, given, FitSettings(accuracy=1e-4, fit_psf=False))
    found = Curvature(there.posterior, there.at, MESH)
    out = (there.at.vertices - CENTER) / RADIUS
    step = 0.003

    def gradient(by):
        moved = replace(there.at, vertices=there.at.vertices + by * out)
        return (there.posterior(moved).gradient.vertices * out).sum()

    exact = (gradient(step) - gradient(-step)) / (2 * step)
    along = found.directions.along(out)
    assert along @ found.matrix() @ along == pytest.approx(exact, rel=0.05)


def test_held_vertices_stay():
    mesh = dented()
    there = posed(mesh)
    held = there.at.vertices[:, 0] > CENTER[0]
    found = Curvature(there.posterior, there.at, mesh, held)
    moved = np.linalg.norm(found.newton_step(there.posterior(there.at).gradient).vertices, axis=1)
    assert moved[held].max() == 0
    assert moved[~held].max() > 0


@pytest.mark.slow
def test_replicas_scatter_as_fits_do():
    """Volumes after one Gauss-Newton step from the truth, noise of photons, equal weights."""
    volumes, told = [], []
    for seed in range(30):
        there = posed(noise=seed, likelihood="gaussian")
        if seed % 15 == 0:
            found, variance = Curvature(there.posterior, there.at, MESH), there.variance
            made = replicas_of(there, Exact(there, found), MESH)
            told.append(np.std([a.volumes()[1] - b.volumes()[1] for a, b in made.pairs()]) / 2)
        gradient = there.posterior(there.at).gradient.flat() * (there.variance / variance)
        step = found.newton_step(there.at.with_flat(gradient))
        volumes.append(MESH.with_vertices(MESH.vertices_numpy() + step.vertices).volumes()[1])
    # The scatter of 30 draws is known to 13 %.
    assert np.std(volumes, ddof=1) == pytest.approx(np.mean(told), rel=0.35)


def test_a_smooth_surface_has_the_image_of_the_mesh(there, curvature):
    """It is rounder than the mesh, and as large as the sphere that the mesh stands for."""
    made = replicas_of(there, Exact(there, curvature), MESH)
    off = np.linalg.norm(made.refitted - MESH.vertices_numpy(), axis=1)
    assert off.max() < 0.01 * RADIUS
    radius = np.linalg.norm(made.smooth.vertices_numpy() - CENTER, axis=1)
    own = np.linalg.norm(MESH.vertices_numpy()[MESH.faces].mean(1) - CENTER, axis=1).mean()
    assert own < radius.mean() < RADIUS
    # The prior rounds off: a sphere, which bends least, it leaves alone.
    assert np.linalg.norm(made.pulled - made.refitted, axis=1).max() < 0.01 * RADIUS


def test_junctions_move_in_two_directions_across_them():
    mesh = DoubleBubble(2.0, (1.0, 0.9, 0.8)).mesh(0.8)
    found = Directions.of(mesh, mesh.vertices_numpy())
    uses = np.bincount(mesh.face_edges().ravel(), minlength=len(mesh.edges()))
    line = np.unique(mesh.edges()[uses == 3])
    ways = np.bincount(found.vertex)
    assert (ways[line] == 2).all()
    assert (np.delete(ways, line) == 1).all()
    for vertex in line:
        before, after = (
            mesh.vertices_numpy()[edge[edge != vertex][0]]
            for edge in mesh.edges()[uses == 3]
            if vertex in edge
        )
        along = (after - before) / np.linalg.norm(after - before)
        assert np.abs(found.way[found.vertex == vertex] @ along).max() < 0.1
    ways = found.along(found.displaced(np.arange(float(len(found.vertex)))))
    np.testing.assert_allclose(ways, np.arange(len(ways)), atol=1e-9)


def test_what_is_not_affordable_is_refused(there, monkeypatch):
    monkeypatch.setattr(module, "_MOST_WORK", 10.0)
    with pytest.raises(InputError, match="renderings"):
        Curvature(there.posterior, there.at, MESH)
    monkeypatch.setattr(module, "_MOST_VERTICES", 10)
    with pytest.raises(InputError, match="vertices"):
        Curvature(there.posterior, there.at, MESH)


def test_sparse_factor_agrees_with_the_dense_one(there, curvature, monkeypatch):
    monkeypatch.setattr(module, "_DENSE", 0)
    sparse = Curvature(there.posterior, there.at, MESH)
    right = np.random.default_rng(2).normal(size=len(MESH.vertices))
    np.testing.assert_allclose(sparse.solve(right), curvature.solve(right), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("fit_psf", [False, True])
def test_an_effect_that_spreads_no_light_needs_no_padding(fit_psf):
    """Also where images are planned for a PSF that a fit may make narrower."""
    wide = nd.GaussianPSF((0.9, 0.5, 0.5))
    found = posed_at(measured(), GRID, state(optics=wide), FitSettings(fit_psf=fit_psf))
    assert found.posterior.pads_enough_for(found.at, Background())
    assert not found.posterior.pads_enough_for(found.at, Halo(fraction=0.3, width=3.0))
