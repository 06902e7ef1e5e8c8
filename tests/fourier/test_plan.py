"""Bands, quadrature, and the plan that keeps what an accuracy promises."""

import warnings
from functools import cache
from itertools import product
from math import factorial

import numpy as np
import pytest
import torch
from benchmarks.shapes import box, scaled
from numpy.testing import assert_allclose

import napari_deltamic as nd
from napari_deltamic.errors import RepairWarning
from napari_deltamic.fourier import Band, make_plan
from napari_deltamic.fourier.closed_form import band_ft
from napari_deltamic.fourier.cost import BUILT_IN
from napari_deltamic.fourier.falloff import (
    POINT_LIKE,
    Falloff,
    band_error,
    of_solid,
    of_surface,
    threshold_for,
)
from napari_deltamic.fourier.quadrature import DEGREES, choose_rules, rule
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.scene import Renderer, Scene
from napari_deltamic.scene.structures import Solid

METHODS = (None, "closed form", "particle-mesh")
ACCURACIES = (1e-2, 1e-3, 1e-4, 1e-5)

# ------------------------------------------------------------------------- what accuracy promises

GRID = nd.Grid((38, 40, 41), (0.1, 0.1, 0.1), origin=(-1.9, -2.0, -2.0))
OPTICS = nd.GaussianPSF(0.15)
TILTED = nd.GaussianPSF(covariance=[[0.04, 0.0, 0.02], [0.0, 0.03, -0.01], [0.02, -0.01, 0.04]])
FILES = {
    "cow": "meshes/cow.obj",
    "knot": "meshes/cgal__knot1.off",
    "four cells": "multimaterial/deltamic__cell4.rec",
}
SHAPES = {
    "large triangles": sphere((0.0, 0.0, 0.0), 1.3, subdivisions=1),
    "flat walls": box((0.03, -0.02, 0.01), (1.0, 1.5, 2.0)),
}
SMALL_SHAPES = {
    "vesicle": sphere((0.0, 0.0, 0.0), 0.2, subdivisions=2),
    "speck": sphere((0.02, 0.0, 0.01), 0.03, subdivisions=1),
    "thread": box((0.0, 0.01, 0.02), (0.02, 0.02, 2.0), edge_length=0.2),
}


@pytest.fixture
def folder(request, name):
    """Where the mesh of this name lies; asked for only where it is a file."""
    return request.getfixturevalue("shared_data") if name in FILES else None


@cache
def mesh_named(name, folder=None):
    if name not in FILES:
        return (SHAPES | SMALL_SHAPES)[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RepairWarning)
        mesh = nd.load_mesh(folder / FILES[name])
    low, high = mesh.bounds()
    return scaled(mesh.translated(-(low + high) / 2), 2.6 / (high - low).max())


@cache
def exact_image(name, optics, folder=None):
    return nd.render(mesh_named(name, folder), GRID, optics, accuracy=0)


def check_accuracy(name, optics, accuracy, method, folder=None):
    mesh, exact = mesh_named(name, folder), exact_image(name, optics, folder)
    renderer = Renderer(Scene.of(mesh, optics), GRID, accuracy, method=method)
    u = renderer.transform(torch.from_numpy(mesh.vertices_numpy()))
    image = renderer.image(u, renderer.otf(optics))
    error = float((image - exact).norm() / exact.norm())
    if method is not None:
        assert renderer.plan.method == method
    assert error <= accuracy
    assert error <= renderer.plan.expected_error
    # Nor is more expected than was asked for, or so much less that it would cost time for nothing.
    assert accuracy / 10 < renderer.plan.expected_error <= accuracy


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("accuracy", ACCURACIES)
@pytest.mark.parametrize(
    "name",
    [*(pytest.param(n, marks=pytest.mark.slow) for n in ("cow", "knot")), "four cells", *SHAPES],
)
def test_image_is_as_accurate_as_asked(name, accuracy, method, folder):
    check_accuracy(name, OPTICS, accuracy, method, folder)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("accuracy", ACCURACIES)
