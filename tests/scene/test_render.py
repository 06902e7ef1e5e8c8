"""Rendered images against a direct evaluation in space."""

import numpy as np
import pytest
import torch
from benchmarks.shapes import box
from numpy.testing import assert_allclose
from scipy.special import erf

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.fourier.quadrature import rule
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.scene import Renderer, Scene

SIGMA = (0.3, 0.22, 0.25)
GRID = nd.Grid((20, 27, 24), (0.2, 0.11, 0.13), origin=(-2.1, 3.0, 10.0))
CENTRE = np.array([-0.2, 4.4, 11.5])
BALL = sphere(CENTRE, (0.6, 0.5, 0.7), subdivisions=1)
METHODS = ("closed form", "particle-mesh")
EFFECT = {True: ("pixel_integration",), False: ()}


def spatial_image(mesh, grid, sigma, density=None, integrate=False):
    """Sum of Gaussians in space at dense points of the faces; no Fourier transform anywhere."""
    r = rule(6, 2)  # parts shorter than half a sigma: exact to 1e-7
    corners = mesh.vertices_numpy()[mesh.faces]
    points = np.einsum("qp,fpi->fqi", r.barycentric, corners).reshape(-1, 3)
    mass = mesh.areas() * mesh.membranes() * (1 if density is None else density)
    profiles = []
    for axis in range(3):
        d, s = grid.voxel_size[axis], sigma[axis]
        x = grid.origin[axis] + d * np.arange(grid.shape[axis])
        t = (x[:, None] - points[None, :, axis]) / s
        if integrate:  # over the voxel
            h = d / s / 2
            profiles.append((erf((t + h) / np.sqrt(2)) - erf((t - h) / np.sqrt(2))) / 2)
        else:
            profiles.append(d * np.exp(-(t**2) / 2) / np.sqrt(2 * np.pi) / s)
    weights = (mass[:, None] * r.weights).reshape(-1)
    zy = profiles[0][:, None, :] * profiles[1][None] * weights
    return np.einsum("zyp,xp->zyx", zy, profiles[2], optimize=True)


def relative_error(image, exact):
    return np.linalg.norm(image.detach().numpy() - exact) / np.linalg.norm(exact)


# --------------------------------------------------------------------------------------- the image


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("accuracy", [1e-2, 1e-4])
def test_image_is_what_a_sum_in_space_gives(accuracy, method):
    exact = spatial_image(BALL, GRID, SIGMA)
    image = nd.render(BALL, GRID, nd.GaussianPSF(SIGMA), accuracy=accuracy, method=method)
    assert image.shape == GRID.shape
    assert relative_error(image, exact) < accuracy


def test_accuracy_zero_is_limited_by_sampling_alone():
    """OTF at the edge of the grid: below 1e-4, so that is what the FFT of the grid leaves out."""
    exact = spatial_image(BALL, GRID, SIGMA)
    assert relative_error(nd.render(BALL, GRID, nd.GaussianPSF(SIGMA), accuracy=0), exact) < 1e-5


def test_tilted_optics():
    """A tilted Gaussian is a plain one in other coordinates; compare along its own axes."""
    covariance = np.array([[0.09, 0.04, 0.0], [0.04, 0.06, 0.0], [0.0, 0.0, 0.07]])
    point = sphere(CENTRE, 1e-4, subdivisions=0)
    image = nd.render(point, GRID, nd.GaussianPSF(covariance=covariance), accuracy=0).numpy()
    axes = [
        o + d * np.arange(n)
        for o, d, n in zip(GRID.origin, GRID.voxel_size, GRID.shape, strict=True)
    ]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), -1) - CENTRE
    power = np.einsum("...i,ij,...j", x, np.linalg.inv(covariance), x)
    gauss = np.exp(-power / 2) / np.sqrt((2 * np.pi) ** 3 * np.linalg.det(covariance))
    expected = gauss * np.prod(GRID.voxel_size) * point.areas().sum()
    assert_allclose(image, expected, atol=2e-3 * expected.max())


@pytest.mark.parametrize("method", METHODS)
def test_sum_is_the_area(method):
    wide = nd.Grid((44, 62, 58), GRID.voxel_size, origin=(-4.5, 1.0, 7.7))
    image = nd.render(BALL, wide, nd.GaussianPSF(SIGMA), accuracy=1e-4, method=method)
    assert image.sum().item() == pytest.approx(BALL.areas().sum(), rel=1e-4)


