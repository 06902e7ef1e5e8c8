"""Loop's subdivision: what stays, what converges, walls and junctions."""

import numpy as np
import pytest
from benchmarks.double_bubble import DoubleBubble

from napari_deltamic import Mesh
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.subdivision import subdivided


def test_weights_are_means_and_carry_displacements():
    mesh = DoubleBubble(2.0, (1.0, 0.9, 0.8)).mesh(0.6)
    fine = subdivided(mesh).again()
    assert len(fine.mesh.faces) == 16 * len(mesh.faces)
    np.testing.assert_allclose(fine.weights.sum(1), 1)
    move = np.array([1.0, 2.0, 3.0])
    shift = fine.moved(mesh.vertices_numpy() + move).vertices_numpy() - fine.mesh.vertices_numpy()
    np.testing.assert_allclose(shift, np.broadcast_to(move, shift.shape))


def test_cells_stay_closed_and_their_walls_the_same():
    mesh = DoubleBubble(2.0, (1.0, 0.9, 0.8)).mesh(0.6)
    fine = subdivided(mesh).mesh
    assert fine.is_closed(1)
    assert fine.is_closed(2)
    assert fine.interfaces()[0].tolist() == mesh.interfaces()[0].tolist()
    for region, volume in mesh.volumes().items():
        assert fine.volumes()[region] == pytest.approx(volume, rel=0.06)


def test_a_sphere_becomes_rounder():
    mesh = sphere((0, 0, 0), 1.0, subdivisions=2)

    def scatter(of):
        places = np.concatenate([of.vertices_numpy(), of.vertices_numpy()[of.faces].mean(1)])
        return np.linalg.norm(places, axis=1).std()

    assert scatter(subdivided(mesh).again().mesh) < 0.4 * scatter(mesh)


def test_a_border_is_a_spline_of_its_own():
    """A flat square stays flat, and its straight sides straight."""
    places = [[0.0, y, x] for y in range(4) for x in range(4)]
    faces = []
    for y in range(3):
        for x in range(3):
            a = 4 * y + x
            faces += [[a, a + 1, a + 5], [a, a + 5, a + 4]]
    fine = subdivided(Mesh(places, faces)).mesh
    v = fine.vertices_numpy()
    assert np.abs(v[:, 0]).max() == 0
    assert (v[:, 1:] >= 0).all()
    assert (v[:, 1:] <= 3).all()
    assert (np.isclose(v[:, 1], 0).sum(), np.isclose(v[:, 2], 3).sum()) >= (5, 5)
