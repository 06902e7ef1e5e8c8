"""Remeshing: what must not change (regions, junctions, volumes), and what gets better."""

import numpy as np
import pytest
from benchmarks.shapes import box, torus
from numpy.testing import assert_allclose, assert_array_equal

from napari_deltamic import InputError, Mesh
from napari_deltamic.geometry import remesh, sphere
from napari_deltamic.geometry import remeshing as module
from napari_deltamic.geometry.labels.partition import partition_mesh
from napari_deltamic.geometry.remeshing import can_remesh, smallest_angles
from napari_deltamic.geometry.topology.crossings import crosses

pytestmark = pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")


@pytest.fixture(scope="module")
def foam():
    """Eight cells in a ball, with shared walls."""
    z, y, x = np.indices((60, 60, 60)) - 29.5
    ball = z**2 + y**2 + x**2 < 25**2
    labels = 1 + 4 * (z + 0.3 * y > 0) + 2 * (y - 0.2 * x > 0.5) + (x > 0)
    rough = partition_mesh(np.where(ball, labels, 0), np.ones(3), np.zeros(3), 2.5)
    return remesh(rough, 2.5).mesh


def stretched():
    """A sphere with long thin triangles."""
    ball = sphere((0, 0, 0), 1.0, subdivisions=3)
    squeezed = ball.with_vertices(ball.vertices_numpy() * (1, 1, 4))
    return squeezed


@pytest.mark.parametrize("factor", [0.4, 1.0, 2.5])
@pytest.mark.parametrize("shape", ["stretched", "torus", "foam"])
def test_edges_near_the_length_and_good_triangles(shape, factor, foam):
    mesh = {"stretched": stretched(), "torus": torus((0, 0, 0), 3, 1, 0.3), "foam": foam}[shape]
    length = factor * float(np.median(mesh.edge_lengths()))
    done = remesh(mesh, length).mesh
    assert 0.85 < np.median(done.edge_lengths()) / length < 1.15
    assert done.edge_lengths().max() < 1.7 * length
    # Edges longer than some junctions, which must not vanish, leave worse triangles there.
    assert np.percentile(smallest_angles(done), 1) > (25 if factor < 2 else 12)
    assert done.is_closed()
    assert_array_equal(done.interfaces()[0], mesh.interfaces()[0])
    for region in mesh.region_ids():
        tolerance = 0.03 if factor > 2 else 0.006
        assert_allclose(done.region_volume(region), mesh.region_volume(region), rtol=tolerance)


def euler(mesh, region):
    own = (mesh.regions == region).any(1)
    faces = mesh.faces[own]
    edges = np.unique(np.sort(faces[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2), axis=1), axis=0)
    return len(np.unique(faces)) - len(edges) + len(faces)


@pytest.mark.parametrize("factor", [0.6, 1.0, 2.0])
def test_topology_stays(foam, factor):
    done = remesh(foam, 2.5 * factor).mesh
    assert set(np.unique(foam.edge_uses())) == {2, 3}
    assert set(np.unique(done.edge_uses())) == {2, 3}
    for region in foam.region_ids():
        assert euler(done, region) == euler(foam, region) == 2
    ring = torus((0, 0, 0), 3, 1, 0.3)
    assert euler(remesh(ring, 0.5).mesh, 1) == 0


def test_a_pass_over_a_good_mesh_changes_little(foam):
    good = remesh(foam, 2.5).mesh
    again = remesh(good, 2.5, passes=1)
    stayed = int((again.origin >= 0).sum())
    changed = len(good.vertices) + len(again.mesh.vertices) - 2 * stayed
    assert changed < 0.01 * len(good.edges())
    for region in foam.region_ids():
        assert_allclose(again.mesh.region_volume(region), good.region_volume(region), rtol=3e-3)


def test_many_passes_do_not_drift(foam):
    mesh = remesh(foam, 2.5).mesh
    volumes = [mesh.region_volume(k) for k in mesh.region_ids()]
    for _ in range(200):
        mesh = remesh(mesh, 2.5, passes=1).mesh
    assert_allclose([mesh.region_volume(k) for k in mesh.region_ids()], volumes, rtol=0.01)
    assert np.percentile(smallest_angles(mesh), 1) > 30