@pytest.mark.parametrize(
    "shape", [(20, 27, 24), (21, 26, 25), (20, 26, 24), (21, 27, 25), (1, 27, 24), (20, 27, 2)]
)
def test_odd_and_even_shapes_see_the_same(shape):
    first = CENTRE - np.array(shape) // 2 * GRID.voxel_size
    grid = nd.Grid(shape, GRID.voxel_size, tuple(first))
    image = nd.render(BALL, grid, nd.GaussianPSF(SIGMA), accuracy=1e-4)
    assert relative_error(image, spatial_image(BALL, grid, SIGMA)) < 2e-4


@pytest.mark.parametrize("integrate", [False, True])
def test_coarse_voxels(integrate):
    """Where voxels are as large as the PSF, integrating over them differs from sampling."""
    grid = nd.Grid((14, 16, 15), (0.3, 0.25, 0.28), origin=(-2.1, 2.6, 9.6))
    image = nd.render(BALL, grid, nd.GaussianPSF(SIGMA), accuracy=1e-3, effects=EFFECT[integrate])
    exact, other = (
        spatial_image(BALL, grid, SIGMA, integrate=i) for i in (integrate, not integrate)
    )
    assert relative_error(image, exact) < 3e-3
    assert relative_error(image, other) > 2e-2


def test_pixel_integration_is_the_mean_over_a_voxel():
    """Against a grid five times as fine, averaged: the midpoint rule."""
    grid = nd.Grid((8, 9, 10), (0.3, 0.3, 0.3), origin=(-1.4, 3.2, 10.1))
    n = 5
    fine = nd.Grid(
        tuple(n * k for k in grid.shape),
        tuple(d / n for d in grid.voxel_size),
        tuple(o - d / 2 + d / n / 2 for o, d in zip(grid.origin, grid.voxel_size, strict=True)),
    )
    optics = nd.GaussianPSF(0.4)
    image, sampled = (
        nd.render(BALL, grid, optics, accuracy=1e-4, effects=EFFECT[i]) for i in (True, False)
    )
    many = nd.render(BALL, fine, optics, accuracy=1e-4)
    z, y, x = grid.shape
    mean = many.reshape(z, n, y, n, x, n).sum((1, 3, 5))
    assert relative_error(image, mean.numpy()) < 3e-3
    assert relative_error(sampled, mean.numpy()) > 1e-2


# ------------------------------------------------------------------------------------- the borders


@pytest.mark.parametrize("accuracy", [1e-2, 1e-4])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("beyond", [-0.4, 0.0, 0.9])
def test_nothing_enters_at_the_other_side(axis, side, beyond, accuracy):
    """A mesh inside the border, across it, and outside: its middle is ``beyond`` um past it."""
    first, last = GRID.extent
    middle = (first + last) / 2
    middle[axis] = (first, last)[side][axis] + (beyond if side else -beyond)
    mesh = BALL.translated(middle - CENTRE)
    image = nd.render(mesh, GRID, nd.GaussianPSF(SIGMA), accuracy=accuracy)
    exact = spatial_image(mesh, GRID, SIGMA)
    # What the whole structure would show, not only the part that is seen, sets the scale.
    scale = np.linalg.norm(spatial_image(BALL, GRID, SIGMA))
    assert np.linalg.norm(image.numpy() - exact) < accuracy * scale
    far = image.movedim(axis, 0)[:3] if side else image.movedim(axis, 0)[-3:]
    assert far.abs().max() < accuracy * spatial_image(BALL, GRID, SIGMA).max()


def test_a_mesh_far_outside_is_not_seen():
    optics = nd.GaussianPSF(SIGMA)
    peak = spatial_image(BALL, GRID, SIGMA).max()
    for offset in ([6.0, 0, 0], [0, -7.0, 0], [0, 0, 8.0], [5.0, 5.0, -5.0]):
        image = nd.render(BALL.translated(offset), GRID, optics, accuracy=1e-3)
        assert image.abs().max() < 1e-3 * peak


def test_a_mesh_in_other_units_is_refused():
    """A vertex that flew off, a file in other units: a period that holds it fills any memory."""
    with pytest.raises(InputError, match="are the units the same"):
        Renderer(Scene.of(BALL.translated([1e3, 1e3, 1e3]), nd.GaussianPSF(SIGMA)), GRID, 1e-3)


