"""Walls of even curvature and round rims cost no bending; what is uneven costs what it did."""

import numpy as np
import pytest
from benchmarks.double_bubble import DoubleBubble
from numpy.testing import assert_allclose

from napari_deltamic.geometry import bending as module
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.bending import BendingEnergy
from napari_deltamic.geometry.compiled import native
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.junction_bending import JunctionBending

BUBBLE = DoubleBubble(1.0, (1.0, 1.0, 1.8)).mesh(0.15)
THREE = foam(np.array([(0, 0, -0.5), (0, 0, 0.5), (0, 0.8, 0)]), np.full(3, 0.7), 0.2)
WIDTH = 0.05


def crumpled(mesh, size=0.02):
    return mesh.vertices_numpy() + size * np.random.default_rng(0).normal(
        size=(len(mesh.vertices), 3)
    )


def slope(energy, at, way, step=1e-6):
    return (energy(at + step * way)[0] - energy(at - step * way)[0]) / (2 * step)


def test_caps_of_a_double_bubble_cost_next_to_nothing():
    at = BUBBLE.vertices_numpy()
    plain, even = BendingEnergy(BUBBLE)(at)[0], BendingEnergy(BUBBLE, WIDTH)(at)[0]
    assert plain > 40
    assert 0 <= even < 0.03 * plain
    # A bump within a cap costs what it did: only the mean over a wall is free.
    bump = np.exp(-((at - at[at[:, 0].argmax()]) ** 2).sum(1) / 0.3**2)
    moved = at + 0.1 * bump[:, None] * [1.0, 0, 0]
    rises = [BendingEnergy(BUBBLE, w)(moved)[0] - e for w, e in ((None, plain), (WIDTH, even))]
    assert rises[1] > 0.5 * rises[0] > 0


def test_a_wall_much_smaller_than_the_psf_has_no_curvature_of_its_own():
    at = BUBBLE.vertices_numpy()
    assert_allclose(BendingEnergy(BUBBLE, 1e3)(at)[0], BendingEnergy(BUBBLE)(at)[0], rtol=1e-3)


def test_closed_cells_bend_as_they_did():
    ball = sphere((0, 0, 0), 0.7, subdivisions=2)
    at = crumpled(ball)
    energies = [BendingEnergy(ball, w)(at) for w in (None, WIDTH)]
    assert energies[0][0] == energies[1][0]
    assert np.array_equal(energies[0][1], energies[1][1])


@pytest.mark.parametrize("mesh", [BUBBLE, THREE], ids=["bubble", "three"])
def test_gradients_against_differences(mesh):
    at = crumpled(mesh)
    for energy in (BendingEnergy(mesh, WIDTH), JunctionBending(mesh, 0.2)):
        gradient = energy(at)[1]
        for seed in range(3):
            way = np.random.default_rng(seed).normal(size=at.shape)
            bound = 1e-5 * np.abs(gradient).max()
            assert_allclose((gradient * way).sum(), slope(energy, at, way), rtol=1e-5, atol=bound)


@pytest.mark.skipif(native() is None, reason="the compiled extension is missing")
def test_the_compiled_loops_are_those_in_torch(monkeypatch):
    energy, at = BendingEnergy(THREE, WIDTH), crumpled(THREE)
    one = energy(at)
    monkeypatch.setattr(module, "native", lambda: None)
    other = energy(at)
    assert_allclose(one[0], other[0], rtol=1e-12)
    assert_allclose(one[1], other[1], atol=1e-11 * np.abs(other[1]).max())


def rim(mesh):
    """Its vertices on the junction, in order around it."""
    edges = mesh.edges()
    uses = np.bincount(mesh.face_edges().ravel(), minlength=len(edges))
    on = np.unique(edges[uses > 2])
    at = mesh.vertices_numpy()[on]
    away = at - at.mean(0)
    u, v = np.linalg.svd(away)[2][:2]
    return on[np.argsort(np.arctan2(away @ u, away @ v))]


def test_a_round_rim_costs_nothing_and_a_zigzag_what_it_bends():
    energy, at, on = JunctionBending(BUBBLE, 1.0), BUBBLE.vertices_numpy(), rim(BUBBLE)
    assert len(on) % 2 == 0
    # Of the circle itself, 1/2 integral of k^2 ds is pi over its radius.
    assert energy(at)[0] < 0.01 * np.pi
    height, step = 0.02, 2 * np.sin(np.pi / len(on))
    zigzag = at.copy()
    zigzag[on] += (
        height
        * ((-1.0) ** np.arange(len(on)))[:, None]
        * np.linalg.svd(at[on] - at[on].mean(0))[2][2]
    )
    # At each vertex the line turns by 4 height / step, over a length of a step.
    expected = 0.5 * len(on) * (4 * height / step) ** 2 / step
    assert_allclose(energy(zigzag)[0], expected, rtol=0.2)


def test_second_derivatives_of_lines_are_those_of_small_displacements():
    energy, at, on = JunctionBending(BUBBLE, 1.0), BUBBLE.vertices_numpy(), rim(BUBBLE)
    normal = np.linalg.svd(at[on] - at[on].mean(0))[2][2]
    ways = np.tile(normal, (len(at), 1))
    height = np.zeros(len(at))
    height[on] = 1e-4 * np.random.default_rng(0).normal(size=len(on))
    found = 0.5 * height @ energy.curvature(at, ways) @ height
    rise = energy(at + height[:, None] * ways)[0] - energy(at)[0]
    assert_allclose(found, rise, rtol=0.05)
