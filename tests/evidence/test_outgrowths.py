import numpy as np
import pytest

from napari_deltamic import GaussianPSF, Grid, Mesh
from napari_deltamic.evidence.outgrowths import outgrowths
from napari_deltamic.geometry import sphere

GRID = Grid((40, 40, 60), (0.2, 0.2, 0.2), (1.0, 0.0, 0.0))
MIDDLE = np.array([5.0, 4.0, 4.0])
OPTICS = GaussianPSF(0.25)


def cell(reach: float, width: float = 0.3, region: int = 1) -> Mesh:
    """A ball of 2 um whose right side is drawn out to a finger; lengths in um."""
    ball = sphere((0, 0, 0), 2.0, edge_length=0.12)
    v = ball.vertices_numpy().copy()
    across = np.hypot(v[:, 0], v[:, 1])
    v[:, 2] += reach * np.exp(-0.5 * (across / width) ** 4) * (v[:, 2] > 0)
    return Mesh(v + MIDDLE, ball.faces, ball.regions * region)


def test_a_finger_is_found_where_it_ends():
    found = outgrowths(cell(3.0), GRID, OPTICS)
    assert list(found) == [1]
    assert found[1] == pytest.approx((5.0, 4.0, 9.0), abs=0.4)


@pytest.mark.parametrize("mesh", [cell(0.0), cell(0.6), cell(2.0, 1.2)])
def test_round_cells_short_bumps_and_thick_ones_have_none(mesh):
    assert outgrowths(mesh, GRID, OPTICS) == {}


def test_a_cell_that_is_thin_as_a_whole_has_none():
    disc = sphere(MIDDLE, 2.0, edge_length=0.2)
    flat = disc.with_vertices((disc.vertices_numpy() - MIDDLE) * [0.12, 1, 1] + MIDDLE)
    assert outgrowths(flat, GRID, OPTICS) == {}


def test_where_many_cells_are_pointed_only_one_that_reaches_further_is_told():
    """Like the edges of cells in a tissue: what most of them have is no outgrowth."""
    grid = Grid((40, 210, 60), GRID.voxel_size, GRID.origin)
    shifts = 7.0 * np.arange(6)

    def tissue(reaches: list[float]) -> Mesh:
        cells = [cell(reach, region=k + 1) for k, reach in enumerate(reaches)]
        v = [c.vertices_numpy() + np.array([0, s, 0]) for c, s in zip(cells, shifts, strict=True)]
        n = np.cumsum([0, *(len(c.vertices) for c in cells[:-1])])
        faces = [c.faces + k for c, k in zip(cells, n, strict=True)]
        regions = np.concatenate([c.regions for c in cells])
        return Mesh(np.concatenate(v), np.concatenate(faces), regions)

    assert list(outgrowths(cell(2.5), GRID, OPTICS)) == [1]
    assert outgrowths(tissue([2.5] * 6), grid, OPTICS) == {}
    assert list(outgrowths(tissue([1.2] * 5 + [3.0]), grid, OPTICS)) == [6]
    assert list(outgrowths(tissue([0.0] * 5 + [3.0]), grid, OPTICS)) == [6]


def finned(width: float) -> Mesh:
    """A ball with a fin thinner than a voxel at its right side, 1.5 um long; width in um."""
    ball = sphere((0, 0, 0), 2.0, edge_length=0.12)
    v = ball.vertices_numpy().copy()
    v[:, 2] += 1.5 * np.exp(-((v[:, 0] / 0.1) ** 4) - (v[:, 1] / width) ** 4) * (v[:, 2] > 0)
    return Mesh(v + MIDDLE + [0.1, 0, 0], ball.faces, ball.regions)


def test_a_fin_between_the_centres_of_voxels_is_found_but_not_a_mere_edge():
    """As cells grow along a wall that no label told of; edges where cells meet are as thin."""
    found = outgrowths(finned(1.5), GRID, OPTICS)
    assert list(found) == [1]
    assert found[1] == pytest.approx((5.1, 4.0, 7.3), abs=0.8)
    assert outgrowths(finned(0.5), GRID, OPTICS) == {}


def test_a_fin_beyond_the_border_of_the_image_is_a_guess_anyway():
    assert outgrowths(finned(1.5), Grid((40, 40, 32), GRID.voxel_size, GRID.origin), OPTICS) == {}
