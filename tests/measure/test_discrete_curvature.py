"""Curvature of cells and walls against closed forms, and what has none."""

import numpy as np
import pytest
from benchmarks.double_bubble import DoubleBubble
from benchmarks.shapes import box, torus

from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.measure.discrete_curvature import (
    cell_curvature,
    wall_curvature,
)
from napari_deltamic.measure.sides import Sides
from shapes import kelvin_cell

FAR = (300.0, -200.0, 100.0)


def of_cell(mesh):
    found = cell_curvature(Sides.of(mesh))
    assert len(found.mean) == 1
    return found.mean[0], found.gaussian[0], found.parts[0]


def test_sphere():
    mesh = sphere(FAR, 2.0, subdivisions=4)
    mean, gaussian, parts = of_cell(mesh)
    assert mean == pytest.approx(4 * np.pi * 2, rel=1e-3)
    assert gaussian == pytest.approx(4 * np.pi)
    assert parts == 1
    wall = wall_curvature(mesh)
    assert wall.mean[0] == pytest.approx(1 / 2, rel=1e-5)
    assert wall.gaussian[0] == pytest.approx(1 / 4, rel=3e-3)


def test_spheroid():
    """Of a prolate one it is 2 pi (c + a^2 / e * artanh(e / c)), with the focal distance e."""
    a, c = 1.0, 3.0
    focal = np.sqrt(c**2 - a**2)
    exact = 2 * np.pi * (c + a**2 / focal * np.arctanh(focal / c))
    mean, gaussian, _ = of_cell(sphere(FAR, (c, a, a), edge_length=0.12))
    assert mean == pytest.approx(exact, rel=2e-3)
    assert gaussian == pytest.approx(4 * np.pi)


def test_torus():
    major, minor = 5.0, 2.0
    mesh = torus(FAR, major, minor, edge_length=0.3)
    mean, gaussian, parts = of_cell(mesh)
    assert mean == pytest.approx(2 * np.pi**2 * major, rel=1e-3)
    assert gaussian == pytest.approx(0, abs=1e-8)
    assert parts == 1
    assert wall_curvature(mesh).mean[0] == pytest.approx(1 / (2 * minor), rel=1e-3)


def test_edges_of_polyhedra_count_exactly():
    mean, gaussian, parts = of_cell(box(FAR, (1, 2, 3), edge_length=0.5))
    assert mean == pytest.approx(np.pi * (1 + 2 + 3))
    assert (gaussian, parts) == (pytest.approx(4 * np.pi), 1)
    # A Kelvin cell: 24 edges beside a square, 12 between hexagons.
    square, hexagon = np.arccos(-1 / np.sqrt(3)), np.arccos(-1 / 3)
    exact = (24 * (np.pi - square) + 12 * (np.pi - hexagon)) / 2
    assert of_cell(kelvin_cell())[0] == pytest.approx(exact)


def test_a_dent_bends_the_other_way():
    """Two boxes with a notch between: edges that turn inwards count below zero."""
    steps = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    v = np.array([(z, y, x) for x in (0.0, 1.0) for z, y in steps])
    caps = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    n = len(steps)
    sides = [(i, (i + 1) % n, i + n) for i in range(n)]
    sides += [((i + 1) % n, (i + 1) % n + n, i + n) for i in range(n)]
    faces = [*sides, *[(a, c, b) for a, b, c in caps], *[(a + n, b + n, c + n) for a, b, c in caps]]
    mesh = Mesh(v, faces)
    if mesh.region_volume(1) < 0:
        mesh = Mesh(v, mesh.faces[:, ::-1])
    assert mesh.region_volume(1) == pytest.approx(3)
    # pi / 4 for each um of an edge: round two caps of 8 um, five edges out and one in.
    assert of_cell(mesh)[0] == pytest.approx(np.pi / 4 * (2 * 8 + 5 - 1))


@pytest.mark.parametrize("tilt", [0.0, 0.25, -0.25])
def test_walls_of_a_double_bubble(tilt):
    bubble = DoubleBubble(4.0, (1.0, 0.9, 0.8), tilt)
    found = wall_curvature(bubble.mesh(0.5))
    np.testing.assert_allclose(found.mean, bubble.curvatures, rtol=0.01, atol=1e-6)
    np.testing.assert_allclose(found.gaussian, bubble.curvatures**2, rtol=0.05, atol=1e-4)


def test_noise_of_the_vertices_hardly_moves_the_mean_curvature_of_a_wall():
    mesh = sphere(FAR, 5.0, edge_length=0.5)
    v = mesh.vertices_numpy()
    rng = np.random.default_rng(0)
    noisy = mesh.with_vertices(v + rng.normal(0, 0.03, v.shape))
    assert wall_curvature(noisy).mean[0] == pytest.approx(1 / 5, rel=0.03)


def test_what_is_open_has_no_integral_but_its_wall_has_a_curvature():
    whole = sphere(FAR, 2.0, subdivisions=3)
    mean, gaussian, parts = of_cell(Mesh(whole.vertices, whole.faces[5:]))
    assert np.isnan(mean)
    assert np.isnan(gaussian)
    assert parts == 1


def test_a_wall_of_two_triangles_has_no_inside():
    mesh = Mesh([[0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1]], [[0, 1, 2], [1, 3, 2]])
    found = wall_curvature(mesh)
    assert found.inside.tolist() == [0]
    assert np.isnan(found.mean[0])
    assert np.isnan(found.gaussian[0])