def test_vertices_carry_numbers_along():
    ball = sphere((0, 0, 0), 10.0, subdivisions=4)
    place = ball.vertices_numpy()
    done = remesh(ball, 1.5, carried=place, smooth=False)
    apart = np.linalg.norm(done.carried - done.mesh.vertices_numpy(), axis=1)
    assert apart.max() < 0.35 * 1.5
    one = remesh(ball, 1.5, carried=np.ones(len(place)))
    assert_array_equal(one.carried, np.ones(len(one.mesh.vertices)))


def test_fixed_vertices_stay():
    ball = sphere((0, 0, 0), 10.0, subdivisions=3)
    fixed = ball.vertices_numpy()[:, 0] > 8
    done = remesh(ball, 3.0, fixed=fixed)
    there = {tuple(v) for v in ball.vertices_numpy()[fixed]}
    assert there == {tuple(v) for v in done.mesh.vertices_numpy()[done.fixed]}
    assert len(done.mesh.vertices) < len(ball.vertices)


def test_surfaces_do_not_come_to_cross():
    # Coarser triangles would cut through the other ball, which lies close by.
    inner = sphere((0, 0, 0), 1.0, subdivisions=4)
    mesh = Mesh.merge([inner, sphere((0, 0, 0), 1.04, subdivisions=4)])
    length = 0.6
    assert crosses(remesh(mesh, length).mesh)
    done = remesh(mesh, length, apart=True).mesh
    assert not crosses(done)
    assert done.is_closed()


def test_thin_sheets_are_remeshed_as_well():
    # Of the operations only those that would make the two cross are left out.
    balls = [sphere((0, 0, 0), r, subdivisions=4) for r in (1.0, 1.04)]
    done = remesh(Mesh.merge(balls), 0.6, apart=True).mesh
    assert len(done.faces) < 0.1 * 2 * len(balls[0].faces)
    assert smallest_angles(done).min() > 15


def test_lengths_that_differ_over_the_surface():
    ball = sphere((0, 0, 0), 10.0, subdivisions=4)
    length = np.where(ball.vertices_numpy()[:, 0] > 0, 1.0, 3.0)
    done = remesh(ball, length).mesh
    middle = done.vertices_numpy()[done.edges()].mean(1)[:, 0]
    fine, coarse = (np.median(done.edge_lengths()[k]) for k in (middle > 3, middle < -3))
    assert fine < 0.5 * coarse


def test_a_coarse_box_gets_fine():
    done = remesh(box((0, 0, 0), (10, 10, 10)), 0.8).mesh
    assert done.edge_lengths().max() < 1.4
    assert_allclose(done.region_volume(1), 1000, rtol=0.01)


def test_regions_come_larger_number_first_with_their_windings():
    ball = sphere((0, 0, 0), 1.0, subdivisions=2)
    inverted = Mesh(ball.vertices, ball.faces[:, ::-1], ball.regions[:, ::-1])
    done = remesh(inverted, 0.3).mesh
    assert_array_equal(np.unique(done.regions, axis=0), [[1, 0]])
    assert done.region_volume(1) > 0


def test_an_open_surface_keeps_its_border():
    ball = sphere((0, 0, 0), 1.0, subdivisions=3)
    upper = ball.vertices_numpy()[ball.faces][:, :, 0].min(1) > 0
    cap = Mesh(ball.vertices, ball.faces[upper])
    done = remesh(cap, 0.2).mesh
    assert_allclose(done.areas().sum(), cap.areas().sum(), rtol=0.03)


def test_degenerate_faces_do_no_harm():
    ball = sphere((0, 0, 0), 1.0, subdivisions=2)
    v = ball.vertices_numpy().copy()
    a, b = ball.edges()[17]
    v[a] = v[b]
    done = remesh(ball.with_vertices(v), 0.3).mesh
    assert done.is_closed()
    assert np.isfinite(done.vertices_numpy()).all()
    assert smallest_angles(done).min() > 1


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"edge_length": 0.0}, "positive"),
        ({"edge_length": np.nan}, "positive"),
        ({"edge_length": 1.0, "carried": np.zeros(3)}, "carried"),
        ({"edge_length": 1.0, "fixed": np.zeros(3, bool)}, "fixed"),
    ],
)
def test_bad_input(options, reason):
    with pytest.raises(InputError, match=reason):
        remesh(sphere((0, 0, 0), 1.0, subdivisions=1), **options)


def test_says_when_the_extension_is_missing(monkeypatch):
    monkeypatch.setattr(module, "native", lambda: None)
    assert not can_remesh()
    with pytest.raises(InputError, match="compiled extension"):
        remesh(sphere((0, 0, 0), 1.0, subdivisions=1), 0.3)
