"""Sections of meshes with planes: closed, exact, also through vertices."""

from collections import Counter
from math import nan, pi

import numpy as np
import pytest
from benchmarks.shapes import box, torus
from numpy.testing import assert_allclose

from napari_deltamic.errors import InputError
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.measure import section


def lengths(segments):
    return np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)


def enclosed_area(segments, normals):
    """From the divergence theorem: segments with their outward normals in the plane."""
    middle = segments.mean(axis=1)
    return 0.5 * (lengths(segments) * (middle * normals).sum(axis=1)).sum()


def in_plane_normals(mesh, faces, axis):
    normals = np.delete(mesh.normals()[faces], axis, axis=1)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def ends_meet_in_pairs(segments):
    count = Counter(map(tuple, segments.reshape(-1, 2).tolist()))
    return all(n % 2 == 0 for n in count.values())


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_sphere_gives_a_circle(axis):
    center, radius = np.array([1.0, 2.0, 3.0]), 2.0
    mesh = sphere(center, radius, subdivisions=5)
    segments, faces = section(mesh, axis, center[axis] + 1.2)
    assert segments.shape == (len(faces), 2, 2)
    assert segments.dtype == np.float64
    assert faces.dtype == np.int64
    others = np.delete(center, axis)
    assert_allclose(np.linalg.norm(segments - others, axis=2), 1.6, rtol=2e-3)
    assert_allclose(lengths(segments).sum(), 2 * pi * 1.6, rtol=2e-3)
    assert ends_meet_in_pairs(segments)


def test_segments_lie_in_their_faces():
    mesh = torus((0, 0, 0), 3.0, 1.0)
    segments, faces = section(mesh, 1, 0.37)
    points = np.insert(segments, 1, 0.37, axis=2)
    corners = mesh.vertices[mesh.faces[faces]]
    distance = np.einsum("sei,si->se", points - corners[:, :1], mesh.normals()[faces])
    assert np.abs(distance).max() < 1e-12
    assert (points >= corners.min(axis=1)[:, None] - 1e-12).all()
    assert (points <= corners.max(axis=1)[:, None] + 1e-12).all()
    assert len(set(faces.tolist())) == len(faces)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("position", [0.0, 0.5, -0.5, 1.0, 0.25, 1 / 3])
def test_contours_are_closed_where_vertices_lie_in_the_plane(axis, position):
    mesh = box((0, 0, 0), 2, edge_length=0.5)
    segments, faces = section(mesh, axis, position)
    if position == 1.0:  # the top lies in the plane, nothing above it
        assert len(segments) == 0
        return
    assert ends_meet_in_pairs(segments)
    assert (lengths(segments) > 0).all()
    assert_allclose(lengths(segments).sum(), 8)
    assert_allclose(enclosed_area(segments, in_plane_normals(mesh, faces, axis)), 4)


def test_the_bottom_of_a_box_is_drawn_as_its_outline():
    segments, _ = section(box((0, 0, 0), 2), 0, -1.0)
    assert_allclose(lengths(segments).sum(), 8)
    assert ends_meet_in_pairs(segments)


def test_a_plane_through_the_tip_of_a_tetrahedron_gives_no_points():
    mesh = Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 0, 1]], [[0, 1, 2], [0, 2, 3], [0, 3, 1]])
    segments, faces = section(mesh, 0, 0.0)
    assert segments.shape == (0, 2, 2)
    assert faces.shape == (0,)


def test_planes_through_many_vertices_of_a_rough_surface():
    rng = np.random.default_rng(3)
    mesh = sphere((0, 0, 0), 4.0, subdivisions=3)
    # Heights on a coarse lattice: many vertices, edges and faces lie exactly in each plane.
    mesh = mesh.with_vertices(np.round(mesh.vertices + rng.normal(0, 0.2, mesh.vertices.shape)))
    for position in range(-5, 6):
        segments, _ = section(mesh, 0, float(position))
        assert ends_meet_in_pairs(segments)


def test_missing_the_mesh():
    segments, faces = section(sphere((0, 0, 0), 1.0), 2, 1.5)
    assert segments.shape == (0, 2, 2)
    assert faces.shape == (0,)


def test_two_cells_and_the_wall_between_them():
    left, right = box((0, 0, -0.5), 1), box((0, 0, 0.5), 1)
    wall = np.isclose(left.vertices[left.faces][:, :, 2], 0).all(axis=1)
    end = np.isclose(right.vertices[right.faces][:, :, 2], 0).all(axis=1)
    regions = [np.where(wall[:, None], [1, 2], [1, 0]), np.tile([2, 0], (int((~end).sum()), 1))]
    vertices = np.concatenate([left.vertices, right.vertices])
    faces = np.concatenate([left.faces, right.faces[~end] + len(left.vertices)])
    mesh = Mesh(vertices, faces, np.concatenate(regions))
    segments, index = section(mesh, 0, 0.2)
    pairs = mesh.regions[index]
    totals = {
        tuple(pair): lengths(segments[(pairs == pair).all(axis=1)]).sum()
        for pair in np.unique(pairs, axis=0).tolist()
    }
    assert totals == pytest.approx({(1, 0): 3, (1, 2): 1, (2, 0): 3})


def test_a_tensor_mesh():
    import torch

    mesh = sphere((0, 0, 0), 1.0)
    tensor = Mesh(torch.from_numpy(mesh.vertices).requires_grad_(), mesh.faces)
    assert np.array_equal(section(tensor, 0, 0.1)[0], section(mesh, 0, 0.1)[0])


@pytest.mark.parametrize(("axis", "position"), [(3, 0.0), (-1, 0.0), (0, nan)])
def test_bad_planes(axis, position):
    with pytest.raises(InputError):
        section(sphere((0, 0, 0), 1.0), axis, position)
