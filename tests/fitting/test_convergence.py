"""How far a surface still is from where it belongs, at its worst place."""

import numpy as np
import pytest

from napari_deltamic import Mesh
from napari_deltamic.fitting.convergence import Patches, vertex_normals
from napari_deltamic.geometry import sphere

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
