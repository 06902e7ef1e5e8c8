"""What vertices and walls carry goes along with a new triangulation."""

import numpy as np
import pytest

from napari_deltamic import Mesh
from napari_deltamic.fitting.model.shape import Shape
from napari_deltamic.geometry import sphere

COARSE, FINE = (sphere((0, 0, 0), 1.0, subdivisions=n) for n in (2, 3))


def two(subdivisions, names=(1, 2)):
    balls = [sphere((0, 0, 3.0 * k), 1.0, subdivisions=subdivisions) for k in range(2)]
    mesh = Mesh.merge(balls)
    regions = np.where(mesh.regions == 1, names[0], np.where(mesh.regions == 2, names[1], 0))
    return Mesh(mesh.vertices, mesh.faces, regions)


def test_the_vertices_of_the_caller_are_left_alone():
    shape = Shape.begun(COARSE, "smooth")
    vertices = shape.mesh.vertices_numpy()
    assert not np.shares_memory(vertices, COARSE.vertices_numpy())
    assert shape.log_density is None


def test_pins_stay_where_they_are():
    pinned = COARSE.vertices_numpy()[:, 2] > 0.8
    shape = Shape.begun(COARSE, "uniform").with_pins(pinned)
    turned = FINE.with_vertices(FINE.vertices_numpy()[:, [1, 2, 0]])
    after = shape.retriangulated(turned)
    assert after.pinned.sum() == pinned.sum()
    held = after.mesh.vertices_numpy()[after.pinned]
    order = [np.lexsort(v.T) for v in (held, COARSE.vertices_numpy()[pinned])]
    np.testing.assert_array_equal(held[order[0]], COARSE.vertices_numpy()[pinned][order[1]])
    free = ~after.pinned
    np.testing.assert_array_equal(after.mesh.vertices_numpy()[free], turned.vertices_numpy()[free])


def test_densities_of_walls_go_by_their_regions():
    before = two(1)
    names = [tuple(p) for p in before.interfaces()[0]]
    log = np.array([0.3 if 1 in p else -0.4 for p in names])
    shape = Shape.begun(before, "interface").moved(before.vertices_numpy(), log)
    after = shape.retriangulated(two(2))
    np.testing.assert_array_equal(after.log_density, log)
    renamed = shape.retriangulated(two(2, names=(2, 7)))
    found = dict(zip(map(tuple, renamed.mesh.interfaces()[0]), renamed.log_density, strict=True))
    assert sorted(found.values()) == [-0.4, 0.0]  # that of 2, and a new one


def test_densities_of_vertices_go_by_their_origin_or_the_nearest():
    log = COARSE.vertices_numpy()[:, 0]
    shape = Shape.begun(COARSE, "smooth").moved(COARSE.vertices_numpy(), log)
    far = FINE.translated((50, 0, 0))
    origin = np.full(len(FINE.vertices), -1)
    origin[:3] = [7, 5, 9]
    after = shape.retriangulated(far, origin)
    np.testing.assert_array_equal(after.log_density[:3], log[[7, 5, 9]])
    assert np.abs(shape.retriangulated(FINE).log_density - FINE.vertices_numpy()[:, 0]).max() < 0.4
    carried = np.arange(len(FINE.vertices), dtype=float)
    np.testing.assert_array_equal(shape.retriangulated(FINE, None, carried).log_density, carried)


@pytest.mark.parametrize("model", ["smooth", "interface"])
def test_what_is_not_known_stays_so(model):
    assert Shape.begun(COARSE, model).retriangulated(FINE).log_density is None


def test_densities_of_faces_follow():
    shape = Shape.begun(COARSE, "smooth")
    np.testing.assert_array_equal(shape.face_densities(), 1)
    log = COARSE.vertices_numpy()[:, 0]
    found = shape.moved(COARSE.vertices_numpy(), log).face_densities()
    np.testing.assert_allclose(found, np.exp(log[COARSE.faces].mean(1)))
    walls = Shape.begun(two(1), "interface").moved(two(1).vertices, np.array([0.3, -0.4]))
    pairs, row = two(1).interfaces()
    np.testing.assert_allclose(walls.face_densities(), np.exp([0.3, -0.4])[row])
    assert len(pairs) == 2


def test_another_kind_of_density_is_as_bright():
    shape = Shape.begun(COARSE, "smooth").moved(COARSE.vertices_numpy(), np.ones(162))
    assert shape.with_model("smooth") is shape
    assert shape.with_model("interface").log_density == pytest.approx([1.0])
    mesh = two(2)
    walls = Shape.begun(mesh, "interface").moved(mesh.vertices_numpy(), np.array([0.5, -0.3]))
    smooth = walls.with_model("smooth")
    np.testing.assert_allclose(smooth.face_densities(), walls.face_densities(), rtol=1e-6)
    assert walls.with_model("uniform").log_density is None
