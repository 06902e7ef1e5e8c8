"""Errors of rendered images and their gradients by the particle-mesh, on scenes that strain it.

Against the closed form in double precision at every wavevector, which is checked on its own. The
error of an image is the relative L2 error that ``accuracy`` bounds; that of a gradient, of the
inner product of the image with a smooth random one, is its L2 error over all vertices relative to
its L2 norm.
"""

from functools import cache

import numpy as np
import torch
from benchmarks.shapes import box, scaled
from scipy.ndimage import gaussian_filter

import napari_deltamic as nd
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.scene import Renderer, Scene

GRID = nd.Grid((24, 26, 25), (0.1, 0.1, 0.1))
LONG = nd.Grid((20, 20, 450), (0.1, 0.1, 0.1))
CENTRE = (1.15, 1.25, 1.2)
OPTICS = nd.GaussianPSF((0.22, 0.2, 0.21))  # hardly anything beyond what the grid holds
ACCURACIES = (1e-2, 1e-3, 1e-4, 1e-6)


def _split(mesh):
    """Every face with vertices of its own: each place is held by several."""
    v = mesh.vertices_numpy()[mesh.faces].reshape(-1, 3)
    return Mesh(v, np.arange(len(v)).reshape(-1, 3))


def _slivers(aspect):
    """A ribbon round a cylinder, cut into needles of this aspect."""
    n, height = 24, 1.0
    angle = 2 * np.pi * np.arange(n) / n
    round_ = np.stack([0 * angle, 0.6 * np.cos(angle), 0.6 * np.sin(angle)], 1)
    thin = height / aspect
    rings = [round_ + np.array([z, 0, 0]) for z in (0.0, thin, height / 2, height - thin, height)]
    v = np.concatenate(rings) + np.array(CENTRE) - [height / 2, 0, 0]
    i, j = np.arange(n), (np.arange(n) + 1) % n
    faces = []
    for ring in range(4):
        a, b = ring * n, (ring + 1) * n
        faces += [np.stack([a + i, a + j, b + i], 1), np.stack([b + i, a + j, b + j], 1)]
    return Mesh(v, np.concatenate(faces))


def _with_empty_faces(mesh):
    v, f = mesh.vertices_numpy(), mesh.faces
    middle = (v[f[0, 0]] + v[f[0, 1]]) / 2
    n = len(v)
    extra = [[f[0, 0], n, f[0, 1]], [f[1, 0], f[1, 0], f[1, 1]], [n, n, n]]
    return Mesh(np.vstack([v, middle]), np.vstack([f, extra]))


@cache
def scenes():
    """Name -> (mesh, grid, optics)."""
    ball = sphere(CENTRE, (0.6, 0.7, 0.65), subdivisions=1)
    tall = np.array([[1.0, 0.9, 1.0], [0.9, 1.1, 41.0], [1.1, 0.8, 40.0], [0.8, 1.0, 2.0]])
    shift = np.array([1e6, -1e6, 1e6])
    far = nd.Grid(GRID.shape, GRID.voxel_size, tuple(shift))
    out = {
        "sphere": (ball, GRID, OPTICS),
        "box along the axes": (box(CENTRE, (0.8, 1.0, 1.2)), GRID, OPTICS),
        "edges of 1000 rad": (Mesh(tall, [[0, 2, 1], [0, 3, 2]]), LONG, OPTICS),
        "slivers of aspect 1e2": (_slivers(1e2), GRID, OPTICS),
        "slivers of aspect 1e6": (_slivers(1e6), GRID, OPTICS),
        "faces of no area": (_with_empty_faces(ball), GRID, OPTICS),
        "duplicate vertices": (_split(ball), GRID, OPTICS),
        "far from the origin": (ball.translated(shift), far, OPTICS),
        "a speck": (sphere(CENTRE, 1e-4, subdivisions=0), GRID, OPTICS),
        "PSF far below a voxel": (ball, GRID, nd.GaussianPSF((0.22, 0.001, 0.21))),
    }
    for name, unit in (("nm", 1e3), ("m", 1e-6)):
        grid = nd.Grid(GRID.shape, tuple(unit * d for d in GRID.voxel_size))
        sigma = tuple(unit * s for s in OPTICS.sigma_um)
        out[f"units of {name}"] = (scaled(ball, unit), grid, nd.GaussianPSF(sigma))
    return out


def _target(grid):
    rng = np.random.default_rng(5)
    smooth = gaussian_filter(rng.normal(size=grid.shape), 1.5)
    return torch.from_numpy(smooth / np.abs(smooth).max())


def image_and_gradient(mesh, grid, optics, accuracy, method, device="cpu"):
    """The image and the vertex gradient of its inner product with a smooth random image."""
    v = torch.tensor(mesh.vertices_numpy(), device=device, requires_grad=True)
    renderer = Renderer(Scene.of(mesh, optics), grid, accuracy, method=method, device=device)
    image = renderer.image(renderer.transform(v), renderer.otf(optics)).to(torch.float64)
    (gradient,) = torch.autograd.grad((image * _target(grid).to(device)).sum(), v)
    return image.detach().cpu(), gradient.cpu()


@cache
def _exact(name):
    return image_and_gradient(*scenes()[name], 0, None)


@cache
def scene_errors(name, accuracy, method="particle-mesh", device="cpu"):
    """Relative errors of the image and of its gradient."""
    exact = _exact(name)
    ours = image_and_gradient(*scenes()[name], accuracy, method, device)
    return tuple(float((a - b).norm() / b.norm()) for a, b in zip(ours, exact, strict=True))
