"""Thin places are found and give way; surfaces that overlap become cells with a wall."""

import tracemalloc

import numpy as np
import pytest
from benchmarks.shapes import torus
from numpy.testing import assert_allclose

from napari_deltamic import InputError, Mesh
from napari_deltamic.geometry import remesh, sphere
from napari_deltamic.geometry.contacts import contacts
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.remeshing import can_remesh, smallest_angles
from napari_deltamic.geometry.topology import thin_places as thin_places_module
from napari_deltamic.geometry.topology.crossings import crosses
from napari_deltamic.geometry.topology.rearranging import give_way
from napari_deltamic.geometry.topology.thin_places import small_walls, thin_places
from napari_deltamic.geometry.topology.untangling import untangled
from napari_deltamic.measure.surface_distance import distance_to_surface

pytestmark = pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
EDGE = 0.25


def flattened(gap):
    """Two balls with flat faces towards each other."""
    one, other = sphere((0, 0, 0), 1.0, EDGE), sphere((0, 0, 1.8 + gap), 1.0, EDGE)
    left, right = one.vertices_numpy().copy(), other.vertices_numpy().copy()
    left[:, 2] = np.minimum(left[:, 2], 0.9)
    right[:, 2] = np.maximum(right[:, 2], 0.9 + gap)
    return Mesh.merge([one.with_vertices(left), other.with_vertices(right)])


def sound(mesh):
    assert mesh.is_closed()
    assert not crosses(mesh)
    assert min(mesh.volumes().values()) > 0
    assert np.percentile(smallest_angles(mesh), 1) > 20
    return True


def test_a_thin_gap_is_found_and_becomes_a_wall():
    mesh = flattened(0.05)
    (place,) = thin_places(mesh, 0.3 * EDGE)
    assert (place.regions, place.sides) == ((0,), (1, 2))
    assert_allclose(place.width, 0.05, rtol=0.1)
    assert_allclose(place.points[:, 2], 0.925, atol=1e-3)
    done = give_way(mesh, [place], EDGE)
    assert sound(done.mesh)
    assert contacts(done.mesh) == {(1, 2)}
    assert done.events == ("cell 1 touches cell 2",)


def test_other_gaps_that_are_as_narrow_do_not_stand_in_the_way():
    # Voxels cannot keep them open: one of a pair had to stay because the other would close too.
    pair = flattened(0.005)
    mesh = Mesh.merge([pair, pair.translated((0, 3, 0))])
    place = thin_places(mesh, 0.3 * EDGE)[0]
    done = give_way(mesh, [place], EDGE)
    assert not done.hopeless
    assert sound(done.mesh)
    assert place.sides in contacts(done.mesh)


def test_what_lies_far_from_a_change_stays_on_the_old_surface():
    mesh = flattened(0.05)
    done = give_way(mesh, thin_places(mesh, 0.3 * EDGE), EDGE).mesh
    far = np.abs(done.vertices_numpy()[:, 2] - 0.925) > 1.0
    apart = distance_to_surface(done.vertices_numpy()[far], mesh)
    assert far.sum() > 50
    assert apart.mean() < 0.02 * EDGE
    for region, volume in mesh.volumes().items():
        assert_allclose(done.region_volume(region), volume, rtol=0.05)


@pytest.mark.parametrize("gap", [0.12, 0.5])
def test_a_wide_gap_is_no_thin_place(gap):
    assert not thin_places(flattened(gap), 0.3 * EDGE)


def test_corners_between_walls_are_no_thin_places():
    random = np.random.default_rng(1)
    centers = np.stack(np.meshgrid(*3 * [[0, 1.5]]), -1).reshape(-1, 3).astype(float)
    mesh = foam(centers + 0.1 * random.normal(size=(8, 3)), np.ones(8), EDGE)
    assert not thin_places(mesh, 0.25 * EDGE)