@pytest.mark.parametrize("name", SMALL_SHAPES)
def test_so_is_the_image_of_what_is_smaller_than_the_psf(name, accuracy, method):
    """Of a point or a line, whose power falls more slowly with |xi| than that of a surface."""
    check_accuracy(name, OPTICS, accuracy, method)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("accuracy", ACCURACIES)
def test_so_is_the_image_under_tilted_optics(accuracy, method):
    check_accuracy("large triangles", TILTED, accuracy, method)


BALLS = foam(np.array([[0, 0, -0.6], [0, 0, 0.6]]), np.array([0.9, 0.8]), 0.2)
SOLIDS = {
    "large triangles": Solid(SHAPES["large triangles"]),
    "flat walls": Solid(SHAPES["flat walls"]),
    "vesicle": Solid(SMALL_SHAPES["vesicle"]),
    "speck": Solid(SMALL_SHAPES["speck"]),
    "flake": Solid(box((0.0, 0.0, 0.0), (0.05, 2.0, 2.0), edge_length=0.2)),
    "slab": Solid(box((0.0, 0.0, 0.0), (0.2, 2.0, 2.0), edge_length=0.2)),
    "rod": Solid(box((0.0, 0.0, 0.0), (0.3, 0.3, 2.0), edge_length=0.2)),
    "two alike": Solid(BALLS),
    "two unlike": Solid(BALLS, {1: 1.0, 2: 0.3}),
    "two opposite": Solid(BALLS, {1: 1.0, 2: -0.8}),
}
PSFS = {
    "round": OPTICS,
    "tilted": TILTED,
    "narrow": nd.GaussianPSF(0.05),
    "widefield": nd.ScalarPSF(1.2, 0.5, 1.33),
}


# Of two balls, the closed form takes seconds through a PSF without one.
MANY_FACES = {  # or a PSF with many wavevectors: the exact image takes seconds
    "round": ("two alike",),
    "tilted": ("two alike", "two opposite"),
    "narrow": ("two alike", "two unlike", "two opposite"),
    "widefield": ("flake", "slab", "two alike", "two unlike", "two opposite"),
}
OF_INSIDES = [
    pytest.param(optics, name, marks=pytest.mark.slow)
    if name in MANY_FACES.get(optics, ())
    else (optics, name)
    for optics in PSFS
    for name in SOLIDS
]


@cache
def image_of_solid(name, optics, accuracy, method=None):
    renderer = Renderer(Scene((SOLIDS[name],), PSFS[optics]), GRID, accuracy, method=method)
    return renderer.rendered(), renderer.plan.expected_error


@pytest.mark.parametrize("method", [None, "particle-mesh"])
@pytest.mark.parametrize("accuracy", [1e-1, *ACCURACIES])
@pytest.mark.parametrize(("optics", "name"), OF_INSIDES)
def test_the_image_of_insides_is_as_accurate_as_asked(optics, name, accuracy, method):
    if optics == "widefield" and accuracy < 1e-4:
        pytest.skip("what a PSF of finite extent leaks beyond its support is left out")
    exact, _ = image_of_solid(name, optics, 0.0)
    image, expected = image_of_solid(name, optics, accuracy, method)
    error = float((image - exact).norm() / exact.norm())
    assert error <= expected <= accuracy


@pytest.mark.parametrize("accuracy", [1e-1, *ACCURACIES[:2]])
def test_nor_is_it_much_more_accurate_than_asked(accuracy):
    """A tenth of what was asked, in the median: what is better costs time for nothing."""
    found = []
    for name in SOLIDS:
        exact, _ = image_of_solid(name, "round", 0.0)
        image, _ = image_of_solid(name, "round", accuracy, "particle-mesh")
        found.append(float((image - exact).norm() / exact.norm()))
    assert np.median(found) > accuracy / 10


