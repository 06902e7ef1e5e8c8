"""Cells found by how large they are: on images whose cells are known."""

import numpy as np
import pytest
from scipy import ndimage

from napari_deltamic.errors import InputError
from napari_deltamic.geometry import find_cells, mesh_from_labels
from napari_deltamic.geometry.labels.basins import border_area
from napari_deltamic.geometry.labels.cell_sizes import likeliest, suggest_sizes
from napari_deltamic.geometry.labels.find_cells import walled_cells

VOXEL = np.array([0.4, 0.25, 0.25])
SHAPE = (26, 44, 60)
RADIUS = 2.6
TWO = np.array([[5.0, 5.4, 4.6], [5.0, 5.4, 9.8]])  # they touch: the distance is two radii
ONE = np.array([[5.0, 5.4, 7.2]])


def owners(centers, voxel=VOXEL, shape=SHAPE, radius=RADIUS):
    """(Z, Y, X) 1 to n: the balls around points, divided where they overlap; 0 outside."""
    places = np.moveaxis(np.indices(shape), 0, -1) * voxel
    distance = np.linalg.norm(places[..., None, :] - centers, axis=-1)
    return np.where(distance.min(axis=-1) < radius, distance.argmin(axis=-1) + 1, 0)


def photographed(labels, voxel=VOXEL, *, inside=10.0, medium=10.0, noise=3.0):
    """Membranes of 100 on the borders of labels, blurred, with noise."""
    edge = ndimage.grey_dilation(labels, (3, 3, 3)) != ndimage.grey_erosion(labels, (3, 3, 3))
    image = np.where(edge, 100.0, np.where(labels > 0, inside, medium))
    image = ndimage.gaussian_filter(image, 0.25 / np.asarray(voxel))
    return image + np.random.default_rng(7).normal(0, noise, image.shape)


def overlap(found, truth):
    """Of each true cell, the intersection over union with the best label found."""
    return [
        max(
            np.sum((truth == k) & (found == j)) / np.sum((truth == k) | (found == j))
            for j in range(1, found.max() + 1)
        )
        for k in range(1, truth.max() + 1)
    ]


def check(image, truth, voxel=VOXEL, size=2 * RADIUS, least=0.8):
    found = find_cells(image, voxel, size)
    assert found.dtype == np.int32
    assert found.shape == truth.shape
    assert found.max() == truth.max()
    assert min(overlap(found, truth)) > least
    return found


@pytest.mark.parametrize("size", [0.8, 1.0, 1.4])
def test_touching_cells_are_two(size):
    truth = owners(TWO)
    found = check(photographed(truth), truth, size=size * 2 * RADIUS)
    assert len(mesh_from_labels(found, VOXEL).region_ids()) == 2


@pytest.mark.parametrize("medium", [10.0, 0.0, 60.0])
def test_a_vesicle_in_a_dark_and_in_a_bright_medium(medium):
    truth = owners(ONE)
    check(photographed(truth, medium=medium), truth)


@pytest.mark.parametrize("noise", [0.0, 1.0, 10.0])
def test_noise(noise):
    truth = owners(TWO)
    check(photographed(truth, noise=noise), truth, least=0.7)


@pytest.mark.parametrize(
    ("inside", "medium", "noise"), [(85.0, 70.0, 2.5), (85.0, 70.0, 4.0), (88.0, 88.0, 4.0)]
)
def test_dim_walls_count_where_the_noise_is_less(inside, medium, noise):
    truth = owners(TWO)
    check(photographed(truth, inside=inside, medium=medium, noise=noise), truth)


@pytest.mark.parametrize("voxel", [(0.25, 0.25, 0.25), (0.6, 0.2, 0.2), (0.25, 0.4, 0.3)])
def test_voxels_of_any_proportions(voxel):
    shape = tuple(np.ceil(np.array([10.2, 10.8, 14.6]) / voxel).astype(int))
    truth = owners(TWO, voxel, shape)
    check(photographed(truth, voxel), truth, voxel, least=0.75)


def test_fine_voxels_are_put_together_first_and_the_borders_refined_again():
    voxel = np.array([0.12, 0.06, 0.06])
    shape = (60, 110, 110)
    center = 0.5 * np.array(shape) * voxel
    truth = owners(center[None], voxel, shape)
    found = check(photographed(truth, voxel), truth, voxel, least=0.9)
    across = np.flatnonzero(found[30, 55])
    assert np.ptp(across) * voxel[2] == pytest.approx(2 * RADIUS, abs=0.2)


def test_a_crowd_is_counted_and_its_outside_left_out():
    grid = np.stack(np.meshgrid([3.2, 7.2], [3.2, 7.2], [3.2, 7.2, 11.2], indexing="ij"), -1)
    truth = owners(grid.reshape(-1, 3), radius=2.4)
    found = check(photographed(truth), truth, size=4.2, least=0.7)
    assert np.mean(found[truth == 0] > 0) < 0.1


def test_only_differences_of_intensity_count():
    image = photographed(owners(TWO))
    found = find_cells(image, VOXEL, 5.2)
    np.testing.assert_array_equal(find_cells(image + 1000, VOXEL, 5.2), found)
    # Not exactly: single precision rounds otherwise.
    assert np.mean(find_cells(0.01 * image - 3, VOXEL, 5.2) != found) < 1e-3


def test_the_unit_of_length_does_not_matter():
    image = photographed(owners(TWO))
    nanometres = find_cells(image, 1000 * VOXEL, 5200)
    assert np.mean(nanometres != find_cells(image, VOXEL, 5.2)) < 1e-3


