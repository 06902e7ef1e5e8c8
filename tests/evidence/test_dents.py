import numpy as np
import pytest

from napari_deltamic import GaussianPSF, Grid, Mesh
from napari_deltamic.evidence.dents import dents
from napari_deltamic.geometry import mesh_from_labels, sphere

GRID = Grid((40, 40, 60), (0.2, 0.2, 0.2), (1.0, 0.0, 0.0))
MIDDLE = np.array([5.0, 4.0, 4.0])
OPTICS = GaussianPSF(0.25)


def cell(depth: float, width: float) -> Mesh:
    """A ball of 2 um with a dent at its right side; lengths in um."""
    ball = sphere((0, 0, 0), 2.0, edge_length=0.12)
    v = ball.vertices_numpy().copy()
    across = np.hypot(v[:, 0], v[:, 1])
    v[:, 2] -= depth * np.exp(-0.5 * (across / width) ** 4) * (v[:, 2] > 0)
    return Mesh(v + MIDDLE, ball.faces, ball.regions)


@pytest.mark.parametrize("width", [0.3, 0.05])
def test_a_thin_dent_is_found_where_it_ends(width):
    """Also one that is thinner than a voxel."""
    found = dents(cell(1.5, width), GRID, OPTICS)
    assert list(found) == [1]
    assert found[1].end == pytest.approx((5.0, 4.0, 4.5), abs=0.3)
    assert not found[1].wall


def test_a_slit_is_told_from_a_thread():
    """Where one label covers two cells, the surface is drawn in along the wall between them."""
    ball = sphere((0, 0, 0), 2.0, edge_length=0.12)
    v = ball.vertices_numpy().copy()
    v[:, 2] -= 1.5 * np.exp(-((v[:, 0] / 0.15) ** 4) - (v[:, 1] / 1.5) ** 4) * (v[:, 2] > 0)
    (found,) = dents(Mesh(v + MIDDLE, ball.faces, ball.regions), GRID, OPTICS).values()
    assert found.wall


@pytest.mark.parametrize("mesh", [cell(0.0, 0.3), cell(0.3, 0.3), cell(1.2, 1.2)])
def test_round_cells_shallow_dents_and_wide_ones_have_none(mesh):
    assert dents(mesh, GRID, OPTICS) == {}


def test_walls_between_cells_are_no_dents():
    labels = np.ones((20, 20, 20), int)
    labels[:, 10:] = 2
    labels[8:] += 2
    mesh = mesh_from_labels(np.pad(labels, 5), GRID.voxel_size)
    assert dents(mesh, Grid((30, 30, 30), GRID.voxel_size), OPTICS) == {}


def test_a_psf_narrower_than_voxels_makes_no_dents_of_them():
    ball = sphere(MIDDLE, 2.0, edge_length=0.12)
    assert dents(ball, GRID, GaussianPSF(0.03)) == {}