def test_the_plan_is_moved_with_a_mesh_that_moves_within_the_margin():
    optics = nd.GaussianPSF(SIGMA)
    renderer = Renderer(Scene.of(BALL, optics), GRID, 1e-3, margin=0.3)
    for shift in ([0.29, -0.29, 0.29], [-0.29, 0.29, 0.29]):
        mesh = BALL.translated(shift)
        u = renderer.transform(torch.from_numpy(mesh.vertices))
        image = renderer.image(u, renderer.otf(optics))
        assert relative_error(image, spatial_image(mesh, GRID, SIGMA)) < 1e-3


# --------------------------------------------------------------------------------- what is rendered


def test_a_wall_counts_twice():
    optics = nd.GaussianPSF(SIGMA)
    face = BALL.vertices[BALL.faces[0]]
    single, wall = (Mesh(face, [[0, 1, 2]], [r]) for r in ((1, 0), (1, 2)))
    one, two = (nd.render(m, GRID, optics) for m in (single, wall))
    assert_allclose(two, 2 * one, rtol=1e-6, atol=1e-12)
    assert one.max() > 0


def test_density_multiplies_membranes():
    rng = np.random.default_rng(0)
    density = rng.uniform(0.2, 3, len(BALL.faces))
    regions = np.where(np.arange(len(BALL.faces))[:, None] < 30, [1, 2], [1, 0])
    mesh = Mesh(BALL.vertices, BALL.faces, regions)
    image = nd.render(mesh, GRID, nd.GaussianPSF(SIGMA), accuracy=1e-4, density=density)
    assert relative_error(image, spatial_image(mesh, GRID, SIGMA, density)) < 1e-4


def test_further_blur_adds_in_squares():
    blur = (0.1, 0.2, 0.15)
    renderer = Renderer(Scene.of(BALL, nd.GaussianPSF(SIGMA)), GRID, 1e-4, blur=blur)
    u = renderer.transform(torch.from_numpy(BALL.vertices))
    image = renderer.image(u, renderer.otf(nd.GaussianPSF(SIGMA)))
    assert relative_error(image, spatial_image(BALL, GRID, np.hypot(SIGMA, blur))) < 1e-4


# -------------------------------------------------------------------------------------- gradients


@pytest.mark.parametrize("method", METHODS)
def test_gradients_in_vertices_and_sigma(method):
    """Along random directions, against central differences of the image computed in space."""
    rng = np.random.default_rng(3)
    target = torch.from_numpy(rng.normal(size=GRID.shape))
    v = torch.tensor(BALL.vertices, requires_grad=True)
    sigma = torch.tensor(SIGMA, dtype=torch.float64, requires_grad=True)
    image = nd.render(
        BALL.with_vertices(v), GRID, nd.GaussianPSF(sigma), accuracy=1e-5, method=method
    )
    by_v, by_sigma = torch.autograd.grad((image * target).sum(), (v, sigma))

    def value(vertices, sigma):
        return (spatial_image(Mesh(vertices, BALL.faces), GRID, sigma) * target.numpy()).sum()

    h = 1e-4
    for _ in range(3):
        dv, ds = rng.normal(size=BALL.vertices.shape), rng.normal(size=3)
        slope = value(BALL.vertices + h * dv, SIGMA) - value(BALL.vertices - h * dv, SIGMA)
        assert (by_v.numpy() * dv).sum() == pytest.approx(slope / (2 * h), rel=2e-3)
        slope = value(BALL.vertices, SIGMA + h * ds) - value(BALL.vertices, SIGMA - h * ds)
        assert (by_sigma.numpy() * ds).sum() == pytest.approx(slope / (2 * h), rel=2e-3)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("accuracy", [0, 1e-5, 1e-3, 0.1, 0.7])
def test_every_plan_has_a_gradient(accuracy, method):
    speck = sphere(CENTRE, 0.1, subdivisions=0)
    v = torch.tensor(speck.vertices, requires_grad=True)
    image = nd.render(
        speck.with_vertices(v), GRID, nd.GaussianPSF(0.5), accuracy=accuracy, method=method
    )
    (gradient,) = torch.autograd.grad((image * torch.linspace(0, 1, GRID.shape[2])).sum(), v)
    assert torch.isfinite(gradient).all()
    assert gradient.any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradient_has_the_type_of_the_vertices(dtype):
    v = torch.tensor(BALL.vertices, dtype=dtype, requires_grad=True)
    for method in METHODS:
        image = nd.render(BALL.with_vertices(v), GRID, nd.GaussianPSF(SIGMA), method=method)
        (gradient,) = torch.autograd.grad(image.square().sum(), v)
        assert gradient.dtype == dtype


