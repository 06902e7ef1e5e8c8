"""Which cells the border of an image cuts."""

import numpy as np
import pytest

from napari_deltamic import Grid
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.border import beyond, cut_cells
from napari_deltamic.geometry.foam import foam

SIZE = 0.2  # um
GRID = Grid((24, 24, 24), (SIZE,) * 3, (1.0, 0.0, -2.0))


def near(axis, side, voxels):
    """A sphere that ends so many voxels within the outermost centres; elsewhere far from them."""
    first, last = GRID.extent
    ball = sphere((first + last) / 2, 1.4, edge_length=0.4)
    low, high = ball.bounds()
    off = np.zeros(3)
    ends = first - low + voxels * SIZE, last - high - voxels * SIZE
    off[axis] = ends[side][axis]
    return ball.translated(off)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize(("voxels", "cut"), [(1.5, 0), (0.4, 0), (0.01, 0), (-0.01, 1), (-2, 1)])
def test_what_ends_between_two_voxels_is_not_cut(axis, side, voxels, cut):
    assert cut_cells(near(axis, side, voxels), GRID) == frozenset([1][:cut])


def test_at_the_centres_it_is():
    first, _ = GRID.extent
    flat = sphere((0, 0, 0), 1.0, edge_length=0.4)
    mesh = flat.translated(first + 2.0)
    lowest = mesh.vertices_numpy()[:, 1].argmin()
    places = mesh.vertices_numpy().copy()
    places[lowest, 1] = first[1]
    found = beyond(mesh.with_vertices(places), GRID)
    assert np.flatnonzero(found).tolist() == [lowest]


def test_a_neighbour_that_lies_within_is_not():
    first, _ = GRID.extent
    pair = foam(first + np.array([(0.5, 2.0, 2.0), (2.3, 2.0, 2.0)]), np.array([1.2, 1.2]), 0.3)
    assert cut_cells(pair, GRID) == {1}
    assert cut_cells(pair.translated((1.0, 0, 0)), GRID) == frozenset()
