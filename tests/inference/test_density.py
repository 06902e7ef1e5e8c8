import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from synthetic import CENTER, GRID, OPTICS, RADIUS, TRUTH, VOXEL, apart, fitted, measured, start

from napari_deltamic import Grid, Mesh, fit, render
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.remeshing import can_remesh
from napari_deltamic.inference.density import DensityField
from napari_deltamic.inference.level import Level
from napari_deltamic.inference.likelihood import Match
from napari_deltamic.inference.preconditioner import Preconditioner
from napari_deltamic.scene.effects import Bulk, Effects, as_effects
from napari_deltamic.settings import FitSettings


def one_sided(mesh):
    """(F,) a density that is three times as high on one side."""
    middle = mesh.vertices_numpy()[mesh.faces].mean(1)
    return 1 + 0.5 * (middle[:, 2] - CENTER[2]) / RADIUS


def test_smooth_density_of_a_sphere_brighter_on_one_side():
    image = measured(density=one_sided(TRUTH))
    last = fitted(image, settings=FitSettings(density="smooth"))
    assert last.converged
    truth = one_sided(last.mesh)
    assert np.corrcoef(last.density, truth)[0, 1] > 0.95
    assert_allclose(np.average(last.density, weights=last.mesh.areas()), 1, rtol=0.02)
    assert np.abs(last.density - truth / truth.mean()).mean() < 0.05
    assert apart(last.mesh) < 0.05


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
@pytest.mark.parametrize("noise", [None, 1])
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


def test_what_an_image_hardly_shows_begins_with_the_mean_density():
    mesh, density = field("smooth")
    density.faces(active=True)
    assert density.unknown
    density.estimate(np.full(len(mesh.vertices), 1e-9), Preconditioner(mesh, 1))
    assert_allclose(density.faces_numpy(), 1)
    assert not density.unknown


def field(model, subdivisions=1):
    mesh = start(subdivisions)
    return mesh, DensityField(mesh, np.zeros(len(mesh.vertices), int), model)


@pytest.mark.parametrize("model", ["smooth", "interface"])
def test_what_is_asked_for_later_stays_where_it_was(model):
    _, density = field(model)
    density.log = np.linspace(-1, 1, len(density.log)) + 0.1
    before, later = density.faces_numpy(), density.later()
    density.faces(active=True, device="meta")  # a device with which no number of the CPU goes
    assert_allclose(later(), before)


def brightness(counted, effects=()):
    """(V,) of a level's start at the truth, where the image is twice as bright."""
    mesh, settings = sphere(CENTER, RADIUS, subdivisions=3), FitSettings(accuracy=1e-3)
    shown = render(mesh, GRID, OPTICS, 1e-4, density=one_sided(mesh), effects=effects)
    image = np.where(counted, 2 * shown.numpy(), 0).astype(np.float32)
    level = Level(image, counted, GRID, OPTICS, settings, as_effects(effects), 1.0)
    found = Match(*map(torch.tensor, (0.1, 1.0, 0.0, False)))
    return mesh, level.brightness(mesh.vertices_numpy(), shown, found)


def test_a_density_begins_with_the_mean_where_voxels_are_missing():
    counted = np.ones(GRID.shape, bool)
    counted[:, :, :16] = False
    mesh, found = brightness(counted)
    x = mesh.vertices_numpy()[:, 2] / VOXEL
    assert_allclose(found[x < 14.9], 1)
    assert_allclose(found[x > 15.1], 2, rtol=1e-3)


def test_a_density_begins_with_the_mean_where_a_dark_inside_leaves_less_than_nothing():
    mesh, found = brightness(np.ones(GRID.shape, bool), Effects.of(Bulk(density=-9.0)))
    x = mesh.vertices_numpy()[:, 2] - CENTER[2]
    assert_allclose(found[x < 0.55 * RADIUS], 1)
    assert_allclose(found[x > 0.8 * RADIUS], 2, rtol=1e-3)


def test_a_uniform_density_costs_nothing():
    mesh, density = field("uniform")
    assert density.faces(active=True) is None
    density.step(Preconditioner(mesh, 1), 1.0)
    assert_allclose(density.faces_numpy(), np.ones(len(mesh.faces)))


def test_a_smooth_density_waits_and_that_of_interfaces_does_not():
    assert field("smooth")[1].faces(active=False) is None
    assert field("interface")[1].faces(active=False).requires_grad