def test_accuracy_zero_is_the_closed_form_everywhere():
    mesh = SHAPES["large triangles"]
    for method in METHODS:
        plan = Renderer(Scene.of(mesh, OPTICS), GRID, 0, method=method).plan
        assert plan.method == "closed form"
        assert not plan.single
        assert plan.expected_error == 0
        z, y, x = plan.band.fft_shape
        assert plan.band.count == (2 * (z // 2) + 1) * (2 * (y // 2) + 1) * (x // 2 + 1)


def test_a_coarser_accuracy_never_costs_more():
    mesh = mesh_named("large triangles")
    plans = [Renderer(Scene.of(mesh, OPTICS), GRID, a).plan for a in (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)]
    seconds = [BUILT_IN.seconds(p.work, p.single) for p in plans]
    assert seconds == sorted(seconds, reverse=True)
    counts = [p.band.count for p in plans]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > 4 * counts[-1]


@pytest.mark.parametrize("accuracy", [-1e-3, 1.0, 2.0, float("nan"), float("inf")])
def test_accuracy_out_of_range(accuracy):
    mesh = SHAPES["large triangles"]
    with pytest.raises(nd.InputError, match="accuracy must be at least 0 and below 1"):
        make_plan(mesh.vertices, mesh.faces, (8, 8, 8), (1, 1, 1), (1, 1, 1), accuracy)


@pytest.mark.parametrize("accuracy", [0.99, 1e-8, 1e-12, 1e-15, 1e-300])
def test_accuracy_at_the_ends_of_its_range(accuracy):
    mesh = SHAPES["large triangles"]
    image = nd.render(mesh, GRID, OPTICS, accuracy=accuracy)
    exact = exact_image("large triangles", OPTICS)
    assert (image - exact).norm() < max(accuracy, 1e-12) * exact.norm()


def test_margin_makes_rules_finer():
    mesh = SHAPES["large triangles"]
    args = mesh.vertices, mesh.faces, (40, 40, 40), (0.1, 0.1, 0.1), (0.15, 0.15, 0.15), 1e-3
    plain, wide = (make_plan(*args, "particle-mesh", margin=m) for m in (1.0, 1.5))
    assert plain.points < wide.points


def test_band_error_and_threshold_are_inverse():
    for error in (0.3, 1e-2, 1e-5, 1e-9):
        for falloff in (POINT_LIKE, Falloff(2, 0.4), Falloff(2, 0.025), Falloff(4, 0.1)):
            threshold = threshold_for(error, falloff)
            found = band_error(threshold, falloff)
            assert found == pytest.approx(error, rel=1e-3) or (found < error and threshold == 0.5)


@pytest.mark.parametrize("order", [2, 4])
def test_band_error_is_an_integral_over_shells(order):
    falloff, k = Falloff(order, 0.3), np.linspace(0, 12, 400_001)
    power = k**2 * np.exp(-(k**2)) * falloff.of(k**2)
    for reach in (0.2, 1.5, 3.0):
        share = power[k >= reach].sum() / power.sum()
        assert band_error(np.exp(-(reach**2) / 2), falloff) == pytest.approx(share**0.5, rel=1e-3)


def test_the_power_of_a_solid_adds_up_to_its_volume():
    """Parseval: 4 pi times the integral of k^2 power is (2 pi)^3 V, whatever the shape."""
    for area, volume in ((4 * np.pi * 81, 4 / 3 * np.pi * 729), (2000.0, 5000.0)):
        turn = 4 * area / (3 * np.pi * volume)
        total = 4 * np.pi * (2 * np.pi * area / turn**4) * turn**3 * (1 / 3 + 1)
        assert total == pytest.approx((2 * np.pi) ** 3 * volume)
        assert turn <= of_solid(area, volume).turn <= 2**0.5 * turn


def test_a_solid_thinner_than_the_psf_is_seen_as_its_surface_is():
    area, volume = 1000.0, 400.0
    assert of_solid(area, volume) == of_surface(area, volume) == POINT_LIKE
    assert of_solid(area, 0.0) == POINT_LIKE


# ------------------------------------------------------------------------------------------ bands


@pytest.mark.parametrize("shape", [(20, 24, 18), (21, 15, 33), (4, 30, 6)])
def test_rows_cover_the_ellipsoid_and_no_more(shape):
    rng = np.random.default_rng(sum(shape))
    voxel = (0.3, 0.25, 0.2)
    for radius in rng.uniform(2.0, 14.0, (6, 3)):
        band = Band.within(shape, voxel, tuple(radius))
        inside = set()
        for k in product(*(range(-(n // 2), n // 2 + 1) for n in shape)):
            xi = [2 * np.pi * i / (n * d) for i, n, d in zip(k, shape, voxel, strict=True)]
            if k[2] >= 0 and sum((x / r) ** 2 for x, r in zip(xi, radius, strict=True)) <= 1:
                inside.add(k)
        listed = [(kz, ky, x) for kz, ky, n in band.rows.tolist() for x in range(n)]
        assert set(listed) == inside
        assert len(listed) == len(inside) == band.count


def test_to_box_puts_rows_where_their_wavevectors_are():
    band = Band.within((20, 24, 18), (0.3, 0.25, 0.2), (6.0, 8.0, 7.0))
    for axis in range(3):
        spacing = band.spacing[axis]
        k = band.rows[:, axis].repeat_interleave(band.rows[:, 2]).double()
        if axis == 2:
            k = torch.cat([torch.arange(n) for n in band.rows[:, 2].tolist()]).double()
        filled = band.to_box(k * spacing + 100)
        expected = band.axes()[axis].expand(band.box_shape) + 100
        inside = filled != 0
        assert inside.sum() == band.count
        assert_allclose(filled[inside], expected[inside], rtol=1e-14)


VOXEL = (0.3, 0.2, 0.25)


def a_few_triangles():
    v = torch.from_numpy(np.random.default_rng(0).uniform(0, 1, (6, 3)))
    return v, torch.tensor([[0, 1, 2], [3, 4, 5], [0, 2, 4]])


def full_band_image(shape):
    v, f = a_few_triangles()
    band = Band.full(shape, VOXEL)
    return band.to_image(
        band.to_box(band_ft(v, f, torch.ones(3), band.rows, band.spacing, False)), shape
    )


def numpy_image(shape, signs):
    """Real part of the full complex FFT; ``signs`` says which way a Nyquist index counts."""
    axes = []
    for n, d, sign in zip(shape, VOXEL, signs, strict=True):
        k = np.fft.fftfreq(n, d) * 2 * np.pi
        axes.append(np.where(2 * np.arange(n) == n, sign * np.abs(k), k))
    xi = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return np.fft.ifftn(nd.fourier.mesh_ft(*a_few_triangles(), xi).numpy().reshape(shape)).real


@pytest.mark.parametrize(
    "shape", [(7, 9, 5), (8, 7, 5), (7, 8, 5), (7, 7, 8), (1, 4, 5), (3, 2, 1)]
)
def test_full_band_is_the_real_part_of_the_full_fft(shape):
    expected = numpy_image(shape, (-1, -1, -1))
    assert_allclose(full_band_image(shape), expected, atol=1e-14 * np.abs(expected).max())


@pytest.mark.parametrize("shape", [(8, 8, 8), (8, 8, 5), (7, 8, 6), (8, 7, 6), (2, 2, 2)])
def test_where_two_axes_are_at_nyquist_every_sign_counts_alike(shape):
    """On an even axis +n/2 and -n/2 are one wavevector of the grid, and neither is preferred."""
    expected = np.mean([numpy_image(shape, s) for s in product((-1, 1), repeat=3)], axis=0)
    assert_allclose(full_band_image(shape), expected, atol=1e-14 * np.abs(expected).max())


@pytest.mark.parametrize("shape", [(8, 8, 8), (7, 9, 11), (8, 9, 10)])
@pytest.mark.parametrize("half", [None, (2, 3, 1)])
def test_to_image_and_its_adjoint(shape, half):
    band = Band(shape, VOXEL, half or tuple(n // 2 for n in shape))
    crop = (5, 6, 7)
    rng = np.random.default_rng(1)
    b = torch.from_numpy(rng.normal(size=(*band.box_shape, 2)).view(complex)[..., 0])
    b.requires_grad_()
    y = torch.from_numpy(rng.normal(size=crop))
    image = band.to_image(b, crop)
    (adjoint,) = torch.autograd.grad(image, b, y)
    assert image.shape == crop
    assert_allclose((adjoint.conj() * b).real.sum().item(), (image * y).sum().item(), rtol=1e-12)
    # A plain sum over the box: the weights are 1, but 2 where the mirror image is left out.
    k = [np.arange(-h, h + 1) for h in band.half[:2]] + [np.arange(band.half[2] + 1)]
    wave = [np.exp(2j * np.pi * np.outer(k[i], np.arange(crop[i])) / shape[i]) for i in range(3)]
    weight = [np.where(2 * np.abs(k[i]) == shape[i], 0.5, 1.0) for i in range(2)]
    weight.append(np.where((k[2] == 0) | (2 * k[2] == shape[2]), 1.0, 2.0))
    total = np.einsum("abc,a,b,c,az,by,cx->zyx", b.detach().numpy(), *weight, *wave, optimize=True)
    assert_allclose(image.detach(), total.real / np.prod(shape), atol=1e-14)


# -------------------------------------------------------------------------------- quadrature rules


@pytest.mark.parametrize("divisions", [1, 2, 5])
@pytest.mark.parametrize("degree", DEGREES)
def test_rules_are_exact_to_their_degree(degree, divisions):
    r = rule(degree, divisions)
    assert r.weights.sum() == pytest.approx(1, abs=1e-14)
    assert_allclose(r.barycentric.sum(1), 1, atol=1e-14)
    assert (r.barycentric > 0).all()
    assert (r.weights > 0).all()
    worst = {}
    for a, b, c in product(range(degree + 2), repeat=3):
        exact = 2 * factorial(a) * factorial(b) * factorial(c) / factorial(a + b + c + 2)
        found = r.weights @ np.prod(r.barycentric ** np.array([a, b, c]), axis=1)
        n = a + b + c
        worst[n] = max(worst.get(n, 0), abs(found - exact))
    assert max(e for n, e in worst.items() if n <= degree) < 1e-15
    if divisions == 1:
        assert worst[degree + 1] > 1e-8  # and no further: the degree is what it says


def test_rules_cover_every_face_once_and_divide_large_ones():
    reach = np.array([0.0, 0.1, 1.0, 3.0, 10.0, 100.0, 0.5, 300.0])
    groups = choose_rules(reach, 1e-3, 1e-4)
    faces = np.concatenate([where for _, where in groups])
    assert sorted(faces) == list(range(len(reach)))
    points = np.zeros(len(reach))
    for r, where in groups:
        points[where] = len(r.weights)
    assert (np.diff(points[np.argsort(reach)]) >= 0).all()
    # A face ten times longer needs a hundred times the points.
    assert points[7] / points[5] == pytest.approx(9, rel=0.2)
    assert choose_rules(np.zeros(0), 1e-3, 1e-4) == []


def test_a_triangle_without_area_is_planned_as_a_speck():
    flat = nd.Mesh([[0, 0, 0], [0, 0, 0.5], [0, 0, 1]], [[0, 1, 2]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert float(nd.render(flat, GRID, OPTICS).abs().sum()) == 0
