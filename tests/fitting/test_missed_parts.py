import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt, gaussian_filter

from napari_deltamic import GaussianPSF, Grid
from napari_deltamic.fitting import counted_voxels
from napari_deltamic.fitting.voxels.missed_parts import dark_regions, missed
from napari_deltamic.geometry import mesh_from_labels

GRID = Grid((44, 40, 40), (0.2, 0.2, 0.2))
OPTICS = GaussianPSF(0.3)
RADIUS = 12.0


def away(center, shape=GRID.shape):
    """(Z, Y, X) voxels from a place."""
    return np.linalg.norm(np.moveaxis(np.indices(shape), 0, -1) - center, axis=-1)


def seen(light, seed=0):
    blurred = gaussian_filter(light.astype(float), 1.5)
    return np.random.default_rng(seed).poisson(3 + 60 * blurred / blurred.max()).astype(np.float32)


def membrane(center=(21.5, 19.5, 19.5)):
    return np.abs(away(center) - RADIUS) < 0.7


def nucleus(center=(21.5, 19.5, 19.5)):
    return away(center) < RADIUS


def without_top(share, center=(21.5, 19.5, 19.5)):
    """A label that lacks so much of the height of its cell."""
    label = nucleus(center).astype(np.int32)
    label[: int(center[0] - RADIUS + 2 * RADIUS * share)] = 0
    return label


def counted(image, label):
    return counted_voxels(image, GRID, mesh_from_labels(label, GRID.voxel_size), OPTICS)


@pytest.mark.parametrize(("light", "share"), [(membrane, 0.4), (nucleus, 0.3), (nucleus, 0.4)])
def test_the_top_that_a_label_lacks_belongs_to_its_cell(light, share):
    assert counted(seen(light()), without_top(share)).mean() > 0.99


@pytest.mark.parametrize("light", [membrane, nucleus])
def test_a_neighbour_in_place_of_a_top_is_another_cell(light):
    # Touching cells, one above the other: the label holds the lower one but for its top.
    low = (30.0, 19.5, 19.5)
    high = (30.0 - 2 * RADIUS, 19.5, 19.5)
    image = seen(light(low) | light(high))
    label = without_top(0.2, low)
    found = counted(image, label)
    assert found[label > 0].all()
    assert found[light(high) & (away(low) > RADIUS + 4)].mean() < 0.05


def pair(distance, radius, wall=None):
    """(Z, Y, X) light of a cell and of another above it, behind a wall so bright; the cells."""
    low, high = (29.5, 19.5, 19.5), (29.5 - distance, 19.5, 19.5)
    cell = away(low) < RADIUS
    other = (away(high) < radius) & ~cell
    if wall is None:
        return (cell | other).astype(float), cell, other
    around = away(low) - RADIUS
    shell = np.abs(around) < 0.7
    within = shell & (away(high) < radius + 0.7)
    light = np.where(within, wall, shell.astype(float))
    light[(np.abs(away(high) - radius) < 0.7) & (around > 0.7)] = 1.0
    return light, cell, other


@pytest.mark.parametrize("wall", [1.0, 0.8, 0.7, 0.6])
def test_a_neighbour_behind_a_dim_wall_is_another_cell(wall):
    light, cell, other = pair(16.0, 9.0, wall)
    found = counted(seen(light), cell.astype(np.int32))
    assert found[cell].all()
    assert found[other & (distance_transform_edt(~cell) > 4)].mean() < 0.3


@pytest.mark.parametrize(("distance", "radius"), [(18.0, 8.0), (17.6, 10.0)])
def test_a_nucleus_joined_to_a_larger_one_is_another_cell(distance, radius):
    light, cell, other = pair(distance, radius)
    found = counted(seen(light), cell.astype(np.int32))
    assert found[cell].all()
    assert found[other & (distance_transform_edt(~cell) > 4)].mean() < 0.3


def test_what_is_beyond_a_neck_is_another_cell():
    _, cell, other = pair(16.0, 10.0)
    both = (cell | other).astype(np.int32)
    assert not missed(both, cell.astype(np.int32), GRID).any()
    cut = cell.copy()
    cut[:22] = False  # the top of this cell, on which the other lies
    assert not missed(both, cut.astype(np.int32), GRID)[other].any()


def test_flat_cells_have_tops_as_well():
    z, y, x = np.indices(GRID.shape)
    flat = ((z - 21.5) / 5) ** 2 + ((y - 19.5) / 15) ** 2 + ((x - 19.5) / 15) ** 2 < 1
    label = flat.astype(np.int32)
    label[:, :, :12] = 0
    found = missed(flat.astype(np.int32), label, GRID)
    assert found[flat & (label == 0)].mean() > 0.5


def test_labels_may_have_large_numbers():
    label = without_top(0.3) * 50_000_000
    image = seen(nucleus())
    assert counted(image, label).mean() > 0.99


def test_voxels_may_be_tall_and_missing():
    grid = Grid((22, 40, 40), (0.4, 0.2, 0.2))
    image, label = seen(nucleus())[::2], without_top(0.4)[::2]
    image[:, :, :4] = np.nan
    found = counted_voxels(image, grid, mesh_from_labels(label, grid.voxel_size), OPTICS)
    assert found[:, :, 4:].mean() > 0.99
    assert not found[:, :, :4].any()


def test_a_bright_thread_beside_a_nucleus_is_not_its_own():
    z, y, x = np.indices(GRID.shape)
    thread = (np.hypot(y - 19.5, x - 19.5) < 2.5) & (z < 12)
    found = counted(seen(nucleus() | thread), without_top(0.0))
    assert found[nucleus()].all()
    assert not found[:4, 18:21, 18:21].any()
    both = (nucleus() | thread).astype(np.int32)
    assert not missed(both, without_top(0.0), GRID)[:7].any()


def test_a_membrane_that_is_open_encloses_nothing():
    ring = membrane()
    ring[:, 15:25, 30:] = False
    light = gaussian_filter(ring.astype(float), 1.5)
    everywhere = np.ones(GRID.shape, bool)
    start = without_top(0.3)
    assert not missed(dark_regions(light, start, everywhere), start, GRID).any()
    closed = gaussian_filter(membrane().astype(float), 1.5)
    found = dark_regions(closed, without_top(0.3), everywhere) == 1
    assert found[nucleus() & (away((21.5, 19.5, 19.5)) < RADIUS - 1)].all()
    assert not found[away((21.5, 19.5, 19.5)) > RADIUS + 1].any()


@pytest.mark.parametrize(("inside", "enclosed"), [(0.85, True), (0.95, False)])
def test_an_inside_as_bright_as_its_membrane_is_not_enclosed(inside, enclosed):
    light = np.where(membrane(), 1.0, inside * nucleus())
    start = nucleus().astype(np.int32)
    assert dark_regions(light, start, np.ones(GRID.shape, bool)).any() == enclosed


def test_nothing_is_asked_where_no_other_thing_is_about():
    closed = gaussian_filter(membrane().astype(float), 1.5)
    assert not dark_regions(closed, without_top(0.3), np.zeros(GRID.shape, bool)).any()


def test_a_region_that_holds_more_missed_than_found_is_not_believed():
    whole = nucleus().astype(np.int32)
    assert missed(whole, without_top(0.4), GRID).any()
    assert not missed(whole, without_top(0.6), GRID).any()
    assert not missed(None, without_top(0.4), GRID).any()
