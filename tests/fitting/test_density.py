import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from napari_deltamic import Grid, Mesh, fit
from napari_deltamic.fitting.model.density import RULES, Density
from napari_deltamic.fitting.model.level import Level
from napari_deltamic.fitting.model.likelihood import Match
from napari_deltamic.fitting.solvers.preconditioner import Preconditioner
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.remeshing import can_remesh
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import expected_image
from napari_deltamic.scene.effects import Effects
from napari_deltamic.scene.light import MEMBRANES, Light
from synthetic import CENTER, GRID, OPTICS, RADIUS, TRUTH, VOXEL, apart, fitted, measured, start


def one_sided(mesh):
    """(F,) a density that is three times as high on one side."""
    middle = mesh.vertices_numpy()[mesh.faces].mean(1)
    return 1 + 0.5 * (middle[:, 2] - CENTER[2]) / RADIUS


@pytest.mark.slow
def test_smooth_density_of_a_sphere_brighter_on_one_side():
    image = measured(density=one_sided(TRUTH))
    last = fitted(image, settings=FitSettings(density="smooth"))
    assert last.converged
    truth = one_sided(last.mesh)
    assert np.corrcoef(last.density, truth)[0, 1] > 0.95
    assert_allclose(np.average(last.density, weights=last.mesh.areas()), 1, rtol=0.02)
    assert np.abs(last.density - truth / truth.mean()).mean() < 0.05
    assert apart(last.mesh) < 0.05


@pytest.mark.slow
def test_density_of_each_interface():
    grid = Grid((20, 24, 44), GRID.voxel_size)
    centers = [(0.95, 1.15, 1.1), (0.95, 1.15, 3.2)]
    truth = Mesh.merge([sphere(c, 0.6, subdivisions=4) for c in centers])
    bright = (truth.regions == 2).any(1)
    image = measured(grid, truth, density=np.where(bright, 3.0, 1.0))
    mesh = Mesh.merge([sphere(c, 0.5, subdivisions=2) for c in centers])
    last = fitted(image, mesh, grid, settings=FitSettings(density="interface"))
    of_two = (mesh.regions == 2).any(1)
    assert np.ptp(last.density[of_two]) == 0
    assert_allclose(last.density[of_two][0] / last.density[~of_two][0], 3, rtol=0.05)


@pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
@pytest.mark.parametrize("noise", [pytest.param(None, marks=pytest.mark.slow), 1])
def test_density_of_a_double_bubbles_wall_counts_its_two_membranes(noise):
    grid = Grid((28, 28, 40), (0.1, 0.1, 0.1))
    centers, radii = np.array([(1.35, 1.35, 1.4), (1.35, 1.35, 2.5)]), np.array([0.8, 0.8])
    truth = foam(centers, radii, 0.2)
    names, of_face = truth.interfaces()
    given = np.array([1.0, 1.3, 2.2])
    image = measured(grid, truth, density=given[of_face], noise=noise)
    moved = centers + np.array([(0.05, -0.06, 0.04), (-0.05, 0.03, 0.06)])
    settings = FitSettings(density="interface", levels=(2.0, 1.35, 1.0))
    last = fitted(image, foam(moved, radii - 0.06, 0.25), grid, settings=settings)
    found_names, found_of = last.mesh.interfaces()
    assert np.array_equal(found_names, names)
    found = np.array([last.density[found_of == k].mean() for k in range(3)])
    assert_allclose(found / found[0], given / given[0], rtol=0.05)


def test_a_smooth_density_begins_with_the_brightness_of_the_image():
    image = measured(density=one_sided(TRUTH))
    near = sphere(CENTER, 0.95 * RADIUS, subdivisions=3)
    settings = FitSettings(density="smooth", levels=(1.0,))
    states = fit(image, GRID, near, OPTICS, settings=settings)
    next(states)
    second = next(states)
    truth = one_sided(second.mesh)
    assert np.corrcoef(second.density, truth)[0, 1] > 0.95
    assert np.abs(second.density / truth - 1).mean() < 0.15


def field(model, subdivisions=1, width=0.13):
    mesh = start(subdivisions)
    return mesh, Density(mesh, model, width)


def test_what_an_image_hardly_shows_begins_with_the_mean_density():
    mesh, density = field("smooth")
    log = density.estimate(np.full(len(mesh.vertices), 1e-9), Preconditioner(mesh, 1))
    assert_allclose(density.faces_numpy(log), 1)


