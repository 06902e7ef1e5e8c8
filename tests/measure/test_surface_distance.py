import time

import numpy as np
import pytest
from benchmarks.shapes import box, torus
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from napari_deltamic.errors import InputError
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.measure import distance_to_surface, surface_distance


def by_minimising(points, mesh):
    """Distance by bounded least squares over barycentric weights: slow, another method."""
    triangles = mesh.vertices[mesh.faces]
    best = np.full(len(points), np.inf)
    for steps in np.random.default_rng(0).dirichlet((0.3, 0.3, 0.3), 4000):
        on = np.einsum("c,fci->fi", steps, triangles)
        distance = np.linalg.norm(points[:, None] - on, axis=2).min(axis=1)
        best = np.minimum(best, distance)
    return best


def test_concentric_spheres():
    result = surface_distance(
        sphere((0, 0, 0), 5.0, subdivisions=4), sphere((0, 0, 0), 5.5, subdivisions=4), 3000
    )
    for value in (result.mean, result.p95, result.max):
        assert_allclose(value, 0.5, atol=0.01)


def test_same_surface_has_no_distance():
    mesh = torus((0, 0, 0), 3, 1)
    result = surface_distance(mesh, mesh, 2000)
    assert result.max < 1e-14


@pytest.mark.slow
def test_one_way_differs_from_the_other():
    small, large = box((0, 0, 0), 1), box((0, 0, 0), 2)
    result = surface_distance(small, large)
    middles = small.vertices[small.faces].mean(1)
    assert_allclose(distance_to_surface(middles, large), 0.5, rtol=1e-12)
    assert_allclose(result.max, np.sqrt(3) / 2)  # at a corner, thanks to the vertices
    # Mean over the face of the large box of the distance to the small one.
    u = (np.arange(1000) + 0.5) / 1000
    beyond = np.clip(np.abs(2 * u - 1) - 0.5, 0, None)
    expected = np.sqrt(0.25 + beyond[:, None] ** 2 + beyond**2).mean()
    assert_allclose(result.mean, (0.5 + expected) / 2, rtol=2.5e-3)
    swapped = surface_distance(large, small)
    assert_allclose(swapped.mean, result.mean, rtol=5e-3)


def test_same_surfaces_same_numbers():
    a, b = sphere((0, 0, 0), 1.0), box((0, 0, 0), 1.5)
    assert surface_distance(a, b, 500) == surface_distance(a, b, 500)


def test_distance_to_a_triangle_in_every_zone():
    mesh = Mesh([[0, 0, 0], [0, 0, 4], [0, 3, 0]], [[0, 1, 2]])
    cases = {
        (2, 1, 1): 2,  # above the face
        (0, 1, 1): 0,  # in it
        (0, -1, 2): 1,  # beside each edge
        (0, 2, -1): 1,
        (0, 3, 4): 2.4,
        (2, -2, -1): 3,  # off a corner
        (0, 0, 6): 2,
        (0, 5, 0): 2,
    }
    points = np.array(list(cases), dtype=float)
    assert_allclose(distance_to_surface(points, mesh), list(cases.values()), atol=1e-15)


@pytest.mark.parametrize(
    "mesh",
    [
        sphere((0, 0, 0), 1.0, subdivisions=1),
        box((0, 0, 0), (0.1, 1, 2)),
        Mesh([[0, 0, -1], [0, 0, 1], [0, 1e-6, 0], [0, 0, 3]], [[0, 1, 2], [0, 1, 3]]),
    ],
)
def test_against_another_method(mesh):
    points = np.random.default_rng(1).normal(size=(40, 3))
    reference = by_minimising(points, mesh)
    distance = distance_to_surface(points, mesh)
    assert (distance <= reference + 1e-12).all()
    assert_allclose(distance, reference, atol=0.02)


@pytest.mark.slow
@settings(deadline=None, max_examples=8)
@given(seed=st.integers(0, 10**6), spread=st.floats(0.01, 10))
def test_no_triangle_is_overlooked(seed, spread):
    """Triangles of very different sizes; each searched alone gives the exact answer."""
    rng = np.random.default_rng(seed)
    sizes = np.exp(rng.uniform(-5, 2, (30, 1, 1)))
    vertices = (rng.normal(size=(30, 1, 3)) + sizes * rng.normal(size=(30, 3, 3))).reshape(-1, 3)
    faces = np.arange(90).reshape(-1, 3)
    points = spread * rng.normal(size=(20, 3))
    alone = [distance_to_surface(points, Mesh(vertices, faces[[f]])) for f in range(30)]
    together = distance_to_surface(points, Mesh(vertices, faces))
    assert_allclose(together, np.min(alone, axis=0), rtol=1e-9, atol=1e-12)


def test_degenerate_faces_count_as_segments():
    mesh = Mesh([[0, 0, 0], [0, 0, 1], [0, 0, 3]], [[0, 1, 2]])
    assert_allclose(distance_to_surface(np.array([[0, 1, 2.0], [0, 0, 5.0]]), mesh), [1, 2])


def test_quick_enough():
    a, b = sphere((0, 0, 0), 5.0, edge_length=0.32), sphere((1, 0, 0), 4.0, edge_length=0.25)
    assert min(len(a.faces), len(b.faces)) > 5000
    start = time.perf_counter()
    surface_distance(a, b)
    assert time.perf_counter() - start < 15  # about 1 s on two cores; others may be using them


def test_bad_input_is_refused():
    flat = Mesh([[0, 0, 0], [0, 0, 1], [0, 0, 2]], [[0, 1, 2]])
    with pytest.raises(InputError, match="no area"):
        surface_distance(flat, box((0, 0, 0), 1))
    with pytest.raises(InputError, match="samples"):
        surface_distance(box((0, 0, 0), 1), box((0, 0, 0), 1), samples=0)
