import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.ndimage import gaussian_filter

from napari_deltamic import GaussianPSF, Grid, Mesh
from napari_deltamic.fitting.voxels.bright_regions import (
    STRANGER,
    _rising,
    bright_regions,
    without_start,
)
from napari_deltamic.fitting.voxels.voxel_ownership import counted_around, counted_voxels
from napari_deltamic.geometry import sphere

GRID = Grid((20, 26, 44), (2.0, 1.0, 1.0))  # um
OPTICS = GaussianPSF((2.4, 1.2, 1.2))
CENTER, RADIUS = (20.0, 13.0, 13.0), 9.0


def ball(center, radius):
    """(Z, Y, X) bool."""
    voxels = np.moveaxis(np.indices(GRID.shape), 0, -1) * GRID.voxel_size
    return np.linalg.norm(voxels - center, axis=-1) < radius


def photographed(light, photons=60):
    """Photons of what shines, blurred, over 2."""
    blurred = gaussian_filter(light.astype(float), (0.9, 1.3, 1.3))
    return np.random.default_rng(0).poisson(2 + photons * blurred).astype(np.float32)


def overlap(found, true):
    """Volume that both hold over that of either."""
    return (found & true).sum() / (found | true).sum()


OWN = ball(CENTER, RADIUS)
OTHER = ball((20, 13, 29.5), 8.0) & ~OWN  # touches it
WITHIN_OTHER = ball((20, 13, 29.5), 6.5)


@pytest.mark.parametrize(("scale", "offset"), [(0.6, -0.3), (1.0, 0.1), (1.4, 0.1)])
def test_a_nucleus_that_touches_is_told_from_the_other(scale, offset):
    start = ball(np.add(CENTER, (0, 0, offset * RADIUS)), scale * RADIUS).astype(np.int32)
    found = bright_regions(photographed(OWN | OTHER), GRID, start)
    assert overlap(found == 1, OWN) > 0.8
    assert (found[OTHER] == 1).mean() < 0.01
    assert (found[WITHIN_OTHER] == STRANGER).mean() > 0.9


@pytest.mark.parametrize("brightness", [1 / 3, 3])
def test_whatever_the_brightness_of_the_other(brightness):
    image = photographed(OWN + brightness * OTHER)
    start = ball(np.add(CENTER, (2, 1, -1)), 0.8 * RADIUS).astype(np.int32)
    found = bright_regions(image, GRID, start)
    assert overlap(found == 1, OWN) > 0.75
    assert (found[OTHER] == 1).mean() < 0.02


def test_what_touches_does_not_count_however_near():
    start = sphere(np.add(CENTER, (1, 1, 1)), 0.9 * RADIUS)
    counted = counted_around(photographed(OWN | OTHER), GRID, start, OPTICS)
    assert counted[OWN].mean() > 0.98
    assert counted[OTHER].mean() < 0.02


def several(*balls):
    """One mesh of spheres, numbered from 1."""
    parts = [sphere(center, radius) for center, radius in balls]
    return Mesh.merge([Mesh(m.vertices, m.faces, k * m.regions) for k, m in enumerate(parts, 1)])


def test_a_nucleus_between_two_starts_does_not_count():
    """No part of it is 2 widths of the PSF away from both, where light may be theirs."""
    sides, between = ((20, 13, 9), (20, 13, 31)), (20, 13, 20)
    image = photographed(sum(ball(c, r) for c, r in [*((c, 6.5) for c in sides), (between, 4.0)]))
    starts = several(*((c, 6.5) for c in sides))
    counted = counted_voxels(image, GRID, starts, GaussianPSF((2.8, 2.1, 2.1)))
    assert counted[ball(sides[0], 6.5) | ball(sides[1], 6.5)].mean() > 0.98
    assert counted[ball(between, 3.0)].mean() < 0.02


@pytest.mark.parametrize("haze", [0.0, 0.4])
def test_alone_all_counts_however_the_start_errs(haze):
    """By a width of the PSF, in haze as well."""
    for error in (-1.2, 0.0, 1.2):
        start = sphere(CENTER, RADIUS + error)
        image = photographed(np.where(OWN, 1.0, haze))
        assert counted_voxels(image, GRID, start, OPTICS).mean() > 0.98


def test_one_dim_start_does_not_make_all_that_is_brighter_foreign():
    dim = ball((20, 13, 34), 4.0)
    image = photographed(OWN + 0.05 * dim + 0.15 * ball((20, 13, 24), 3.0))
    starts = several((CENTER, RADIUS), ((20, 13, 34), 4.0))
    assert counted_voxels(image, GRID, starts, OPTICS).mean() > 0.98