def brightness(counted, light=MEMBRANES):
    """(V,) of a level's start at the truth, where the image is twice as bright."""
    mesh, settings = sphere(CENTER, RADIUS, subdivisions=3), FitSettings(accuracy=1e-3)
    given = mesh, GRID, OPTICS, 1e-4, 1.0, 0.0
    shown = expected_image(*given, density=one_sided(mesh), light=light)
    image = np.where(counted, 2 * shown, 0).astype(np.float32)
    level = Level(image, counted, GRID, OPTICS, settings, Effects(), 1.0)
    found = Match(1.0, 0.1, 1.0, 0.0, False)
    return mesh, level.brightness(mesh.vertices_numpy(), torch.from_numpy(shown), found, Effects())


def test_a_density_begins_with_the_mean_where_voxels_are_missing():
    counted = np.ones(GRID.shape, bool)
    counted[:, :, :16] = False
    mesh, found = brightness(counted)
    x = mesh.vertices_numpy()[:, 2] / VOXEL
    assert_allclose(found[x < 14.9], 1)
    assert_allclose(found[x > 15.1], 2, rtol=1e-3)


def test_a_density_begins_with_the_mean_where_a_dark_inside_leaves_less_than_nothing():
    mesh, found = brightness(np.ones(GRID.shape, bool), Light(1.0, -9.0))
    x = mesh.vertices_numpy()[:, 2] - CENTER[2]
    assert_allclose(found[x < 0.55 * RADIUS], 1)
    assert_allclose(found[x > 0.8 * RADIUS], 2, rtol=1e-3)


def test_a_uniform_density_has_no_numbers():
    mesh, density = field("uniform")
    nothing = np.zeros(len(density))
    assert len(nothing) == 0
    assert density.faces(torch.from_numpy(nothing)) is None
    assert_allclose(density.faces_numpy(nothing), np.ones(len(mesh.faces)))
    value, gradient = density.prior(nothing)
    assert (value, len(gradient)) == (0, 0)
    assert len(density.bounded(nothing)) == 0


@pytest.mark.parametrize("model", ["smooth", "interface"])
def test_numbers_of_zero_are_the_mean(model):
    _, density = field(model)
    log = torch.zeros(len(density), dtype=torch.float64, requires_grad=True)
    faces = density.faces(log)
    assert faces.requires_grad
    assert_allclose(faces.detach(), 1)
    value, gradient = density.prior(np.zeros(len(density)))
    assert value == 0
    assert_allclose(gradient, 0)


@pytest.mark.parametrize(
    ("model", "differ"), [("smooth", False), ("smooth", True), ("interface", False)]
)
def test_the_gradient_of_the_prior(model, differ):
    centers = [(0.95, 1.15, 1.1), (0.95, 1.15, 3.2)]
    mesh = Mesh.merge([sphere(c, 0.6, subdivisions=1) for c in centers])
    density = Density(mesh, model, 0.13, differ)
    rng = np.random.default_rng(0)
    log, way = rng.normal(size=(2, len(density)))
    value, gradient = density.prior(log)
    assert value > 0
    step = 1e-4
    slope = (density.prior(log + step * way)[0] - density.prior(log - step * way)[0]) / (2 * step)
    assert_allclose(gradient @ way, slope, rtol=1e-6)


def test_walls_that_differ_are_not_uneven():
    """A field that has one value on each of two balls is held as densities of walls are."""
    balls = [sphere(c, 0.6, subdivisions=3) for c in ((0.95, 1.15, 1.1), (0.95, 1.15, 3.2))]
    mesh = Mesh.merge(balls)
    smooth, walls = Density(mesh, "smooth", 0.2, walls_differ=True), Density(mesh, "interface", 0.2)
    second = mesh.vertices_numpy()[:, 2] > 2
    step = np.where(second, 0.6, -0.4)
    assert smooth.prior(step)[0] == pytest.approx(walls.prior(np.array([-0.4, 0.6]))[0], rel=1e-6)
    within = np.where(mesh.vertices_numpy()[:, 1] > 1.15, 0.6, -0.4)
    assert smooth.prior(within)[0] > 3 * smooth.prior(step)[0]
    assert Density(mesh, "smooth", 0.2).prior(step)[0] > 3 * smooth.prior(step)[0]


