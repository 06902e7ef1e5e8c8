"""How curved surfaces are."""

import numpy as np
import pytest
from benchmarks.double_bubble import DoubleBubble
from benchmarks.shapes import torus

from napari_deltamic import Mesh
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.vertex_curvature import vertex_curvature


@pytest.mark.parametrize("radius", [0.5, 20.0])
def test_a_sphere_has_that_of_its_radius_everywhere(radius):
    found = vertex_curvature(sphere((1, 2, 3), radius, subdivisions=3))
    np.testing.assert_allclose(found, 1 / radius, rtol=0.05)


def test_a_torus_is_most_curved_outside():
    # Mean curvature on the outer equator, (1 / r + 1 / (R + r)) / 2; on the inner one
    # (1 / r - 1 / (R - r)) / 2.
    mesh = torus((0, 0, 0), 3.0, 1.0)
    found = vertex_curvature(mesh)
    v = mesh.vertices_numpy()
    away = np.sort(np.linalg.norm(v, axis=1))
    outer = np.linalg.norm(v, axis=1) >= away[-20]
    inner = np.linalg.norm(v, axis=1) <= away[20]
    assert found[outer].mean() == pytest.approx((1 + 1 / 4) / 2, rel=0.06)
    assert found[inner].mean() == pytest.approx((1 - 1 / 2) / 2, rel=0.12)


def test_neither_turned_faces_nor_a_plane_are_curved():
    mesh = sphere((0, 0, 0), 2.0, subdivisions=3)
    turned = Mesh(mesh.vertices, mesh.faces[:, ::-1])
    np.testing.assert_allclose(vertex_curvature(turned), vertex_curvature(mesh), rtol=1e-6)
    flat = mesh.vertices_numpy() * [0.0, 1.0, 1.0]
    inside = np.linalg.norm(flat, axis=1) < 1.5
    assert vertex_curvature(mesh.with_vertices(flat))[inside].max() < 1e-6


def test_walls_and_free_surfaces_are_as_curved_as_they_are_and_rims_do_not_count():
    bubble = DoubleBubble(4.0, (1.0, 1.0, 1.0))  # of equal spheres: the wall between is flat
    mesh = bubble.mesh(0.4)
    found, between = vertex_curvature(mesh), (mesh.regions > 0).all(1)
    wall, free = mesh.faces[between], mesh.faces[~between]
    only_wall, only_free = np.setdiff1d(wall, free), np.setdiff1d(free, wall)
    assert len(only_wall) > 10
    assert np.median(found[only_wall]) < 0.2 * bubble.curvatures[0]
    assert np.median(found[only_free]) == pytest.approx(bubble.curvatures[0], rel=0.05)


def test_noise_that_moves_neighbours_apart_counts_for_little():
    mesh = sphere((0, 0, 0), 5.0, subdivisions=4)
    v = mesh.vertices_numpy()
    height = 0.02 * mesh.median_edge() * np.random.default_rng(0).normal(size=len(v))
    noisy = vertex_curvature(mesh.with_vertices(v * (1 + height / 5.0)[:, None]))
    assert np.median(noisy) == pytest.approx(0.2, rel=0.1)