def test_a_nucleus_of_two_lobes_stays_whole_where_its_start_holds_both():
    first, second = ball((20, 13, 12), 8.0), ball((20, 13, 25), 8.0)
    image = photographed(first | second)
    whole = bright_regions(image, GRID, ball((20, 13, 18.5), 11.5).astype(np.int32))
    assert overlap(whole == 1, first | second) > 0.8
    half = bright_regions(image, GRID, ball((20, 13, 12), 7.0).astype(np.int32))
    assert (half[second & ~first] == 1).mean() < 0.25


def test_nuclei_of_unequal_brightness_end_at_half_of_their_own():
    image = photographed(OWN + OTHER / 4, photons=200)
    starts = ball(CENTER, 8.0) + 3_000_000_000 * ball((20, 13, 29.5), 7.0).astype(np.int64)
    found = bright_regions(image, GRID, starts)
    assert overlap(found == 1, OWN) > 0.85
    assert overlap(found == 3_000_000_000, OTHER) > 0.75
    assert_array_equal(np.unique(found), (0, 1, 3_000_000_000))


def test_a_speck_beside_a_nucleus_is_a_stranger():
    speck = ball((20, 13, 25.5), 2.1)
    image = photographed(OWN + 4 * speck)
    found = bright_regions(image, GRID, OWN.astype(np.int32))
    assert overlap(found == 1, OWN) > 0.8
    assert (found[speck] == STRANGER).mean() > 0.7


def test_dark_cores_have_no_bright_region():
    image = photographed(OWN & ~ball(CENTER, 0.7 * RADIUS))
    assert bright_regions(image, GRID, OWN.astype(np.int32)) is None


def beside_starts(image, *starts):
    """The bright things in an image that have no start."""
    light = gaussian_filter(image, 0.7)
    light -= np.percentile(light, 20)
    labels = sum(number * start for number, start in enumerate(starts, 1))
    return without_start(light > 8, light, labels, GRID)


@pytest.mark.parametrize("brightness", [0.5, 0.7, 1, 3])
@pytest.mark.parametrize("x", [28.0, 29.5, 31.0])  # the other overlaps, touches, is apart
def test_a_nucleus_without_a_start_is_found_beside_one_that_has_one(brightness, x):
    other = ball((20, 13, x), 8.0) & ~OWN
    core = ball((20, 13, x), 6.0) & ~ball(CENTER, RADIUS + 1.5)
    found = beside_starts(photographed(OWN + brightness * other), ball(CENTER, RADIUS))
    assert found[core].mean() > 0.85


def test_what_a_start_misses_of_its_nucleus_is_no_thing():
    found = beside_starts(photographed(OWN), ball(CENTER, 0.75 * RADIUS))
    assert found[OWN].mean() < 0.05


def test_light_between_nuclei_that_have_starts_is_no_nucleus():
    # A haze that is brighter between them than elsewhere, and thicker than a speck.
    third = ball((20, 13, 36.5), 8.0)
    gap = 0.6 * gaussian_filter(ball((20, 13, 25.3), 6.0).astype(float), 1.5) * ~(OWN | third)
    assert not beside_starts(photographed(OWN + third + gap), OWN, third).any()
    # The same light, where nothing brighter borders on it, is one.
    elsewhere = np.roll(gap, -9, axis=2) * ~third
    assert beside_starts(photographed(third + elsewhere), third).any()


def rising(*rows):
    """What is kept of a thing in one slice; a row is brightness, or S in a start."""
    light = np.array([[9.0 if one == "S" else float(one) for one in row] for row in rows])[None]
    starts = np.array([[one == "S" for one in row] for row in rows])[None].astype(np.int32)
    return _rising((light > 0) & (starts == 0), light, starts, 2.0)[0].astype(int).tolist()


def test_what_rises_to_a_start_is_none():
    assert rising("S6543") == [[0, 0, 0, 0, 0]]
    assert rising("S3456") == [[0, 0, 1, 1, 1]]
    assert rising("3456") == [[1, 1, 1, 1]]  # no start near
    # A peak with hardly a dip on its way to the start is noise, even if another lies between.
    assert rising("S545") == [[0, 0, 0, 0]]
    assert rising("S45454") == [[0] * 6]


def test_a_top_belongs_to_what_it_meets_at_the_brightest_place():
    # 6 meets 8 at 5, and the start only at 1: it goes with 8, which is a thing.
    assert rising("S185706") == [[0, 0, 1, 1, 1, 0, 1]]
    assert rising("S1857576") == [[0, 0, 1, 1, 1, 1, 1, 1]]


def test_corners_alone_connect_nothing():
    assert rising("S0", "05") == [[0, 0], [0, 1]]