@pytest.mark.parametrize(
    ("cells", "levels", "interior", "first"),
    [
        pytest.param(2, 1, 8.0, True, marks=pytest.mark.slow),
        (2, 1, 0.0, False),
        pytest.param(1, 1, 8.0, False, marks=pytest.mark.slow),
        pytest.param(2, 2, 8.0, False, marks=pytest.mark.slow),
    ],
)
def test_walls_come_before_places_within_them_in_several_cells_that_shine_inside(
    cells, levels, interior, first
):
    grid = Grid((20, 24, 44), GRID.voxel_size)
    centers = [(0.95, 1.15, 1.1), (0.95, 1.15, 3.2)][:cells]
    truth = Mesh.merge([sphere(c, 0.6, subdivisions=4) for c in centers])
    light = Light(1.0, interior)
    image = expected_image(truth, grid, OPTICS, 1e-4, 1.0, 0.0, light=light)
    image += np.random.default_rng(0).normal(scale=0.01 * image.max(), size=image.shape)
    mesh = Mesh.merge([sphere(c, 0.55, subdivisions=2) for c in centers])
    settings = FitSettings(density="smooth", levels=(1.5, 1.0)[-levels:])
    states = list(fit(image, grid, mesh, OPTICS, settings=settings))
    one = (mesh.regions == 1).any(1)
    even = [np.ptp(state.density[one]) == 0 for state in states if state.level == levels]
    assert even[1] == first
    assert not even[-1]


def test_the_prior_hardly_depends_on_how_fine_the_mesh_is():
    values = []
    for subdivisions in (3, 4):
        mesh = sphere(CENTER, RADIUS, subdivisions=subdivisions)
        log = (mesh.vertices_numpy()[:, 2] - CENTER[2]) / RADIUS
        values.append(Density(mesh, "smooth", 0.13).prior(log)[0])
    assert_allclose(values[1], values[0], rtol=0.05)


@pytest.mark.parametrize("model", ["smooth", "interface"])
def test_bounded_densities_have_the_mean_one_and_a_limit(model):
    centers = [(0.95, 1.15, 1.1), (0.95, 1.15, 3.2)]
    mesh = Mesh.merge([sphere(c, 0.6, subdivisions=2) for c in centers])
    density = Density(mesh, model, 0.13)
    log = np.random.default_rng(0).normal(size=len(density)) + 0.7
    mean = np.average(density.faces_numpy(density.bounded(log)), weights=mesh.areas())
    assert_allclose(mean, 1, rtol=1e-6 if np.abs(density.bounded(log)).max() < RULES.limit else 0.1)
    assert np.abs(density.bounded(30 * log)).max() <= RULES.limit


@pytest.mark.parametrize("model", ["smooth", "interface"])
def test_a_smooth_density_waits_for_the_first_shape_and_that_of_interfaces_does_not(model):
    settings = FitSettings(density=model, levels=(1.5, 1.0), max_iterations=40)
    mesh = Mesh.merge([start(2), sphere((1.15, 0.5, 1.55), 0.2, subdivisions=1)])
    states = list(fit(measured(), GRID, mesh, OPTICS, settings=settings))
    first = [np.ptp(s.density) for s in states if s.level == 1]
    assert (max(first) == 0) == (model == "smooth")


@pytest.mark.parametrize("levels", [pytest.param((1.0,), marks=pytest.mark.slow), (1.2, 1.0)])
def test_short_schedules_fit_the_density(levels):
    settings = FitSettings(density="smooth", levels=levels, max_iterations=80)
    last = fitted(measured(density=one_sided(TRUTH)), start(1), settings=settings)
    assert np.ptp(last.density) > 0.3


def test_a_dim_side_arrives_as_soon_as_a_bright_one():
    x = (TRUTH.vertices_numpy()[TRUTH.faces].mean(1)[:, 2] - CENTER[2]) / RADIUS
    image = measured(density=np.exp(0.9 * x), noise=1)
    small = sphere(CENTER, 0.9 * RADIUS, subdivisions=3)
    settings = FitSettings(density="smooth", levels=(1.2, 1.0), max_iterations=80)
    last = fitted(image, small, settings=settings)
    places = last.mesh.vertices_numpy() - CENTER
    off = np.abs(np.linalg.norm(places, axis=1) - RADIUS)
    assert off[places[:, 2] < -0.7 * RADIUS].mean() < 0.1 * VOXEL
