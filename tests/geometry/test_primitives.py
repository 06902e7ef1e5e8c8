from math import pi

import numpy as np
import pytest
from benchmarks.shapes import box, torus
from numpy.testing import assert_allclose

from napari_deltamic.errors import InputError
from napari_deltamic.geometry import sphere


def euler_characteristic(mesh):
    return len(mesh.vertices) - len(mesh.edges()) + len(mesh.faces)


def longest_edge(mesh):
    ends = mesh.vertices[mesh.edges()]
    return np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).max()


def test_sphere():
    mesh = sphere((1, 2, 3), 5.0, subdivisions=5)
    assert len(mesh.faces) == 20 * 4**5
    assert_allclose(np.linalg.norm(mesh.vertices - [1, 2, 3], axis=1), 5)
    assert_allclose(mesh.region_volume(1), 4 / 3 * pi * 125, rtol=1e-3)
    assert_allclose(mesh.areas().sum(), 4 * pi * 25, rtol=1e-3)
    assert mesh.is_closed()
    assert euler_characteristic(mesh) == 2


def test_sphere_converges_to_second_order():
    errors = [
        1 - sphere((0, 0, 0), 1.0, subdivisions=n).region_volume(1) / (4 / 3 * pi) for n in (2, 3)
    ]
    assert_allclose(errors[0] / errors[1], 4, rtol=0.05)


def test_ellipsoid():
    mesh = sphere((0, 0, 0), (1, 2, 3), subdivisions=5)
    assert_allclose(mesh.bounds(), [[-1, -2, -3], [1, 2, 3]], rtol=1e-2)
    assert_allclose(mesh.region_volume(1), 8 * pi, rtol=1e-3)


@pytest.mark.parametrize("edge_length", [0.1, 0.3, 2.0])
def test_sphere_edge_length(edge_length):
    mesh = sphere((0, 0, 0), 1.0, edge_length=edge_length)
    ends = mesh.vertices[mesh.edges()]
    mean = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean()
    assert 0.5 * min(edge_length, 1) < mean < 1.2 * edge_length


def test_torus():
    mesh = torus((1, 2, 3), 3.0, 1.0, edge_length=0.1)
    assert_allclose(mesh.region_volume(1), 2 * pi**2 * 3, rtol=5e-3)
    assert_allclose(mesh.areas().sum(), 4 * pi**2 * 3, rtol=5e-3)
    assert_allclose(mesh.bounds(), [[0, -2, -1], [2, 6, 7]], atol=0.01)
    assert mesh.is_closed()
    assert euler_characteristic(mesh) == 0


@pytest.mark.parametrize("edge_length", [None, 0.4])
def test_box(edge_length):
    mesh = box((1, 2, 3), (1, 2, 3), edge_length)
    assert_allclose(mesh.region_volume(1), 6)
    assert_allclose(mesh.areas().sum(), 22)
    assert_allclose(mesh.bounds(), [[0.5, 1, 1.5], [1.5, 3, 4.5]])
    assert mesh.is_closed()
    assert euler_characteristic(mesh) == 2
    if edge_length is None:
        assert len(mesh.faces) == 12
    else:
        assert longest_edge(mesh) <= edge_length * np.sqrt(2) + 1e-12


@pytest.mark.parametrize(
    "make",
    [
        lambda: sphere((0, 0, 0), -1.0),
        lambda: sphere((0, 0, 0), (1, 0, 1)),
        lambda: sphere((0, 0), 1.0),
        lambda: sphere((0, 0, 0), 1.0, edge_length=0.1, subdivisions=2),
        lambda: sphere((0, 0, 0), 1.0, edge_length=0),
        lambda: sphere((0, 0, 0), 1.0, edge_length=1e-6),
        lambda: sphere((0, 0, 0), 1.0, subdivisions=20),
        lambda: sphere((0, 0, 0), float("nan")),
    ],
)
def test_bad_sizes_are_refused(make):
    with pytest.raises(InputError):
        make()
