"""Sample data, simulated on demand: an image with noise, and its true surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh, mesh_from_labels, sphere
from ..optics import GaussianPSF
from . import Grid, render

LayerData = tuple[Any, dict[str, Any], str]
_PHOTONS, _BACKGROUND = 60.0, 20.0  # counts in the brightest voxels, and everywhere


@dataclass(frozen=True)
class Sample:
    """A microscope image of known surfaces.

    image : (Z, Y, X) float32 counts.
    grid, optics : of the image.
    truth : the surfaces, um.
    centers : (n, 3) um, Z, Y, X, a point inside each cell.
    """

    name: str
    image: NDArray[np.float32]
    grid: Grid
    optics: GaussianPSF
    truth: Mesh
    centers: NDArray[np.float64]


def vesicle_sample() -> Sample:
    """Make an oval vesicle."""
    grid = Grid((40, 56, 56), (0.3, 0.2, 0.2))
    center = np.array([5.9, 5.5, 5.4])
    truth = sphere(center, (3.4, 3.0, 3.9), edge_length=0.35)
    return _sample("vesicle", truth, grid, (0.42, 0.24, 0.24), [center])


def two_cell_sample() -> Sample:
    """Make two cells that lie close to each other."""
    grid = Grid((40, 56, 80), (0.3, 0.2, 0.2))
    left, right = np.array([5.8, 5.4, 4.4]), np.array([6.0, 5.7, 11.4])
    cells = [
        sphere(left, (3.4, 3.4, 3.0), edge_length=0.4),
        sphere(right, (3.6, 3.2, 3.3), edge_length=0.4),
    ]
    return _sample("two cells", Mesh.merge(cells), grid, (0.42, 0.24, 0.24), [left, right])


def dividing_cell_sample() -> Sample:
    """Make a cell with a furrow, shortly before it divides."""
    grid = Grid((56, 80, 80), (0.22, 0.16, 0.16))
    center = 0.5 * (np.asarray(grid.shape) - 1) * grid.voxel_size
    truth = _furrowed(center)
    return _sample("dividing cell", truth, grid, (0.36, 0.2, 0.2), [center])


def foam_sample() -> Sample:
    """Make eight cells that share walls, like a young embryo."""
    grid = Grid((52, 76, 84), (0.3, 0.2, 0.2))
    center = 0.5 * (np.asarray(grid.shape) - 1) * grid.voxel_size
    points = _spread(8, (4.3, 4.3, 5.1)) + center
    step = (0.2, 0.2, 0.2)
    axes = [np.arange(0, 2 * c, d) for c, d in zip(center, step, strict=True)]
    z, y, x = np.meshgrid(*axes, indexing="ij", sparse=True)
    # A place belongs to the nearest point, if that is near: walls are flat, the outside is round.
    squared = np.array([(z - p[0]) ** 2 + (y - p[1]) ** 2 + (x - p[2]) ** 2 for p in points])
    labels = np.where(squared.min(axis=0) < 3.6**2, squared.argmin(axis=0) + 1, 0)
    truth = mesh_from_labels(labels, step, edge_length=0.45, shared_walls=False)
    centers = [truth.region_surface(k).vertices_numpy().mean(axis=0) for k in range(1, 9)]
    return _sample("foam of 8 cells", truth, grid, (0.42, 0.24, 0.24), centers)


def vesicle() -> list[LayerData]:
    """Return the vesicle as layers for napari."""
    return _layers(vesicle_sample())


def two_cells() -> list[LayerData]:
    """Return the two cells as layers for napari."""
    return _layers(two_cell_sample())


def dividing_cell() -> list[LayerData]:
    """Return the dividing cell as layers for napari."""
    return _layers(dividing_cell_sample())


def foam() -> list[LayerData]:
    """Return the foam as layers for napari."""
    return _layers(foam_sample())


def _layers(sample: Sample) -> list[LayerData]:
    options = {
        "name": sample.name,
        "scale": sample.grid.voxel_size,
        "units": ("um",) * 3,
        "axis_labels": ("z", "y", "x"),
    }
    return [(sample.image, options, "image")]


def _sample(
    name: str,
    truth: Mesh,
    grid: Grid,
    sigma: Sequence[float],
    centers: Sequence[NDArray[np.float64]],
) -> Sample:
    """Render a sample and add the noise of counted photons."""
    optics = GaussianPSF(sigma)
    clean = np.clip(render(truth, grid, optics).numpy(), 0, None)
    expected = _BACKGROUND + _PHOTONS * clean / np.percentile(clean, 99.5)
    image = np.random.default_rng(1).poisson(expected).astype(np.float32)
    return Sample(name, image, grid, optics, truth, np.array(centers))


def _spread(n: int, radii: Sequence[float]) -> NDArray[np.float64]:
    """Spread points evenly in an ellipsoid: each is the centroid of the places nearest to it."""
    rng = np.random.default_rng(4)
    cloud = rng.uniform(-1, 1, (8000, 3))
    cloud = cloud[(cloud**2).sum(axis=1) < 1] * radii
    points = cloud[:n]
    for _ in range(30):
        nearest = ((cloud[:, None] - points) ** 2).sum(axis=2).argmin(axis=1)
        points = np.array([cloud[nearest == k].mean(axis=0) for k in range(n)])
    return points


def _furrowed(center: NDArray[np.float64]) -> Mesh:
    """Make an ellipsoid with a furrow around its long axis, which is turned from X towards Y."""
    length, radius, turn = 4.6, 3.1, radians(25)
    ball = sphere((0, 0, 0), (radius, radius, length), edge_length=0.3)
    zyx = ball.vertices_numpy()
    waist = 1 - 0.38 * np.exp(-((zyx[:, 2] / (0.35 * length)) ** 2))
    z, y, x = zyx[:, 0] * waist, zyx[:, 1] * waist, zyx[:, 2]
    c, s = cos(turn), sin(turn)
    turned = np.stack([z, c * y + s * x, c * x - s * y], axis=1)
    return ball.with_vertices(turned + center)
