"""Smooth changes of shape."""

import numpy as np
import pytest
from benchmarks.shapes import box
from scipy.linalg import eigh

from napari_deltamic import Mesh
from napari_deltamic.evidence.modes import density_fields, shape_modes
from napari_deltamic.geometry import sphere

BALL = sphere((0, 0, 0), 2.0, subdivisions=3)


def explained(mesh, field):
    """Share of the normal part of a displacement that the modes make up."""
    modes = shape_modes(mesh)

    def along(f):
        f = np.einsum("fd,fd->f", f[mesh.faces].mean(1), mesh.normals())
        return f * np.sqrt(mesh.areas())

    target = along(field)
    columns = np.stack([along(f) for f in modes.fields], 1)
    left = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
    return 1 - (left**2).sum() / (target**2).sum()


@pytest.mark.parametrize("mesh", [BALL, box((0, 0, 0), (2, 3, 4), edge_length=0.4)])
def test_position_size_and_stretch_are_among_them(mesh):
    v = mesh.vertices_numpy()
    for axis in range(3):
        for moved in (np.ones(len(v)), v[:, axis]):
            field = np.zeros_like(v)
            field[:, axis] = moved
            assert explained(mesh, field) > 0.97


def test_each_has_size_one_and_sizes_add_up():
    modes = shape_modes(BALL)
    assert np.allclose(np.diag(modes.gram), 1)
    swelling = BALL.vertices_numpy() / 2.0
    columns = np.stack([f.ravel() for f in modes.fields], 1)
    c = np.linalg.lstsq(columns, 0.1 * swelling.ravel(), rcond=None)[0]
    assert modes.size(c) == pytest.approx(0.1, rel=0.02)
    assert np.allclose(
        modes.displaced(BALL.vertices_numpy(), c), 1.05 * BALL.vertices_numpy(), atol=0.01
    )


def test_they_are_independent():
    assert np.linalg.cond(shape_modes(BALL).gram) < 1e5


def test_one_region_moves_alone():
    two = Mesh.merge([BALL, BALL.translated((0, 0, 6))])
    modes = shape_modes(two, regions=np.array([2]))
    assert not modes.fields[:, : len(BALL.vertices)].any()
    assert modes.fields[:, len(BALL.vertices) :].any()


def test_they_are_the_same_every_time():
    assert np.array_equal(shape_modes(BALL).fields, shape_modes(BALL).fields)


def test_a_smooth_density_has_no_constant_part_of_its_own():
    fields = density_fields(BALL, "smooth", np.array([1]))
    assert len(fields) == 8
    both = np.vstack([fields, np.ones(len(BALL.faces))])
    assert np.linalg.matrix_rank(both) == 9
    assert len(density_fields(BALL, "uniform", np.array([1]))) == 0


def test_no_solver_keeps_other_threads_waiting(monkeypatch):
    """SciPy's dense solver keeps the interpreter's lock: half a second for 1500 vertices."""
    sizes = []

    def dense(matrix, **options):
        sizes.append(len(matrix))
        return eigh(matrix, **options)

    monkeypatch.setattr("napari_deltamic.evidence.modes.eigh", dense)
    for edge in (0.4, 0.15):
        assert len(shape_modes(sphere((0, 0, 0), 1.0, edge_length=edge)).fields) > 6
    assert len(sizes) == 1  # that of the small one
    assert sizes[0] < 500