# ------------------------------------------------------------------------------ types and bad input


@pytest.mark.parametrize(
    ("accuracy", "dtype"),
    [
        (0, torch.float64),
        (1e-6, torch.float64),
        (2.9e-5, torch.float64),
        (3e-5, torch.float32),
        (0.1, torch.float32),
    ],
)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("vertices", [torch.float32, torch.float64])
def test_type_of_the_image(accuracy, dtype, method, vertices):
    mesh = BALL.with_vertices(torch.tensor(BALL.vertices, dtype=vertices))
    image = nd.render(mesh, GRID, nd.GaussianPSF(SIGMA), accuracy=accuracy, method=method)
    assert image.dtype == dtype


@pytest.mark.parametrize("accuracy", [-1e-9, 1, 3.0, float("nan")])
def test_accuracy_out_of_range(accuracy):
    with pytest.raises(nd.InputError, match="accuracy must be at least 0 and below 1"):
        nd.render(BALL, GRID, nd.GaussianPSF(SIGMA), accuracy=accuracy)


@pytest.mark.parametrize("density", [np.ones(3), np.ones((80, 1)), np.ones((1, 80))])
def test_density_of_the_wrong_shape(density):
    with pytest.raises(nd.InputError, match="density"):
        nd.render(BALL, GRID, nd.GaussianPSF(SIGMA), density=density)


def test_unknown_method():
    with pytest.raises(nd.InputError, match="method"):
        nd.render(BALL, GRID, nd.GaussianPSF(SIGMA), method="fast")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((2, 3), (1, 1, 1)), "three positive numbers"),
        (((2, 0, 3), (1, 1, 1)), "three positive numbers"),
        ((5, (1, 1, 1)), "three positive numbers"),
        (((2, 2.5, 3), (1, 1, 1)), "three positive numbers"),
        (((2, 2, 3), (1, 0, 1)), "voxel size must be three positive"),
        (((2, 2, 3), (1, -1, 1)), "voxel size must be three positive"),
        (((2, 2, 3), (1, 1)), "voxel size must be three positive"),
        (((2, 2, 3), (1, float("nan"), 1)), "voxel size must be three positive"),
        (((2, 2, 3), 1.0), "voxel size and origin take three numbers"),
        (((2, 2, 3), (1, "a", 1)), "voxel size"),
        (((2, 2, 3), (1, 1, 1), (0, 0)), "origin must be three finite"),
        (((2, 2, 3), (1, 1, 1), (0, float("inf"), 0)), "origin must be three finite"),
    ],
)
def test_grid_refuses(arguments, message):
    with pytest.raises(nd.InputError, match=message):
        nd.Grid(*arguments)


def test_grid_extent_and_strides():
    first, last = GRID.extent
    assert_allclose(first, GRID.origin)
    assert_allclose(last, [-2.1 + 19 * 0.2, 3.0 + 26 * 0.11, 10 + 23 * 0.13])
    coarse = GRID.strided((2, 3, 1))
    assert coarse.shape == (10, 9, 24)
    assert_allclose(coarse.voxel_size, (0.4, 0.33, 0.13))
    image = nd.render(BALL, GRID, nd.GaussianPSF(0.5), accuracy=1e-5)[::2, ::3]
    wide = nd.render(BALL, coarse, nd.GaussianPSF(0.5), accuracy=1e-5)
    assert_allclose(wide / 6, image, atol=1e-3 * image.max())


def test_a_box_fills_its_place():
    """Z, Y, X are told apart: walls of a box lie where they should."""
    centre = np.array([-0.2, 4.4, 11.5])
    mesh = box(centre, (1.0, 0.6, 1.4))
    grid = nd.Grid((50, 60, 60), (0.05, 0.05, 0.05), centre - 0.05 * np.array([25, 30, 30]))
    image = nd.render(mesh, grid, nd.GaussianPSF(0.06)).numpy()
    for axis, half in enumerate((0.5, 0.3, 0.7)):
        line = image.sum(tuple(a for a in range(3) if a != axis))
        peaks = np.sort(np.argsort(line)[-2:])
        assert_allclose((peaks - grid.shape[axis] // 2) * 0.05, [-half, half], atol=0.051)
