"""Clusters of cells at random: where they lie, how they shine, and where a fit of them starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from napari_deltamic import GaussianPSF, Grid, Mesh, render
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.labels.voxels import voxel_labels

from ..clusters.foams import EDGE, RADIUS, TRUE_EDGE, clump

CELLS, PHOTONS = (8, 32), (10.0, 100.0)
UNEVEN_CELLS, UNEVEN = 0.2, 0.25  # standard deviations of the log of the brightness
SHIFT, SMOOTH = 1.0, 5.0  # voxels: of centres and of the borders of labels, which are off smoothly


@dataclass(frozen=True)
class Cluster:
    """A scene of which all is known.

    start : a mesh; None where ``labels`` are what a fit starts from.
    """

    name: str
    truth: Mesh
    image: NDArray[np.float32]
    grid: Grid
    sigma: tuple[float, float, float]
    start: Mesh | None
    labels: NDArray[np.int32] | None


def cluster(seed: int, number: int, most: int = CELLS[1]) -> Cluster:
    """8 to 32 cells; clutter, uneven brightness, 10 to 100 photons; odd ones start from labels."""
    rng = np.random.default_rng([seed, number])
    cells = int(rng.integers(CELLS[0], most + 1))
    side = 2 * round(17 * cells ** (1 / 3))  # as much room as the foams of ``clusters`` have
    grid = Grid((side,) * 3, (1.0,) * 3)
    centers = clump(cells, side, int(rng.integers(2**31)))
    radii = RADIUS * rng.uniform(0.92, 1.08, cells)
    truth = foam(centers, radii, TRUE_EDGE)
    lateral = rng.uniform(1.2, 1.6)
    sigma = (float(lateral * rng.uniform(1.0, 1.7)), float(lateral), float(lateral))
    photons = float(np.exp(rng.uniform(*np.log(PHOTONS))))
    clean = render(truth, grid, GaussianPSF(sigma), 1e-4, density=uneven(truth, rng))
    light = clean.double().numpy().clip(0)
    light /= np.percentile(light[light > 0.05 * light.max()], 95)  # walls are 1
    light += clutter(grid, sigma, rng) + rng.uniform(0.05, 0.2)
    image = rng.poisson(photons * light).astype(np.float32)
    name = f"{number}: {cells} cells, {photons:.0f} photons"
    if number % 2:
        labels = misplaced(voxel_labels(truth, grid.shape, grid.voxel_size), rng)
        return Cluster(f"{name}, from labels", truth, image, grid, sigma, None, labels)
    moved = centers + rng.normal(0, SHIFT, centers.shape)
    begin = foam(moved, radii - 1, EDGE)
    return Cluster(f"{name}, from centres", truth, image, grid, sigma, begin, None)


def evenly(count: int, half: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """(count, 3) places spread evenly over an ellipsoid of these half axes (Lloyd), then shaken."""
    cloud = rng.uniform(-1, 1, (60 * count, 3))
    cloud = cloud[(cloud**2).sum(1) < 1] * half
    places = cloud[:count]
    for _ in range(20):
        nearest = cKDTree(places).query(cloud)[1]
        number = np.maximum(np.bincount(nearest, minlength=count), 1)
        sums = [np.bincount(nearest, cloud[:, k], count) for k in range(3)]
        places = np.stack(sums, axis=1) / number[:, None]
    spacing = (half.prod() / count) ** (1 / 3)
    shaken: NDArray[np.float64] = places + rng.normal(0, 0.08 * spacing, places.shape)
    return shaken


def uneven(mesh: Mesh, rng: np.random.Generator) -> NDArray[np.float64]:
    """(F,) densities: each cell has its own, on which waves of a cell's length go up and down.

    A wall has the mean of its two cells'.
    """
    size = int(mesh.regions.max()) + 1
    own = np.exp(rng.normal(0, UNEVEN_CELLS, size))
    inside = (mesh.regions > 0).astype(float)
    each = (own[mesh.regions] * inside).sum(1) / inside.sum(1)
    middle = mesh.vertices_numpy()[mesh.faces].mean(1)
    ways = rng.normal(size=(6, 3))
    ways *= 2 * np.pi / (2 * RADIUS) / np.linalg.norm(ways, axis=1, keepdims=True)
    waves = np.sin(middle @ ways.T + rng.uniform(0, 2 * np.pi, 6)).sum(1) / np.sqrt(3)
    return each * np.exp(UNEVEN * waves)


def clutter(
    grid: Grid, sigma: tuple[float, float, float], rng: np.random.Generator
) -> NDArray[np.float64]:
    """Specks as bright as walls or half as bright, and haze that rises to one side."""
    specks = np.zeros(grid.shape)
    count = round(np.prod(grid.shape) / 15_000)  # about twenty among eight cells
    places = tuple(rng.integers(0, n, count) for n in grid.shape)
    specks[places] = rng.uniform(0.5, 1.0, count)
    specks = ndimage.gaussian_filter(specks, sigma) * (2 * np.pi) ** 1.5 * np.prod(sigma)
    slope = np.linspace(0, rng.uniform(0, 0.1), grid.shape[0])
    return specks + slope[:, None, None]


def misplaced(labels: NDArray[np.int32], rng: np.random.Generator) -> NDArray[np.int32]:
    """Labels whose borders are off by a voxel, here and there: those of a segmentation."""
    where = np.indices(labels.shape, np.float64)
    for axis in range(3):
        push = ndimage.gaussian_filter(rng.normal(size=labels.shape), SMOOTH)
        where[axis] += SHIFT * push / push.std()
    moved: NDArray[np.int32] = ndimage.map_coordinates(labels, where, order=0, mode="nearest")
    return moved
