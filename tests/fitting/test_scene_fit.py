"""Threads and spots that are fitted to images of their own, with noise."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

import napari_deltamic as nd
from napari_deltamic.fitting.model import likelihood
from napari_deltamic.fitting.thread_prior import ThreadPrior
from napari_deltamic.fourier import particle_mesh, real_fft
from napari_deltamic.fourier.filament import path_segments
from napari_deltamic.geometry import sphere
from napari_deltamic.scene.effects import Effects

VOXEL = 0.1
GRID = nd.Grid((18, 28, 28), (VOXEL, VOXEL, VOXEL), origin=(0.2, -0.1, 0.3))
OPTICS = nd.GaussianPSF((0.2, 0.15, 0.15))
WIDER = nd.GaussianPSF((0.26, 0.19, 0.19))
SPOTS = np.array([[0.7, 0.6, 0.9], [1.0, 1.9, 1.2], [1.4, 0.7, 2.2], [0.9, 1.6, 2.5]])
ALL_OFF = 2 * VOXEL * np.array([[0.6, 0.8, 0], [0, -0.6, 0.8], [-0.8, 0, 0.6], [0, 1, 0]])
BRIGHTNESS = np.array([1.0, 0.6, 0.8, 1.4])


def thread(count):
    """A wave that leaves its plane: bent to 3 widths of the PSF, and 3 voxels off its chord."""
    t = np.linspace(-1, 1, count)
    return np.stack([1.1 + 0.2 * t**2, 1.25 + 0.35 * np.sin(3 * t), 1.65 + t], 1)


THREAD = nd.Filament(thread(81))
CHORD = np.linspace(thread(2)[0], thread(2)[1], 15)
SIDEWAYS = thread(15) + np.array([0, 1.2, 1.6]) * VOXEL


def measured(*structures, photons=40, effects=(), grid=GRID):
    """With a background of 2 photons and Poisson noise; rendered finer than any fit does."""
    image = nd.render_scene(nd.Scene(structures, OPTICS, effects), grid, 1e-5).numpy()
    light = 2 + photons * image.clip(0) / image.max()
    return np.random.default_rng(1).poisson(light).astype(np.float64)


def fitted(image, *structures, optics=OPTICS, effects=(), grid=GRID, **options):
    """The result, which must have come to rest."""
    found = nd.fit_scene(image, grid, nd.Scene(structures, optics, effects), **options)
    assert found.converged, found.message
    assert found.message == ""
    return found


def off(points, truth=SPOTS):
    """Mean distance of points from their own, in voxels."""
    return np.linalg.norm(points.places - truth, axis=1).mean() / VOXEL


def apart(filament, other=THREAD):
    """Mean distance of two threads, both ways, in voxels."""
    one, two = (_along(f) for f in (filament, other))
    return (cKDTree(one).query(two)[0].mean() + cKDTree(two).query(one)[0].mean()) / 2 / VOXEL


def _along(filament):
    share = np.linspace(0, 1, 50)[:, None, None]
    first, last = (filament.positions()[filament.joined()[:, k]] for k in (0, 1))
    return (first + share * (last - first)).reshape(-1, 3)


@cache
def both():
    """An image of points beside a thread."""
    return measured(THREAD, nd.Points(SPOTS, 0.3))


# -------------------------------------------------------------------------------- what is found


@pytest.mark.parametrize("optics", [OPTICS, WIDER], ids=["psf", "wider psf"])
def test_points_two_voxels_off_are_found(optics):
    image = measured(nd.Points(SPOTS, BRIGHTNESS))
    free = optics is WIDER
    found = fitted(image, nd.Points(SPOTS + ALL_OFF), optics=optics, fit_psf=free)
    (points,) = found.scene.structures
    assert off(points) < 0.1
    weight = points.weight / points.weight.mean()
    np.testing.assert_allclose(weight, BRIGHTNESS / BRIGHTNESS.mean(), rtol=0.1)
    assert found.background == pytest.approx(2, rel=0.03)
    np.testing.assert_allclose(found.scene.optics.sigma_um, OPTICS.sigma_um, rtol=0.06)


@pytest.mark.parametrize("start", [CHORD, SIDEWAYS], ids=["straight", "sideways"])
def test_a_thread_is_found(start):
    assert apart(nd.Filament(start)) > 1
    (found,) = fitted(measured(THREAD), nd.Filament(start)).scene.structures
    assert apart(found) < 0.15
    lengths = np.linalg.norm(np.diff(found.vertices, axis=0), axis=1)
    grown = lengths / np.linalg.norm(np.diff(start, axis=0), axis=1)
    assert grown.max() < 1.3 * grown.min(), "vertices slide together"


def test_a_thread_is_found_with_its_psf():
    found = fitted(measured(THREAD), nd.Filament(SIDEWAYS), optics=WIDER, fit_psf=True)
    assert apart(found.scene.structures[0]) < 0.15
    np.testing.assert_allclose(found.scene.optics.sigma_um, OPTICS.sigma_um, rtol=0.05)


def test_points_beside_a_thread_are_found():
    found = fitted(both(), nd.Filament(SIDEWAYS), nd.Points(SPOTS + ALL_OFF, 0.1))
    filament, points = found.scene.structures
    assert apart(filament) < 0.15
    assert off(points) < 0.15  # of 16 photons at their peaks
    np.testing.assert_allclose(points.weight / filament.density, 0.3, rtol=0.2)


def test_light_of_meshes_that_stay_is_solved_for():
    ball = sphere((1.1, 1.25, 1.65), 0.6, subdivisions=2)
    image = measured(nd.Surface(ball), nd.Solid(ball, 0.5), nd.Points(SPOTS, 0.25))
    held = nd.Surface(ball), nd.Solid(ball)
    found = fitted(image, *held, nd.Points(SPOTS + ALL_OFF, 0.25))
    surface, solid, points = found.scene.structures
    assert surface.mesh is ball
    assert off(points) < 0.15  # membranes are what has 40 photons
    assert float(solid.density[0] / surface.density) == pytest.approx(0.5, rel=0.2)
    assert points.weight.mean() / surface.density == pytest.approx(0.25, rel=0.1)


def test_ratios_stay_where_brightness_is_not_fitted():
    points = nd.Points(SPOTS + ALL_OFF, BRIGHTNESS)
    image = measured(nd.Points(SPOTS, BRIGHTNESS))
    (found,) = fitted(image, points, fit_brightness=False).scene.structures
    np.testing.assert_array_equal(found.weight, BRIGHTNESS)
    assert off(found) < 0.1


def test_a_branched_thread_and_a_ring_are_found():
    arms = np.linspace(0, 0.8, 6)[1:, None]
    way = np.array([[0, 0, 1.0], [0.3, 0.8, -0.5], [-0.3, -0.8, -0.5]])
    star = np.array([1.1, 1.2, 1.2]) + np.concatenate([np.zeros((1, 3)), *(arms * w for w in way)])
    joined = [(0 if k % 5 == 0 else k, k + 1) for k in range(15)]
    turn = np.linspace(0, 2 * np.pi, 16)[:-1]
    ring = [1, 1.3, 2.4] + 0.35 * np.stack([0 * turn, np.sin(turn), np.cos(turn)], 1)
    true = [nd.Filament(star, joined), nd.Filament(ring, [(k, (k + 1) % 15) for k in range(15)])]
    moved = [nd.Filament(f.vertices + 1.2 * VOXEL, f.segments) for f in true]
    for found, filament in zip(fitted(measured(*true), *moved).scene.structures, true, strict=True):
        assert apart(found, filament) < 0.2


def test_effects_act_and_missing_voxels_do_not_count():
    effects = ("background", "attenuation")
    points = nd.Points(SPOTS, BRIGHTNESS)
    image = measured(points, effects=effects)
    image[:, 20:24] = np.nan  # from the middle of one point on
    image[:6, :4] += 500
    counted = np.ones(GRID.shape, bool)
    counted[:6, :4] = False
    start = nd.Points(SPOTS + ALL_OFF)
    (found,) = fitted(image, start, effects=effects, counted=counted).scene.structures
    assert off(found) < 0.15


def test_vertices_that_are_tensors_are_no_part_of_a_gradient():
    places = torch.tensor(SPOTS + ALL_OFF, requires_grad=True)
    sigma = torch.tensor(WIDER.sigma_um, requires_grad=True)
    image = torch.from_numpy(measured(nd.Points(SPOTS, BRIGHTNESS)))
    with torch.no_grad():
        found = fitted(image, nd.Points(places), optics=nd.GaussianPSF(sigma), fit_psf=True)
    assert off(found.scene.structures[0]) < 0.1
    assert places.grad is None
    assert sigma.grad is None
    assert not found.scene.optics.sigma.requires_grad


def test_torch_alone_finds_the_same(monkeypatch):
    """As on a GPU, or without the compiled extension."""
    start = nd.Points(SPOTS + ALL_OFF)
    image, places = measured(nd.Points(SPOTS)), []
    for given in (True, False):
        for module in (particle_mesh, real_fft, likelihood):
            monkeypatch.setattr(module, "compiled", lambda device, given=given: given)
        (points,) = fitted(image, start).scene.structures
        places.append(points.places)
    assert np.abs(places[0] - places[1]).max() < 0.01 * VOXEL


# -------------------------------------------------------------------------------- what is said


def test_what_does_not_suffice_is_said():
    start = nd.Scene(nd.Points(SPOTS + ALL_OFF), OPTICS)
    found = nd.fit_scene(measured(nd.Points(SPOTS)), GRID, start, max_iterations=2)
    assert not found.converged
    assert found.iterations == 2
    assert found.message == "2 iterations were not enough: something is still moving"


@pytest.mark.parametrize("kind", ["noise", "dark"])
def test_a_scene_that_explains_nothing_says_so(kind):
    noise = np.random.default_rng(2).poisson(np.full(GRID.shape, 9.0))
    image = noise if kind == "noise" else 50 - measured(nd.Points(SPOTS))
    found = nd.fit_scene(image, GRID, nd.Scene(nd.Points(SPOTS), OPTICS))
    assert not found.converged
    assert found.message.startswith("stuck: noise alone")


FLAT, SCENE = np.ones(GRID.shape), nd.Scene(nd.Points(SPOTS), OPTICS)
VIEWS = Effects.from_text("second_view:sigma=[0.3,0.3,0.3]")
BALL = sphere((1, 1, 1), 0.5)
WRONG = {
    "flat": (FLAT, SCENE, {}, "the image is flat"),
    "missing": (FLAT * np.nan, SCENE, {}, "every voxel of the image is missing"),
    "shape": (FLAT[1:], SCENE, {}, r"shape \(17, 28, 28\), the grid"),
    "counted": (None, SCENE, {"counted": np.ones(3, bool)}, "counted has shape"),
    "too few": (None, SCENE, {"counted": np.zeros(GRID.shape, bool)}, "only 0 voxels count"),
    "outside": (
        None,
        nd.Scene((nd.Points(SPOTS), nd.Points(SPOTS + 9)), OPTICS),
        {},
        r"a group of points \(9.7..10.4 .* lies outside the image",
    ),
    "nothing": (None, nd.Scene(nd.Surface(BALL), OPTICS), {}, "nothing can move"),
    "no length": (None, nd.Scene(nd.Filament(SPOTS[[0, 1, 1]]), OPTICS), {}, "has no length"),
    "views": (None, nd.Scene(nd.Points(SPOTS), OPTICS, VIEWS), {}, "one view"),
    "wide": (None, nd.Scene(nd.Points(SPOTS), nd.GaussianPSF(20.0)), {}, "its numbers are in um"),
    "stiff": (None, SCENE, {"persistence": -1.0}, "a persistence length is"),
    "accuracy": (None, SCENE, {"accuracy": 2.0}, "accuracy"),
    "iterations": (None, SCENE, {"max_iterations": 0}, "max_iterations"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_refused_in_one_sentence(name):
    image, scene, options, says = WRONG[name]
    with pytest.raises(nd.InputError, match=says) as told:
        nd.fit_scene(both() if image is None else image, GRID, scene, **options)
    assert "\n" not in str(told.value)


def test_inference_mode_is_refused():
    with torch.inference_mode(), pytest.raises(nd.InputError, match="needs gradients"):
        nd.fit_scene(both(), GRID, SCENE)


def test_the_example_in_the_docs_does_what_it_says():
    page = Path(__file__).parents[2] / "docs" / "simulation.md"
    if not page.exists():
        pytest.skip("not in a source tree")
    section = page.read_text().split("## Fitting threads and spots")[1].split("\n## ")[0]
    (code,) = re.findall(r"```python\n(.*?)```", section, re.S)
    names = {}
    exec(code, names)
    filament, points = names["found"].scene.structures
    true_filament, true_points = names["truth"].structures
    assert names["found"].converged
    assert apart(filament, true_filament) < 0.15
    assert off(points, true_points.places) < 0.1


# --------------------------------------------------------------------------- the prior on threads


def test_bending_is_that_of_a_worm_like_chain():
    """Half the persistence length times the squared curvature, along a half circle."""
    radius, persistence = 1.7, 3.0
    turn = np.linspace(0, np.pi, 201)
    arc = radius * np.stack([0 * turn, np.sin(turn), np.cos(turn)], 1)
    prior = ThreadPrior.of(arc, path_segments(201), persistence)
    expected = persistence / 2 * np.pi / radius
    assert float(prior.nats(torch.from_numpy(arc))) == pytest.approx(expected, rel=0.01)


def test_length_is_free_and_spacing_is_not():
    line = np.linspace([0, 0, 0], [0, 0, 1], 9)
    prior = ThreadPrior.of(line, path_segments(9), 1.0)
    slid = line.copy()
    slid[4, 2] += 0.05
    assert float(prior.nats(torch.from_numpy(3 * line))) == pytest.approx(0, abs=1e-9)
    assert float(prior.nats(torch.from_numpy(slid))) > 5


def test_the_prior_has_its_gradient_at_branches_too():
    gen = np.random.default_rng(0)
    vertices = gen.normal(size=(7, 3))
    segments = np.array([[0, 1], [1, 2], [1, 3], [3, 4], [5, 6]])
    prior = ThreadPrior.of(gen.normal(size=(7, 3)), segments, 0.8)
    assert prior.joints.tolist() == [[1, 3, 4]]
    assert prior.threads.tolist() == [0, 1, 2, 2, 3]
    at = torch.tensor(vertices, requires_grad=True)
    assert torch.autograd.gradcheck(prior.nats, (at,))
