"""Touching a mesh, and what moves with the touch."""

import numpy as np
import pytest

from napari_deltamic import InputError, Mesh
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.brush import (
    Touch,
    falloff,
    outward,
    touched_by_ray,
    touched_on_section,
)
from napari_deltamic.measure import section

CENTER = np.array([1.0, 2.0, 3.0])
BALL = sphere(CENTER, 1.5, edge_length=0.3)


@pytest.mark.parametrize("before", [-10.0, 0.0, 10.0])
def test_a_line_touches_the_side_that_is_seen(before):
    """Wherever on the line it is said to start."""
    direction = np.array([0.0, 0.0, 2.0])
    touch = touched_by_ray(BALL, CENTER + np.array([0.01, 0.02, before]), direction)
    assert touch.point == pytest.approx(CENTER + np.array([0.01, 0.02, -1.5]), abs=0.02)
    corners = BALL.vertices_numpy()[BALL.faces[touch.face]]
    assert np.linalg.norm(corners - touch.point, axis=1).max() < 0.4


def test_the_touched_point_lies_in_its_face():
    rng = np.random.default_rng(0)
    for _ in range(20):
        start, aim = rng.normal(size=(2, 3))
        touch = touched_by_ray(BALL, CENTER + 4 * start, aim)
        if touch is None:
            continue
        a, b, c = BALL.vertices_numpy()[BALL.faces[touch.face]]
        shares = np.linalg.solve(np.column_stack([a, b, c]), touch.point)
        assert (shares > -1e-9).all()
        assert shares.sum() == pytest.approx(1)


def test_a_line_that_misses_touches_nothing():
    assert touched_by_ray(BALL, CENTER + np.array([5, 0, 0]), np.array([0, 0, 1.0])) is None
    with pytest.raises(InputError, match="direction"):
        touched_by_ray(BALL, CENTER, np.zeros(3))


def test_a_contour_is_touched_within_reach():
    segments, faces = section(BALL, 0, 1.2)
    point = np.array([1.2, 2.0, 3.0 + 1.6])
    touch = touched_on_section(segments, faces, 0, point, 0.3)
    assert touch.point[0] == 1.2
    assert np.linalg.norm(touch.point - CENTER) == pytest.approx(1.5, abs=0.03)
    assert touched_on_section(segments, faces, 0, point, 0.05) is None
    nothing = section(BALL, 0, 9.0)
    assert touched_on_section(*nothing, 0, point, 9.0) is None


def test_weights_fall_off_smoothly():
    touch = touched_by_ray(BALL, CENTER, np.array([0, 1.0, 0]))
    weights = falloff(BALL, touch, 0.8)
    distance = np.linalg.norm(BALL.vertices_numpy() - touch.point, axis=1)
    assert (weights[distance >= 0.8] == 0).all()
    assert (weights[distance < 0.8] > 0).all()
    assert weights.max() > 0.8
    order = np.argsort(distance)
    assert (np.diff(weights[order]) <= 0).all()


def test_the_other_side_of_a_thin_cell_stays():
    flat = sphere((0, 0, 0), (0.1, 3.0, 3.0), edge_length=0.2)
    touch = touched_by_ray(flat, np.zeros(3), np.array([1.0, 0, 0]))  # from below
    weights = falloff(flat, touch, 0.8)
    z = flat.vertices_numpy()[:, 0]
    assert (weights[z < -0.05] > 0).any()
    assert (weights[z > 0.05] == 0).all()


def test_a_brush_smaller_than_a_face_still_moves_a_vertex():
    coarse = sphere((0, 0, 0), 1.0, subdivisions=0)
    corners = coarse.vertices_numpy()[coarse.faces[4]]
    weights = falloff(coarse, Touch(corners.mean(axis=0), 4), 1e-3)
    assert (weights[coarse.faces[4]] > 0.5).all()
    with pytest.raises(InputError, match="radius"):
        falloff(coarse, Touch(corners[0], 4), 0.0)


def test_outward_is_out_of_the_cell_whichever_way_its_faces_are_wound():
    away = (BALL.vertices_numpy() - CENTER) / 1.5
    for mesh in (BALL, Mesh(BALL.vertices, BALL.faces[:, ::-1], BALL.regions[:, ::-1])):
        normals = outward(mesh, 5)
        assert (np.einsum("vi,vi->v", normals, away) > 0.99).all()


def test_outward_knows_only_the_cell_that_is_touched():
    two = Mesh.merge([BALL, BALL.translated((0, 0, 5))])
    normals = outward(two, 0)
    assert (np.linalg.norm(normals[: len(BALL.vertices)], axis=1) > 0.99).all()
    assert (normals[len(BALL.vertices) :] == 0).all()


def test_outward_of_a_wall_is_one_way_along_it():
    """Two cubes with a wall between: each vertex of a face of the wall moves with it."""
    v = np.array([[z, y, x] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
    wall = Mesh(v, [[0, 1, 3], [0, 3, 2]], [[2, 1], [2, 1]])
    turned = Mesh(v, [[0, 3, 1], [0, 2, 3]], [[1, 2], [1, 2]])
    for mesh in (wall, turned):
        np.testing.assert_allclose(np.abs(outward(mesh, 0)[:4, 0]), 1)
    # Out of 2 in the first, out of 1 in the second.
    np.testing.assert_allclose(outward(wall, 0)[:4], -outward(turned, 0)[:4])
