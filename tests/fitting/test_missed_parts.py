import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from napari_deltamic import GaussianPSF, Grid
from napari_deltamic.fitting import counted_voxels
from napari_deltamic.fitting.missed_parts import dark_regions, missed
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


@pytest.mark.parametrize("share", [0.2, 0.3, 0.4])
@pytest.mark.parametrize("light", [membrane, nucleus])
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


def test_a_bright_thread_beside_a_nucleus_is_not_its_own():
    z, y, x = np.indices(GRID.shape)
    thread = (np.hypot(y - 19.5, x - 19.5) < 2.5) & (z < 12)
    found = counted(seen(nucleus() | thread), without_top(0.0))
    assert found[nucleus()].all()
    assert not found[:4, 18:21, 18:21].any()


def test_a_membrane_that_is_open_encloses_nothing():
    ring = membrane()
    ring[:, 15:25, 30:] = False
    light = gaussian_filter(ring.astype(float), 1.5)
    everywhere = np.ones(GRID.shape, bool)
    assert not dark_regions(light, without_top(0.3), everywhere).any()
    closed = gaussian_filter(membrane().astype(float), 1.5)
    found = dark_regions(closed, without_top(0.3), everywhere) == 1
    assert found[nucleus() & (away((21.5, 19.5, 19.5)) < RADIUS - 1)].all()
    assert not found[away((21.5, 19.5, 19.5)) > RADIUS + 1].any()


def test_nothing_is_asked_where_no_other_thing_is_about():
    closed = gaussian_filter(membrane().astype(float), 1.5)
    assert not dark_regions(closed, without_top(0.3), np.zeros(GRID.shape, bool)).any()


def test_a_region_that_holds_more_missed_than_found_is_not_believed():
    whole = nucleus().astype(np.int32)
    assert missed(whole, without_top(0.4), GRID).any()
    assert not missed(whole, without_top(0.6), GRID).any()
    assert not missed(None, without_top(0.4), GRID).any()
