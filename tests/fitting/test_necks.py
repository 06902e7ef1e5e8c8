import numpy as np
import pytest

from napari_deltamic import GaussianPSF, Grid
from napari_deltamic.fitting.voxels.necks import beyond_necks, widened, within
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.labels.meshes import mesh_from_labels

GRID = Grid((40, 40, 60), (0.2, 0.2, 0.2), (1.0, 0.0, 0.0))
OPTICS = GaussianPSF(0.25)
CELL, OTHER = np.array([20, 20, 20]), np.array([20, 20, 38])


def cell(neck: float):
    """Two balls, 10 and 6 voxels in radius, with a rod of this radius between them."""
    places = np.moveaxis(np.indices(GRID.shape), 0, -1).astype(float)
    balls = [np.linalg.norm(places - c, axis=-1) < r for c, r in ((CELL, 10), (OTHER, 6))]
    across = np.linalg.norm(places[..., :2] - CELL[:2], axis=-1)
    rod = (across < neck) & (abs(places[..., 2] - 29) < 9)
    return mesh_from_labels((balls[0] | balls[1] | rod).astype(np.int32), (0.2,) * 3, (1.0, 0, 0))


START = sphere((5.0, 4.0, 4.0), 1.8, subdivisions=4)


def test_a_ball_behind_a_thin_neck_is_told():
    found = beyond_necks(START, cell(1.3), GRID, OPTICS).middles
    assert list(found) == [1]
    assert found[1] == pytest.approx((5.0, 4.0, 7.6), abs=0.4)


def test_a_larger_neighbour_that_a_small_cell_has_swallowed_is_told():
    small = sphere((5.0, 4.0, 7.6), 0.9, subdivisions=4)
    assert beyond_necks(small, cell(1.3), GRID, OPTICS).middles[1] == pytest.approx(
        (5, 4, 4), abs=0.4
    )


def test_a_neck_need_not_be_thin():
    """About 0.6 times as thick as the thinner ball; less of one is no neck."""
    assert list(beyond_necks(START, cell(3.0), GRID, OPTICS).middles) == [1]
    assert beyond_necks(START, cell(3.6), GRID, OPTICS).middles == {}


def test_a_thick_way_is_no_neck():
    assert beyond_necks(START, cell(5.0), GRID, OPTICS).middles == {}


def test_what_the_start_had_is_meant():
    assert beyond_necks(cell(1.3), cell(1.3), GRID, OPTICS).middles == {}


def test_a_part_that_the_image_hardly_shows_is_none():
    assert beyond_necks(START, cell(1.3), GRID, GaussianPSF(0.9)).middles == {}


@pytest.mark.parametrize(("slices", "told"), [(43, True), (39, True), (34, False)])
def test_a_ball_that_the_border_cuts_is_as_thick_beyond_it(slices, told):
    """It counts if the image shows enough of it: here, all, most, and two slices."""
    grid = Grid((40, 40, slices), GRID.voxel_size, GRID.origin)
    found = beyond_necks(START, cell(1.3), grid, OPTICS)
    assert (list(found.middles) == [1]) is told
    assert found.parts.shape == found.grid.shape
    assert found.parts[within(found.grid, grid)].shape == grid.shape


def test_a_widened_grid_has_the_same_voxels():
    wide = widened(GRID, OPTICS)
    box = within(wide, GRID)
    first = np.asarray(wide.origin) + [side.start for side in box] * np.asarray(wide.voxel_size)
    assert first == pytest.approx(GRID.origin)
    assert all(side.start > 0 for side in box)
