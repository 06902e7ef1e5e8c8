import numpy as np
import pytest
from benchmarks.shapes import box
from numpy.testing import assert_array_equal
from scipy.ndimage import gaussian_filter

from napari_deltamic import GaussianPSF, Grid, Mesh
from napari_deltamic.fitting import counted_voxels
from napari_deltamic.fitting.voxels.voxel_ownership import counted_around, surface_voxels
from napari_deltamic.geometry import sphere
from synthetic import CENTER, GRID, OPTICS, RADIUS, TRUTH, measured


def from_surface(grid, center, radius):
    """Distance of each voxel from a sphere's surface, um."""
    voxels = np.moveaxis(np.indices(grid.shape), 0, -1) * grid.voxel_size + grid.origin
    return np.abs(np.linalg.norm(voxels - center, axis=-1) - radius)


@pytest.fixture
def neighbours():
    """Grid, image of two equal spheres, centre of the one without a seed."""
    grid = Grid((24, 32, 56), GRID.voxel_size)
    other = (CENTER[0], CENTER[1], CENTER[2] + 2.2)
    both = Mesh.merge([TRUTH, sphere(other, RADIUS, subdivisions=4)])
    return grid, measured(grid, both, noise=0), other


def test_a_sphere_alone_keeps_everything():
    assert counted_voxels(measured(), GRID, TRUTH, OPTICS).all()


def test_keeps_its_shell_and_drops_a_neighbour_without_a_seed(neighbours):
    grid, image, other = neighbours
    counted = counted_voxels(image, grid, TRUTH, OPTICS)
    assert counted[from_surface(grid, CENTER, RADIUS) < 0.25].all()
    bright = from_surface(grid, other, RADIUS) < 0.05
    assert counted[bright].mean() < 0.02


def test_a_neighbour_with_a_seed_stays(neighbours):
    grid, image, other = neighbours
    both = Mesh.merge([TRUTH, sphere(other, RADIUS, subdivisions=4)])
    assert counted_voxels(image, grid, both, OPTICS).all()


def test_missing_voxels_do_not_count(neighbours):
    grid, image, _ = neighbours
    image = image.astype(float)
    image[:, :5] = np.nan
    counted = counted_voxels(image, grid, TRUTH, OPTICS)
    assert not counted[:, :5].any()
    assert counted[:, 5:].any()


@pytest.mark.filterwarnings("error")
def test_an_image_without_a_voxel():
    nothing = np.full(GRID.shape, np.nan)
    assert not counted_voxels(nothing, GRID, TRUTH, OPTICS).any()


def test_a_surface_outside_the_image_changes_nothing():
    far = TRUTH.translated((100, 0, 0))
    assert counted_voxels(measured(), GRID, far, OPTICS).all()


def test_surface_voxels_are_those_at_the_surface():
    surface = surface_voxels(TRUTH, GRID)
    distance = from_surface(GRID, CENTER, RADIUS)
    assert surface[distance < 0.02].all()
    assert (distance[surface] < 0.09).all()


def test_surface_voxels_of_large_triangles_have_no_holes():
    grid = Grid((4, 120, 120), (1, 1, 1))
    surface = surface_voxels(box((1, 60, 60), (2, 100, 100)), grid)
    assert_array_equal(surface[2, 10:111, 10:111], True)


def test_a_start_beside_its_membrane_gets_the_ground_of_its_cell(neighbours):
    grid, image, other = neighbours
    start = sphere(np.add(CENTER, (0.1, 0.2, 0.1)), 0.7 * RADIUS)
    counted = counted_around(image, grid, start, OPTICS)
    assert counted[from_surface(grid, CENTER, RADIUS) < 0.25].mean() > 0.98
    assert counted[from_surface(grid, other, RADIUS) < 0.05].mean() < 0.02


def test_a_start_in_no_dark_region_claims_what_is_within_its_radius(neighbours):
    grid, image, other = neighbours
    start = sphere((1.2, 1.2, 1.2), 0.5)
    counted = counted_around(image, grid, start, OPTICS)
    assert counted[from_surface(grid, (1.2, 1.2, 1.2), 0.5) < 0.35].all()
    assert not counted[from_surface(grid, other, RADIUS) < 0.05].all()


