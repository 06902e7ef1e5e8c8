"""The bending energy of a surface."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from napari_deltamic import Mesh
from napari_deltamic.geometry import bending as module
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.bending import BendingEnergy
from napari_deltamic.geometry.compiled import native
from napari_deltamic.geometry.foam import foam

compiled = pytest.mark.skipif(native() is None, reason="the compiled extension is missing")
BALL = sphere((0.3, 1.0, -2.0), 0.7, subdivisions=2)


def crumpled(mesh, size=0.03):
    noise = np.random.default_rng(0).normal(size=mesh.vertices.shape)
    return mesh.vertices_numpy() + size * noise


def in_torch(monkeypatch):
    monkeypatch.setattr(module, "native", lambda: None)


@pytest.fixture(params=["compiled", "torch"])
def either(request, monkeypatch):
    """Both ways to compute it."""
    if request.param == "torch":
        in_torch(monkeypatch)
    elif native() is None:
        pytest.skip("the compiled extension is missing")


@pytest.mark.parametrize("radius", [0.01, 1.0, 30.0])
@pytest.mark.parametrize("subdivisions", [3, 4])
def test_that_of_a_sphere_is_8_pi_whatever_its_size_and_mesh(either, radius, subdivisions):
    mesh = sphere((1, 2, 3), radius, subdivisions=subdivisions)
    energy, gradient = BendingEnergy(mesh)(mesh.vertices_numpy())
    assert_allclose(energy, 8 * np.pi, rtol=0.03)
    # It has no scale: growing costs nothing.
    outward = mesh.vertices_numpy() - (1, 2, 3)
    assert abs((gradient * outward).sum()) < 1e-9 * energy


def test_a_flat_sheet_has_none(either):
    y, x = np.meshgrid(np.arange(5.0), np.arange(5.0), indexing="ij")
    vertices = np.stack([0 * y, y, x], -1).reshape(-1, 3)
    i = np.arange(25).reshape(5, 5)
    a, b, c, d = (v.ravel() for v in (i[:-1, :-1], i[:-1, 1:], i[1:, :-1], i[1:, 1:]))
    mesh = Mesh(vertices, np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)]))
    energy, gradient = BendingEnergy(mesh)(vertices)
    assert abs(energy) < 1e-20
    assert_allclose(gradient, 0, atol=1e-10)
    # Its border is free; its middle is not.
    bent = vertices.copy()
    bent[[0, 4, 20, 24], 0] = 0.2
    energies = []
    for vertex in (0, 12):
        moved = vertices.copy()
        moved[vertex, 0] += 0.3
        energies.append(BendingEnergy(mesh)(moved)[0])
    assert energies[0] < 0.1 * energies[1]


@pytest.mark.parametrize("size", [0.0, 0.03, 0.2])
def test_gradient_against_differences(either, size):
    energy = BendingEnergy(BALL)
    at = crumpled(BALL, size)
    gradient = energy(at)[1]
    rng = np.random.default_rng(1)
    for _ in range(4):
        way = rng.normal(size=at.shape)
        h = 1e-6
        slope = (energy(at + h * way)[0] - energy(at - h * way)[0]) / (2 * h)
        assert_allclose(
            (gradient * way).sum(), slope, rtol=1e-5, atol=1e-5 * np.abs(gradient).max()
        )


@compiled
@pytest.mark.parametrize("size", [0.0, 0.05, 0.5])
def test_the_compiled_loops_are_those_in_torch(size, monkeypatch):
    centers = np.array([(0, 0, -0.5), (0, 0, 0.5), (0, 0.8, 0)])
    mesh = foam(centers, np.full(3, 0.7), 0.2)
    energy, at = BendingEnergy(mesh), crumpled(mesh, size * 0.2)
    one = energy(at)
    in_torch(monkeypatch)
    other = energy(at)
    assert one[0] > 1
    assert_allclose(one[0], other[0], rtol=1e-12)
    assert_allclose(one[1], other[1], atol=1e-11 * np.abs(other[1]).max())


def pages(angles, n=5):
    """Flat sheets that meet in a line, like the pages of a book."""
    vertices, faces = [], []
    for k, angle in enumerate(angles):
        for row in range(n):
            for far in range(n):
                vertices.append((row, far * np.sin(angle), far * np.cos(angle)))
        i = np.arange(n * n).reshape(n, n) + k * n * n
        i[:, 0] = np.arange(n) * n  # the line is that of the first
        a, b, c, d = (v.ravel() for v in (i[:-1, :-1], i[:-1, 1:], i[1:, :-1], i[1:, 1:]))
        faces += [np.stack([a, b, d], 1), np.stack([a, d, c], 1)]
    used, faces = np.unique(np.concatenate(faces), return_inverse=True)
    return Mesh(np.array(vertices)[used], faces.reshape(-1, 3))


def test_it_is_blind_at_junctions(either):
    """Where two sheets meet at an angle they are bent; three make a junction."""
    two, three = pages([0.0, 2.0]), pages([0.0, 2.0, 4.0])
    assert BendingEnergy(two)(two.vertices_numpy())[0] > 1
    energy, gradient = BendingEnergy(three)(three.vertices_numpy())
    assert abs(energy) < 1e-20
    assert_allclose(gradient, 0, atol=1e-10)


def test_it_is_the_same_wherever_it_lies(either):
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    energy, at = BendingEnergy(BALL), crumpled(BALL)
    one, gradient = energy(at)
    assert_allclose(gradient.sum(0), 0, atol=1e-9 * np.abs(gradient).max())
    other, turned = energy(5 * at @ turn.T + 2)
    assert_allclose(other, one, rtol=1e-10)
    assert_allclose(5 * turned, gradient @ turn.T, atol=1e-9 * np.abs(gradient).max())


@pytest.mark.parametrize("kind", ["a face", "an edge", "all", "a line", "far away"])
def test_degenerate_faces_give_numbers(either, kind):
    at = BALL.vertices_numpy().copy()
    face = BALL.faces[0]
    if kind == "a face":
        at[face] = at[face[0]]
    elif kind == "an edge":
        at[face[1]] = at[face[0]]
    elif kind == "all":
        at[:] = 1.0
    elif kind == "a line":
        at[:, :2] = 0
    else:
        at[face[0]] = 1e8
    energy, gradient = BendingEnergy(BALL)(at)
    assert np.isfinite(energy)
    assert energy >= 0
    assert np.isfinite(gradient).all()