def test_integers_and_what_the_file_order_is():
    truth = owners(TWO)
    image = np.clip(photographed(truth), 0, 255)
    for kind in ("u1", ">u2", "i4", ">f4"):
        check(image.astype(kind), truth)


def test_missing_voxels():
    truth = owners(TWO)
    image = photographed(truth)
    image[:, :3] = np.nan
    image[12, 20:24, 17:22] = np.nan
    check(image, truth)


def test_a_cell_that_the_image_cuts_is_kept():
    truth = owners(TWO)[13:]
    check(photographed(owners(TWO))[13:], truth, least=0.7)


@pytest.mark.parametrize("centers", [ONE, TWO])
def test_the_size_suggested_finds_the_cells(centers):
    truth = owners(centers)
    image = photographed(truth)
    size = suggest_sizes(image, VOXEL)[0].size
    assert 0.7 * 2 * RADIUS < size < 1.4 * 2 * RADIUS
    check(image, truth, size=size)


GOOD = photographed(owners(ONE))
BAD = {
    "flat": (np.full(SHAPE, 7.0), VOXEL, 5.0, "the same value everywhere"),
    "no values": (np.full(SHAPE, np.nan), VOXEL, 5.0, "no value anywhere"),
    "2D": (GOOD[0], VOXEL, 5.0, "3D image"),
    "4D": (GOOD[None], VOXEL, 5.0, "3D image"),
    "empty": (GOOD[:0], VOXEL, 5.0, "3D image"),
    "complex": (GOOD * 1j, VOXEL, 5.0, "real numbers"),
    "words": (np.full(SHAPE, "a"), VOXEL, 5.0, "real numbers"),
    "no size": (GOOD, VOXEL, 0.0, "must be positive"),
    "negative": (GOOD, VOXEL, -5.0, "must be positive"),
    "nan": (GOOD, VOXEL, float("nan"), "must be positive"),
    "no number": (GOOD, VOXEL, "large", "must be a number"),
    "too large": (GOOD, VOXEL, 16.0, "larger than the image"),
    "too small": (GOOD, VOXEL, 0.5, "too small"),
    "voxel": (GOOD, (0.4, 0.0, 0.25), 5.0, "voxel size"),
    "two sides": (GOOD, (0.4, 0.25), 5.0, "voxel size"),
}


@pytest.mark.parametrize("name", BAD)
def test_refused(name):
    image, voxel, size, message = BAD[name]
    with pytest.raises(InputError, match=message) as caught:
        find_cells(image, voxel, size)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["flat", "no values", "2D", "words", "voxel"])
def test_no_size_is_suggested(name):
    image, voxel, _, message = BAD[name]
    with pytest.raises(InputError, match=message):
        suggest_sizes(image, voxel)


@pytest.mark.parametrize(
    "size", [*(pytest.param(s, marks=pytest.mark.slow) for s in (2.5, 4.0)), 6.0]
)
def test_no_draw_of_noise_has_cells(size):
    for seed in range(8):
        with pytest.raises(InputError, match="were found"):
            find_cells(np.random.default_rng(seed).poisson(30, SHAPE), VOXEL, size)


@pytest.mark.parametrize("sigma", [0, 0.7])
def test_in_noise_alone_there_are_no_cells(sigma):
    noise = ndimage.gaussian_filter(np.random.default_rng(3).normal(0, 1, SHAPE), sigma)
    with pytest.raises(InputError, match="no cells of about 5 um were found"):
        find_cells(noise, VOXEL, 5.0)
    assert likeliest(suggest_sizes(noise, VOXEL), noise.shape, VOXEL) > 0


def test_gaps_between_cells_are_no_cells():
    """They are as dark inside, and the walls of the cells around close most of them."""
    places = np.array(list(np.ndindex(3, 3, 3)))[::2] * 16.0 + 10
    grid = np.indices((52, 52, 52))
    away = np.min([np.hypot.reduce(grid - p[:, None, None, None]) - 7.5 for p in places], axis=0)
    light = ndimage.gaussian_filter((np.abs(away) < 0.8).astype(float), 1.2)
    image = np.random.default_rng(0).poisson(3 + 60 * light / light.max())
    found = find_cells(image, (1.0, 1.0, 1.0), 14.0)
    assert found.max() == len(places)


def test_a_slanted_border_has_the_area_of_a_plane():
    z, y, _ = np.indices((60, 60, 60))
    known = np.abs(y - 0.6 * z - 12) < 14  # between two planes
    size = np.array([0.5, 0.2, 0.2])
    area = border_area(known.shape, size, known) - border_area(known.shape, size)
    inner = np.s_[15:45, :, 10:50]
    planes = 2 * (30 * 0.5) * (40 * 0.2) * np.hypot(1, 0.6 * 0.2 / 0.5)
    assert (area * known)[inner].sum() == pytest.approx(planes, rel=0.03)


@pytest.mark.slow
def test_cells_that_a_slanted_border_cuts_are_found():
    tissues = pytest.importorskip("benchmarks.defaults.tissues")
    scene = tissues.deskewed(tissues.tissue(16, ""))
    found = walled_cells(scene.image, scene.voxel_size, 1.7)
    assert tissues.matched(found.labels, scene.all_labels) > 0.75
    assert 0.6 > tissues.matched(found.sure, scene.all_labels) > 0.3  # those that are whole
    assert set(np.unique(found.sure)) < set(np.unique(found.labels))
    assert len(found.surely) == found.labels.max()