@pytest.mark.parametrize("model", ["smooth", "interface"])
def test_a_density_starts_uniform(model):
    _, density = field(model)
    faces = density.faces(active=True)
    assert faces.requires_grad
    assert_allclose(faces.detach(), 1)


def descend(density, mesh, gradient, n=1):
    for _ in range(n):
        (density.faces(active=True) * gradient).sum().backward()
        density.step(Preconditioner(mesh, 1), 1.0)


def test_a_step_keeps_the_mean_and_stays_bounded():
    mesh, density = field("smooth")
    gradient = torch.from_numpy(one_sided(mesh) - 1)
    descend(density, mesh, gradient)
    assert_allclose(np.average(density.faces_numpy(), weights=mesh.areas()), 1, rtol=1e-6)
    assert np.corrcoef(density.faces_numpy(), one_sided(mesh))[0, 1] < -0.9
    descend(density, mesh, gradient, 100)
    assert np.abs(density.log).max() <= 2


def test_state_round_trip():
    mesh, one = field("smooth")
    _, other = field("smooth")
    gradient = torch.from_numpy(one_sided(mesh) - 1)
    descend(one, mesh, gradient, 3)
    other.load(one.state())
    descend(one, mesh, gradient)
    descend(other, mesh, gradient)
    assert_allclose(one.log, other.log, rtol=1e-12)


@pytest.mark.parametrize("levels", [(1.0,), (1.2, 1.0)])
def test_short_schedules_fit_the_density(levels):
    settings = FitSettings(density="smooth", levels=levels, max_iterations=80)
    last = fitted(measured(density=one_sided(TRUTH)), start(1), settings=settings)
    assert np.ptp(last.density) > 0.3


# --------------------------------------------------------------------- how firmly the image holds


def evened(mesh, log, sigma=(0.1, 0.1, 0.1)):
    """(V,) what becomes of a gradient of ones."""
    density = DensityField(mesh, np.zeros(len(mesh.vertices), int), "smooth")
    density.log = log
    density.faces(active=True)
    vertices = torch.tensor(mesh.vertices_numpy())
    return density.evened(torch.ones_like(vertices), vertices, sigma)[:, 0].numpy()


def test_dim_places_are_held_less_firmly():
    mesh = start(2)
    x = mesh.vertices_numpy()[:, 2] - CENTER[2]
    found = evened(mesh, np.where(x > 0, 0.0, -np.log(4)))
    far = np.abs(x) > 0.5 * np.abs(x).max()
    assert_allclose(found[far & (x < 0)].mean() / found[far & (x > 0)].mean(), 8, rtol=0.01)


def test_places_across_the_blurred_axis_are_held_less_firmly():
    mesh = sphere(CENTER, RADIUS, subdivisions=3)
    found = evened(mesh, np.zeros(len(mesh.vertices)), sigma=(0.2, 0.1, 0.1))
    z = np.abs(mesh.vertices_numpy()[:, 0] - CENTER[0]) / RADIUS
    assert_allclose(found[z > 0.98].mean() / found[z < 0.1].mean(), 8, rtol=0.1)


def test_no_place_is_moved_without_bounds():
    mesh = start(2)
    x = mesh.vertices_numpy()[:, 2] - CENTER[2]
    found = evened(mesh, np.where(x > 0, 2.0, -2.0))
    assert found.max() <= 20
    assert found.min() >= 1 / 20


def test_a_uniform_density_leaves_the_gradient_as_it_is():
    mesh, density = field("uniform")
    density.faces(active=True)
    gradient = torch.ones(len(mesh.vertices), 3)
    assert density.evened(gradient, torch.tensor(mesh.vertices_numpy()), (0.1,) * 3) is gradient


def test_a_dim_side_arrives_as_soon_as_a_bright_one():
    x = (TRUTH.vertices_numpy()[TRUTH.faces].mean(1)[:, 2] - CENTER[2]) / RADIUS
    image = measured(density=np.exp(0.9 * x), noise=1)
    small = sphere(CENTER, 0.9 * RADIUS, subdivisions=3)
    settings = FitSettings(density="smooth", levels=(1.2, 1.0), max_iterations=80)
    last = fitted(image, small, settings=settings)
    places = last.mesh.vertices_numpy() - CENTER
    off = np.abs(np.linalg.norm(places, axis=1) - RADIUS)
    assert off[places[:, 2] < -0.7 * RADIUS].mean() < 0.1 * VOXEL
