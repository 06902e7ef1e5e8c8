"""Every derivative of the engine against finite differences, by torch's own check in float64."""

import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

import napari_deltamic as nd
from napari_deltamic.fitting.model.likelihood import match
from napari_deltamic.geometry import Mesh
from napari_deltamic.scene import Renderer, Scene

VOXEL = (0.31, 0.2, 0.24)  # anisotropic
SHAPES = [(5, 6, 7), (6, 5, 4), (4, 4, 4), (5, 5, 5), (1, 6, 5)]  # odd and even along each axis
METHODS = [
    ("closed form", 0.0),
    pytest.param("closed form", 1e-8, marks=pytest.mark.slow),
    ("particle-mesh", 1e-10),
]
TILTED = [[0.09, 0.02, 0.01], [0.02, 0.07, -0.01], [0.01, -0.01, 0.08]]
SIGMA = (0.33, 0.24, 0.27)


def scene(shape):
    """A tetrahedron in the middle of a grid, and densities."""
    grid = nd.Grid(shape, VOXEL, origin=(-0.4, 2.0, 0.3))
    first, last = grid.extent
    corners = np.array([[0.5, 0.4, 0.3], [-0.4, 0.5, -0.1], [0.1, -0.5, 0.4], [-0.1, 0.0, -0.6]])
    vertices = (first + last) / 2 + 0.7 * corners
    mesh = Mesh(vertices, [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    v = torch.tensor(vertices, requires_grad=True)
    rho = torch.tensor([0.7, 1.3, 1.0, 2.1], dtype=torch.float64, requires_grad=True)
    return mesh, grid, v, rho


@pytest.mark.parametrize(("method", "accuracy"), METHODS)
@pytest.mark.parametrize("shape", SHAPES)
def test_image(shape, method, accuracy):
    """Every voxel in every vertex, density and width of the PSF."""
    mesh, grid, v, rho = scene(shape)
    sigma = torch.tensor(SIGMA, dtype=torch.float64, requires_grad=True)
    # The plan is made once: where it changes, the image changes by what the accuracy leaves out.
    renderer = Renderer(Scene.of(mesh, nd.GaussianPSF(SIGMA)), grid, accuracy, method=method)

    def image(v, rho, sigma):
        return renderer.image(renderer.transform(v, rho), renderer.otf(nd.GaussianPSF(sigma)))

    # Voxel by voxel where that is quick; else along a random direction through all of them.
    assert gradcheck(image, (v, rho, sigma), atol=1e-7, fast_mode=method == "particle-mesh")


@pytest.mark.parametrize("integrate", [False, True])
def test_public_render(integrate):
    mesh, grid, v, rho = scene((5, 6, 7))

    def image(v, rho):
        optics = nd.GaussianPSF(SIGMA)
        effects = ("pixel_integration",) if integrate else ()
        return nd.render(mesh.with_vertices(v), grid, optics, 0, density=rho, effects=effects)

    assert gradcheck(image, (v, rho), atol=1e-7)


@pytest.mark.slow
def test_tilted_psf():
    mesh, grid, v, _ = scene((5, 6, 7))
    optics = nd.GaussianPSF(covariance=TILTED)
    p = optics.parameters().clone().requires_grad_()
    renderer = Renderer(Scene.of(mesh, optics), grid, 0)

    def image(v, p):
        return renderer.image(renderer.transform(v), renderer.otf(optics.with_parameters(p)))

    assert gradcheck(image, (v, p), atol=1e-7)


@pytest.mark.parametrize(("method", "accuracy"), METHODS)
def test_loss(method, accuracy):
    """With amplitude and background solved for: their own derivatives vanish at the optimum."""
    mesh, grid, v, rho = scene((6, 7, 8))
    sigma = torch.tensor(SIGMA, dtype=torch.float64, requires_grad=True)
    renderer = Renderer(Scene.of(mesh, nd.GaussianPSF(SIGMA)), grid, accuracy, method=method)
    start = renderer.image(renderer.transform(v.detach()), renderer.otf(nd.GaussianPSF(SIGMA)))
    rng = np.random.default_rng(0)
    noise = torch.from_numpy(rng.normal(size=grid.shape)) * start.std()
    measured = (2 + 30 * (start + noise)).reshape(-1)
    weights = torch.from_numpy(rng.uniform(0.2, 1, measured.shape))

    def loss(v, rho, sigma):
        image = renderer.image(renderer.transform(v, rho), renderer.otf(nd.GaussianPSF(sigma)))
        squares, found = match(image.reshape(-1), measured, weights)
        assert not found.bounded
        return squares

    assert gradcheck(loss, (v, rho, sigma), atol=1e-7)
