"""Cells from spheres."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from napari_deltamic import InputError
from napari_deltamic.geometry import foam as module
from napari_deltamic.geometry import seeds_from_points
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.remeshing import can_remesh

needs_remesher = pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")


def test_spheres_apart_stay_spheres():
    centers, radii = np.array([(0.0, 0, 0), (5, 0, 0)]), np.array([1.0, 2.0])
    mesh = foam(centers, radii, 0.3)
    assert {tuple(p) for p in mesh.interfaces()[0]} == {(1, 0), (2, 0)}
    for k in (1, 2):
        own = mesh.vertices_numpy()[np.unique(mesh.faces[(mesh.regions == k).any(1)])]
        assert_allclose(np.linalg.norm(own - centers[k - 1], axis=1), radii[k - 1], atol=1e-9)


@needs_remesher
def test_two_that_overlap_meet_in_the_plane_of_equal_power():
    centers, radii = np.array([(0.0, 0, 0), (0, 0, 2)]), np.array([1.5, 1.2])
    mesh = foam(centers, radii, 0.25)
    assert mesh.is_closed()
    assert set(np.unique(mesh.edge_uses())) == {2, 3}
    wall = (mesh.regions > 0).all(1)
    plane = (1.5**2 - 1.2**2 + 4) / 4
    places = mesh.vertices_numpy()[np.unique(mesh.faces[wall])]
    assert abs(places[:, 2].mean() - plane) < 0.03
    assert np.abs(places[:, 2] - plane).max() < 0.12

    # Cap volumes of the two spheres, cut by the plane.
    def cut(radius, height):
        return np.pi * (2 * radius**3 / 3 + radius**2 * height - height**3 / 3)

    assert_allclose(mesh.region_volume(1), cut(1.5, plane), rtol=0.04)
    assert_allclose(mesh.region_volume(2), cut(1.2, 2 - plane), rtol=0.04)


@needs_remesher
def test_many_cells_far_from_the_origin():
    rng = np.random.default_rng(0)
    centers = np.array([1000.0, -500, 20]) + rng.uniform(-3, 3, size=(10, 3))
    mesh = foam(centers, np.full(10, 2.0), 0.5)
    assert mesh.region_ids().tolist() == list(range(1, 11))
    assert mesh.is_closed()


def test_a_sphere_inside_another_is_told():
    if not can_remesh():
        pytest.skip("the compiled extension is missing")
    with pytest.raises(InputError, match="sphere 2 lies wholly inside"):
        foam(np.array([(0.0, 0, 0), (0, 0, 0.2)]), np.array([2.0, 0.5]), 0.4)


def test_without_the_extension_spheres_stay_whole(monkeypatch):
    monkeypatch.setattr(module, "can_remesh", lambda: False)
    mesh = foam(np.array([(0.0, 0, 0), (0, 0, 2)]), np.array([1.5, 1.2]), 0.4)
    assert (mesh.regions == 0).any(1).all()


@needs_remesher
def test_seeds_keep_the_numbers_of_their_points():
    z, y, x = np.indices((20, 30, 60)) * 0.2
    shell = np.exp(-0.5 * ((np.sqrt((z - 2) ** 2 + (y - 3) ** 2 + (x - 2) ** 2) - 1.4) / 0.2) ** 2)
    image = 100 * shell + np.random.default_rng(0).normal(10, 1, shell.shape)
    points = [(2, 3, 8), (2, 3, 2), (2, 3, 10)]
    mesh = seeds_from_points(image, (0.2,) * 3, points, [1.3, np.nan, 1.3])
    assert mesh.region_ids().tolist() == [1, 2, 3]
    assert {tuple(p) for p in mesh.interfaces()[0]} == {(1, 0), (2, 0), (3, 0), (3, 1)}
    middle = mesh.vertices_numpy()[mesh.faces[(mesh.regions == 2).any(1)]].mean((0, 1))
    assert_allclose(middle, points[1], atol=0.2)
