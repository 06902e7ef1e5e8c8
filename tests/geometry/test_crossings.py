"""Where surfaces cross, against ipctk and against what is known."""

import numpy as np
import pytest

from napari_deltamic import Mesh
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.remeshing import can_remesh
from napari_deltamic.geometry.topology.crossings import CrossingWalls, crosses, crossings

pytestmark = pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")


TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def pair(distance, radius=1.0):
    return Mesh.merge(
        [sphere(c, radius, subdivisions=3) for c in ((0, 0, 0), (0.013, 0.021, distance))]
    )


@pytest.mark.parametrize(("distance", "expected"), [(2.1, False), (1.9, True), (0.5, True)])
def test_spheres_cross_where_they_overlap(distance, expected):
    assert crosses(pair(distance)) == expected


def test_nested_spheres_and_shared_walls_do_not_cross():
    nested = Mesh.merge([sphere((0, 0, 0), r, subdivisions=3) for r in (1.0, 0.6)])
    assert not crosses(nested)
    assert not crosses(foam(np.array([[0, 0, -0.5], [0, 0, 0.5]]), np.ones(2), 0.25))


def test_each_pair_runs_through():
    mesh = pair(1.7)
    places, found = mesh.vertices_numpy(), crossings(mesh)
    normal, corner = mesh.normals()[found[:, 1]], places[mesh.faces[found[:, 1], 0]]
    ends = places[mesh.edges()[found[:, 0]]]
    side = ((ends - corner[:, None]) * normal[:, None]).sum(2)
    assert len(found) > 20
    assert (side[:, 0] * side[:, 1] <= 0).all()
    assert len(np.unique(found, axis=0)) == len(found)


def test_surfaces_that_touch_count_if_asked_for():
    low = Mesh(np.array([[0, 0, 0], [0, 0, 1], [0, 1, 0], [1, 1, 1.0]]), TETRAHEDRON)
    high = low.with_vertices(low.vertices_numpy() * [-1, 1, 1] - [1e-3, 0, 0])
    mesh = Mesh.merge([low, Mesh(high.vertices_numpy(), TETRAHEDRON[:, ::-1])])
    assert not crosses(mesh)
    assert not len(crossings(mesh, 0.9e-3))
    assert len(crossings(mesh, 1.1e-3))


def test_agrees_with_ipctk():
    ipctk = pytest.importorskip("ipctk")
    random = np.random.default_rng(0)
    ball = sphere((0, 0, 0), 1.0, subdivisions=2)
    outcomes = []
    for size in np.linspace(0.02, 0.25, 40):
        places = ball.vertices_numpy() + size * random.normal(size=(len(ball.vertices), 3))
        mesh = ball.with_vertices(places)
        columns = np.asfortranarray(places)
        theirs = ipctk.has_intersections(
            ipctk.CollisionMesh(columns, mesh.edges(), mesh.faces), columns
        )
        assert crosses(mesh) == theirs
        outcomes.append(theirs)
    assert len(set(outcomes)) == 2


def test_walls_that_cross_are_named():
    trio = Mesh.merge([pair(1.7), sphere((0, 5, 0), 1.0, subdivisions=2)])
    walls = CrossingWalls(trio)
    assert walls.regions == {(1, 2)}
    assert walls.pairs.sum() == 2
    assert not CrossingWalls(pair(2.1))