def test_noise_is_nobodys_where_most_of_a_membrane_is_dim():
    """One side ten times as bright as the other, whose light is hardly above the noise."""
    bright = measured()
    side = np.linspace(0.1, 1, GRID.shape[2])
    image = np.random.default_rng(0).poisson(0.4 * (2 + (bright - 2) * side))
    assert counted_voxels(image, GRID, TRUTH, OPTICS).mean() > 0.9


def test_a_wide_image_is_the_surfaces_own():
    """Through a PSF three times as wide as it is taken for."""
    wide = GaussianPSF([3 * s for s in OPTICS.sigma_um])
    assert counted_voxels(measured(optics=wide), GRID, TRUTH, OPTICS).all()


@pytest.mark.parametrize("thick", [6.4, 8.0])
def test_the_rim_of_a_thick_layer_is_its_own(thick):
    """Noisy: its crest may be found on its inner side. thick : voxels."""
    grid, middle, radius = Grid((48, 48, 48), (0.2, 0.2, 0.2)), np.full(3, 4.7), 2.6
    layer = from_surface(grid, middle, radius) < 0.1 * thick
    image = np.random.default_rng(1).poisson(6 + gaussian_filter(60.0 * layer, 1.2))
    optics = GaussianPSF((0.28, 0.28, 0.28) if thick < 8 else (0.31, 0.31, 0.31))
    counted = counted_around(image, grid, sphere(middle + 0.1, 0.9 * radius), optics)
    assert counted.mean() > 0.95


def test_a_nucleus_alone_keeps_all_of_itself_wherever_it_lies():
    for center in ((0.45, 0.45, 0.45), (1.9, 2.7, 2.7)):
        image = bright(GRID, [(center, 0.5)])
        counted = counted_around(image, GRID, sphere(center, 0.45), OPTICS)
        assert counted[from_surface(GRID, center, 0) < 0.6].mean() > 0.99


def test_light_inside_a_cell_is_its_own():
    inner = sphere(CENTER, 0.4 * RADIUS, subdivisions=3)
    image = measured(GRID, Mesh.merge([TRUTH, inner]), noise=0)
    assert counted_voxels(image, GRID, TRUTH, OPTICS).all()


def test_haze_all_around_is_nobodys():
    away = np.moveaxis(np.indices(GRID.shape), 0, -1) * GRID.voxel_size + GRID.origin
    outside = np.linalg.norm(away - CENTER, axis=-1) > RADIUS
    image = measured(noise=0)
    hazy = image + 0.5 * (image.max() - image.min()) * outside
    assert counted_voxels(hazy.astype(np.float32), GRID, TRUTH, OPTICS).mean() > 0.95


def bright(grid, places):
    """Photons of balls that shine inside, blurred: 40 over 2; places: centre and radius, um."""
    found = np.zeros(grid.shape)
    for center, radius in places:
        voxels = np.moveaxis(np.indices(grid.shape), 0, -1) * grid.voxel_size + grid.origin
        found += np.linalg.norm(voxels - center, axis=-1) < radius
    blurred = gaussian_filter(found, 1.3)
    return np.random.default_rng(0).poisson(2 + 40 * blurred)


@pytest.mark.parametrize("other", [((1.15, 1.55, 3.1), 0.6), ((1.15, 1.55, 2.75), 0.2)])
def test_around_a_nucleus_its_bright_neighbours_do_not_count(other):
    grid = Grid((24, 32, 44), GRID.voxel_size)
    image = bright(grid, [(CENTER, RADIUS), other])
    start = sphere(np.add(CENTER, (0, 0.1, 0.1)), 0.8 * RADIUS)
    counted = counted_around(image, grid, start, OPTICS)
    assert counted[from_surface(grid, CENTER, RADIUS) < 0.15].mean() > 0.97
    beyond = from_surface(grid, other[0], 0) < other[1] - 0.1
    assert counted[beyond].mean() < 0.05
