"""The colours of regions: neighbours never share one, and regions keep theirs where they can."""

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.results.colouring import (
    COLOURS,
    PALETTE,
    _chosen,
    colour_indices,
    colour_of,
    label_indices,
)
from napari_deltamic.scene import random_cells


def numbered(mesh, by):
    """The same with other numbers of regions."""
    return nd.Mesh(mesh.vertices, mesh.faces, np.where(mesh.regions > 0, by(mesh.regions), 0))


def test_regions_have_the_colours_of_their_numbers():
    far = nd.Mesh.merge([sphere((0, 0, 5.0 * k), 1.0, edge_length=0.8) for k in range(12)])
    assert colour_indices(far) == {k: (k - 1) % len(COLOURS) for k in range(1, 13)}
    assert colour_of(9, {}) == COLOURS[0]


def test_vesicles_that_touch_differ():
    balls = [sphere(at, 1.0, edge_length=0.6) for at in ((0, 0, 0), (0.3, 0.3, 1.9))]
    touching = numbered(nd.Mesh.merge(balls), lambda r: 8 * r)
    assert len(set(colour_indices(touching).values())) == 2


@pytest.mark.parametrize("times", [1, 8, 24])
def test_cells_of_a_foam_differ_from_all_they_have_a_wall_with(times):
    grid = nd.Grid((30, 40, 40), (0.3, 0.2, 0.2))
    mesh = numbered(random_cells(20, grid, "foam", 0), lambda r: times * r)
    found = colour_indices(mesh)
    walls = np.unique(mesh.regions[(mesh.regions > 0).all(axis=1)], axis=0)
    assert len(walls) > 30
    assert all(found[a] != found[b] for a, b in walls.tolist())
    assert max(found.values()) < len(PALETTE) == len(set(PALETTE))


def test_neighbours_at_any_time_differ():
    apart = nd.Mesh.merge([sphere((0, 0, z), 1.0, edge_length=0.8) for z in (0, 9)])
    near = nd.Mesh.merge([sphere((0, 0, z), 1.0, edge_length=0.8) for z in (0, 1.5)])
    meshes = [numbered(mesh, lambda r: 8 * r) for mesh in (apart, near)]
    assert len(set(colour_indices(meshes[0]).values())) == 1
    assert len(set(colour_indices(*meshes).values())) == 2


def test_a_cell_with_many_neighbours_differs_from_all():
    """A yolk, with cells all around it: their numbers would take all colours, and its own."""
    n = 70
    ring = {k: {n, (k - 2) % (n - 1) + 1, k % (n - 1) + 1} - {k} for k in range(1, n)}
    walls = {**ring, n: set(range(1, n))}
    crowded = {k: set(range(1, n)) - {k} for k in range(1, n)}  # all boxes overlap
    found = _chosen(range(1, n + 1), walls, crowded)
    assert all(found[a] != found[b] for a in walls for b in walls[a])


@pytest.mark.parametrize("size", [9, 180])
def test_labels_that_touch_differ(size):
    blocks = 3 * np.arange(27).reshape(3, 3, 3) * 8 + 1  # numbers that all have one colour
    labels = np.kron(blocks, np.ones((size // 3,) * 3, int))
    found = label_indices(labels)
    assert set(found) == set(blocks.ravel().tolist())
    for axis in range(3):
        a, b = np.moveaxis(blocks, axis, 0)[1:], np.moveaxis(blocks, axis, 0)[:-1]
        assert all(found[x] != found[y] for x, y in zip(a.ravel(), b.ravel(), strict=True))
    alone = np.zeros((4, 9, 9), int)
    alone[1, 1, 1], alone[1, 7, 7] = 3, 11
    assert label_indices(alone) == {3: 2, 11: 2}