def test_a_hole_closes():
    ring = remesh(torus((0, 0, 0), 1.0, 0.96, 0.1), 0.2).mesh
    places = thin_places(ring, 0.3 * 0.2)
    assert {(p.regions, p.sides) for p in places} == {((0,), (1,))}
    done = give_way(ring, places, 0.2)
    assert done.mesh.is_closed()
    assert not crosses(done.mesh)
    assert smallest_angles(done.mesh).min() > smallest_angles(ring).min()  # slivers around the hole
    assert done.events == ("a hole in cell 1 has closed",)
    n, e, f = len(done.mesh.vertices), len(done.mesh.edges()), len(done.mesh.faces)
    assert n - e + f == 2


def test_a_small_wall_goes_and_others_meet():
    centers = np.array([[0, 0, -0.95], [0, 0, 0.95], [0, -1.0, 0], [0, 1.0, 0]])
    mesh = foam(centers, np.full(4, 1.2), 0.2)
    assert (1, 2) in contacts(mesh)
    (wall,) = small_walls(mesh, 60 * 0.2**2)
    assert set(wall.regions) == {1, 2}
    assert {3, 4} <= set(wall.sides)
    assert not small_walls(mesh, 0.1 * 0.2**2)


def test_a_cell_does_not_vanish():
    mesh = Mesh.merge([sphere((0, 0, 0), 0.2, 0.1), sphere((0, 3, 0), 1.0, 0.3)])
    place = thin_places(mesh, 0.45)
    assert any(p.regions == (1,) for p in place)
    done = give_way(mesh, [p for p in place if p.regions == (1,)], 0.3)
    assert done is None or 1 in done.mesh.region_ids()


def test_overlapping_balls_come_to_share_a_wall():
    pair = Mesh.merge([sphere((0, 0, 0), 1.0, EDGE), sphere((0, 0, 1.6), 1.0, EDGE)])
    done = untangled(pair)
    assert sound(done.mesh)
    assert contacts(done.mesh) == {(1, 2)}
    assert "cells 1 and 2 overlapped and now share a wall" in done.events
    # The deepest wins: the wall lies midway.
    wall = (done.mesh.regions > 0).all(1)
    middle = done.mesh.vertices_numpy()[done.mesh.faces[wall]].mean(1)
    assert_allclose(middle[:, 2].mean(), 0.8, atol=0.1 * EDGE)


def test_what_does_not_cross_is_left_as_it_is():
    mesh = flattened(0.3)
    done = untangled(mesh)
    assert done.mesh is mesh
    assert done.events == ()


def test_an_open_surface_that_crosses_is_refused():
    ball = sphere((0, 0, 0), 1.0, subdivisions=3)
    cap = Mesh(ball.vertices, ball.faces[1:])
    with pytest.raises(InputError, match="closed"):
        untangled(Mesh.merge([cap, sphere((0, 0, 1.2), 1.0, subdivisions=3)]))


@pytest.mark.slow
def test_a_reach_of_many_edges_takes_little_memory():
    """As under a PSF much wider than an edge, where each vertex has a thousand faces in reach."""
    one, other = sphere((0, 0, 0), 1.0, 0.06), sphere((0, 0, 2.2), 1.0, 0.06)
    mesh = Mesh.merge([one, other])
    tracemalloc.start()
    try:
        places = thin_places(mesh, 1.0)
        used = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    (gap,) = [place for place in places if place.is_gap]
    assert len(gap.points) < len(mesh.vertices)
    assert gap.center[2] == pytest.approx(1.1, abs=0.05)
    assert used < 400e6


def test_some_vertices_at_a_time_find_the_same(monkeypatch):
    mesh = flattened(0.1)
    (once,) = thin_places(mesh, 2 * EDGE)
    monkeypatch.setattr(thin_places_module, "_PAIRS", 50)
    (again,) = thin_places(mesh, 2 * EDGE)
    assert len(once.points) == len(again.points)
    assert once.width == pytest.approx(again.width, rel=1e-12)
    assert_allclose(once.center, again.center, atol=1e-12)
