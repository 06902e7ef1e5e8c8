"""How far a surface still is from where it belongs, at its worst place."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import napari_deltamic as nd
from napari_deltamic import Mesh
from napari_deltamic.fitting.objective.convergence import (
    Patches,
    drifted,
    strayed_off,
    vertex_normals,
)
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings

BALL = sphere((0, 0, 0), 1.0, subdivisions=3)
PLACES = BALL.vertices_numpy()
NORMALS = PLACES / np.linalg.norm(PLACES, axis=1, keepdims=True)
EDGE = 0.14


def worst(step, gradient=None, tolerance=0.0, mesh=BALL, width=2 * EDGE):
    gradient = -step if gradient is None else gradient
    normals = vertex_normals(mesh.vertices_numpy(), mesh.faces)
    return Patches(mesh, width).worst(normals, step, gradient, tolerance, 0.1)


def test_a_surface_that_moves_as_a_whole_moves_by_that():
    found = worst(0.02 * NORMALS)
    assert found.move == pytest.approx(0.02, rel=0.05)


def test_the_worst_place_is_found_and_is_that_of_a_patch():
    near = np.linalg.norm(PLACES - [1, 0, 0], axis=1) < 2.2 * EDGE
    found = worst(np.where(near[:, None], 0.1, 0.001) * NORMALS)
    assert near[found.vertex]
    assert 0.05 < found.move <= 0.1
    # A patch of two rings has 19 vertices.
    assert 8 < found.gain / (0.5 * 0.1**2) < 20


def test_noise_of_single_vertices_is_no_movement():
    rough = np.random.default_rng(0).normal(size=len(PLACES))[:, None] * NORMALS
    assert worst(rough).move < 0.8 * worst(NORMALS).move * np.abs(rough).max()


def test_a_surface_drifts_as_a_whole_and_not_in_a_few_places():
    rough = np.random.default_rng(0).normal(size=len(PLACES))[:, None] * NORMALS
    assert drifted(0.1 * rough, NORMALS, BALL) == pytest.approx(0.1, rel=0.1)
    assert drifted(0.1 * NORMALS, NORMALS, BALL) > 0.1
    few = np.linalg.norm(PLACES - [1, 0, 0], axis=1) < 2.2 * EDGE
    assert drifted(few[:, None] * NORMALS, NORMALS, BALL) == 0
    assert drifted(np.cross(NORMALS, [0, 0, 1.0]), NORMALS, BALL) < 1e-12


def test_one_cell_of_several_that_drifts_does_count():
    ends = [BALL.with_vertices(PLACES + np.array([3.0 * k, 0, 0])) for k in range(3)]
    three = Mesh.merge([Mesh(m.vertices, m.faces, m.regions * (k + 1)) for k, m in enumerate(ends)])
    along = np.concatenate([NORMALS] * 3)
    moves = np.repeat([0.0, 0.0, 0.1], len(PLACES))[:, None] * along
    assert drifted(moves, along, three) > 0.1


def test_vertices_that_slide_along_the_surface_do_not_count():
    slide = np.cross(NORMALS, [0, 0, 1.0])
    assert worst(slide, -NORMALS).move < 0.02


def test_only_what_moves_by_more_than_the_tolerance_is_asked_what_it_gains():
    ends = [np.linalg.norm(PLACES - end, axis=1) < 3 * EDGE for end in ([1, 0, 0], [-1, 0, 0])]
    step = (0.1 * ends[0] + 0.01 * ends[1])[:, None] * NORMALS
    gradient = -(1 * ends[0] + 1000 * ends[1])[:, None] * NORMALS
    assert ends[1][worst(step, gradient).vertex]
    assert ends[0][worst(step, gradient, 0.05).vertex]
    found = worst(step, gradient, 1.0)  # nothing does
    assert ends[0][found.vertex]
    assert found.move < 1


def test_a_step_against_the_gradient_gains_nothing():
    assert worst(NORMALS, NORMALS).gain == 0


def test_patches_of_another_surface_do_not_mix():
    two = Mesh.merge([BALL, BALL.translated((0, 0, 2.01))])
    step = np.concatenate([NORMALS, 0 * NORMALS])
    found = worst(step, mesh=two)
    assert found.vertex < len(PLACES)
    assert found.move == pytest.approx(1, rel=0.05)


@pytest.mark.parametrize(
    ("moved", "size", "off"),
    [((0, 0, 1.9), 1.0, False), ((0, 0, 2.1), 1.0, True), ((-2.5, 0, 0), 2.0, False)],
)
def test_a_cell_has_strayed_off_where_it_does_not_overlap_with_its_start(moved, size, off):
    start = sphere((0, 0, 0), 1.0, edge_length=0.5)
    other = sphere((0, 0, 5.0), 1.0, edge_length=0.5)
    cell = sphere(moved, size, edge_length=0.5)
    before = Mesh.merge([start, Mesh(other.vertices_numpy(), other.faces, other.regions * 7)])
    after = Mesh.merge([cell, Mesh(other.vertices_numpy(), other.faces, other.regions * 7)])
    assert strayed_off(before, after) == off


def test_a_coarse_level_is_undone_if_a_cell_drifts_away_from_its_start(monkeypatch):
    grid, optics = nd.Grid((24, 24, 24), (0.2,) * 3), nd.GaussianPSF(0.25)
    cell = sphere((2.3, 2.3, 2.3), 1.3, edge_length=0.35)
    clean = nd.render(cell, grid, optics, 1e-3).numpy().clip(0)
    image = np.random.default_rng(0).poisson(5 + 60 * clean / clean.max())
    start = sphere((2.3, 2.3, 2.3), 1.0, edge_length=0.35)
    asked = []

    def off(before, after):
        asked.append((before, after))
        return len(asked) == 1

    monkeypatch.setattr("napari_deltamic.fitting.level_run.strayed_off", off)
    settings = FitSettings(levels=(2.0, 1.5, 1.0), structure="membrane", fit_psf=False)
    states = list(nd.fit(image.astype(np.float32), grid, start, optics, settings=settings))
    assert len(asked) == 2  # not of the last level
    first, second = asked
    assert_array_equal(first[0].vertices_numpy(), start.vertices_numpy())
    # The second level began where the first had: neither moved nor remeshed.
    assert second[0] is first[0]
    assert any("undone" in state.message for state in states)
    assert states[-1].converged
    assert states[-1].mesh.volumes()[1] == pytest.approx(cell.volumes()[1], rel=0.03)
