"""The colours of regions: neighbours never share one, and regions keep theirs where they can."""

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.colouring import COLOURS, PALETTE, colour_indices, colour_of
from napari_deltamic.geometry import sphere
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
