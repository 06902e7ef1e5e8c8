"""Numbers for each cell of a mesh: sizes, place, axes."""

from __future__ import annotations

from math import nan, pi

import numpy as np

from ..geometry.contacts import neighbours
from ..geometry.mesh import FloatArray, Mesh
from .sides import Sides

COLUMNS = (
    "region",
    "volume_um3",
    "area_um2",
    "sphericity",
    "centroid_z_um",
    "centroid_y_um",
    "centroid_x_um",
    "n_contacts",
)

CellRow = dict[str, int | float]


def measure_cells(mesh: Mesh) -> list[CellRow]:
    """Measure the size and place of each region of a mesh; quick enough for a live display.

    Returns
    -------
    list of dict, sorted by region
        region : its number
        volume_um3 : of the region
        area_um2 : of all its faces, walls included
        sphericity : area of the sphere of the same volume over area; 1 for a sphere, else less
        centroid_z_um, centroid_y_um, centroid_x_um : centre of the volume
        n_contacts : number of other regions with which it shares a wall

        What needs a volume is NaN if the region's surface is not closed or is inside out.
    """
    sides = Sides.of(mesh)
    areas = sides.total(mesh.areas()[sides.face])
    volumes, centroids, _ = moments(sides)
    others = neighbours(mesh)
    found = zip(sides.cells, volumes, areas, centroids, strict=True)
    return [
        {
            "region": int(region),
            "volume_um3": float(volume),
            "area_um2": float(area),
            "sphericity": sphericity(float(volume), float(area)),
            "centroid_z_um": float(centroid[0]),
            "centroid_y_um": float(centroid[1]),
            "centroid_x_um": float(centroid[2]),
            "n_contacts": len(others[int(region)]),
        }
        for region, volume, area, centroid in found
    ]


def sphericity(volume: float, area: float) -> float:
    """Return the area of the sphere of the same volume over the area: 1 for a sphere, else less."""
    return pi ** (1 / 3) * (6 * volume) ** (2 / 3) / area if area else nan


def moments(sides: Sides) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return volumes (C,) um^3, centroids (C, 3) um and covariances (C, 3, 3) um^2 of cells.

    A face and a reference point span a tetrahedron, whose moments are known: with its corners v and
    their sum s, its second moment about the reference is its volume V times ``(v v' + s s') / 20``.
    All are NaN if a cell's surface is not closed or is inside out.
    """
    mesh = sides.mesh
    corners = mesh.vertices_numpy()[mesh.faces][sides.face]
    count = np.maximum(sides.total(np.ones(len(sides.face))), 1)[:, None]
    # Relative to the cell's own middle, so that no digits are lost far from the origin.
    middle = sides.total(corners.mean(1)) / count
    corners = corners - middle[sides.cell, None]
    cross = np.cross(corners[:, 1], corners[:, 2])
    # Z, Y, X components are left-handed: hence the sign.
    part = -sides.sign * np.einsum("si,si->s", corners[:, 0], cross) / 6
    volume = sides.total(part)
    usable = sides.closed() & (volume > 0)
    volume = np.where(usable, volume, nan)
    sums = corners.sum(1)
    first = sides.total(part[:, None] * sums / 4) / volume[:, None]
    squares = np.einsum("ski,skj->sij", corners, corners) + sums[:, :, None] * sums[:, None]
    second = sides.total(part[:, None, None] * squares / 20) / volume[:, None, None]
    return volume, middle + first, second - first[:, :, None] * first[:, None]


def principal_axes(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return half axes (C, 3) um, descending, and directions (C, 3, 3) of each cell's ellipsoid.

    The ellipsoid has the cell's second moments: those of a solid ellipsoid are a fifth of its half
    axes squared. Row k is the direction of axis k, Z Y X, its largest component positive. NaN where
    the covariance is NaN.
    """
    known = np.isfinite(covariance).all((1, 2))
    axes = np.full((len(covariance), 3), nan)
    directions = np.full((len(covariance), 3, 3), nan)
    values, vectors = np.linalg.eigh(covariance[known])
    axes[known] = np.sqrt(5 * np.maximum(values[:, ::-1], 0))
    rows = vectors[:, :, ::-1].transpose(0, 2, 1)
    largest = np.take_along_axis(rows, np.abs(rows).argmax(2)[:, :, None], 2)
    directions[known] = rows * np.where(largest < 0, -1.0, 1.0)
    return axes, directions
