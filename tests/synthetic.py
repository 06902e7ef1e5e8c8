"""A small image of a sphere, and a fit of it: what the tests of the fit share."""

import numpy as np

from napari_deltamic import GaussianPSF, Grid, fit, render
from napari_deltamic.geometry import sphere
from napari_deltamic.measure import surface_distance
from napari_deltamic.runs.settings import FitSettings

VOXEL = 0.1
GRID = Grid((24, 32, 32), (VOXEL, VOXEL, VOXEL))
OPTICS = GaussianPSF(0.13)
CENTER, RADIUS = (1.15, 1.55, 1.55), 0.75
TRUTH = sphere(CENTER, RADIUS, subdivisions=5)
SHORT = FitSettings(levels=(1.0,), max_iterations=12)


def measured(grid=GRID, mesh=TRUTH, optics=OPTICS, density=None, noise=None):
    """Image with a peak of 40 photons over a background of 2; noise: the seed of Poisson noise."""
    image = render(mesh, grid, optics, 1e-4, density=density).numpy().astype(np.float64)
    image = 2 + 40 * image.clip(0) / image.max()
    return image if noise is None else np.random.default_rng(noise).poisson(image)


def start(subdivisions=3):
    """A sphere too small by a quarter and shifted by a voxel along two axes."""
    z, y, x = CENTER
    return sphere((z, y - VOXEL, x + VOXEL), 0.75 * RADIUS, subdivisions=subdivisions)


def fitted(image, mesh=None, grid=GRID, optics=OPTICS, **options):
    """The last state."""
    *_, last = fit(image, grid, start() if mesh is None else mesh, optics, **options)
    return last


def apart(mesh, other=TRUTH):
    """Mean distance of two surfaces, both ways, in voxels."""
    return surface_distance(mesh, other, 4000).mean / VOXEL
