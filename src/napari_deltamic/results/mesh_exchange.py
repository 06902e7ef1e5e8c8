"""Measured meshes for other tools: face attributes, separate cells, labels at any voxel size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry import Mesh
from ..geometry.labels.voxels import voxel_labels
from ..geometry.mesh import OUTSIDE, FloatArray
from ..measure import Measurements, Table
from ..measure.sides import Sides
from ..scene import Grid

_MARGIN = 2  # voxels around a mesh without an image
_ROUNDING = 1e-6  # um
_MOST_VOXELS = 4_000_000_000  # a typing error in a voxel size should not fill the memory


def wall_attributes(mesh: Mesh, measured: Measurements) -> dict[str, FloatArray]:
    """Return the numbers of the table of walls for each face, (F,) by name; NaN for none."""
    _, wall = mesh.interfaces()
    found = _numbers(measured.walls, ("region_a", "region_b"))
    return {"wall": wall.astype(np.float64)} | {k: v[wall] for k, v in found.items()}


def cells_apart(mesh: Mesh, measured: Measurements) -> tuple[Mesh, dict[str, FloatArray]]:
    """Make each cell a closed surface of its own, with the numbers of its row on its faces.

    Walls between two cells are there twice, and no vertex belongs to two cells, as tools expect
    that have no shared walls.
    """
    sides = Sides.of(mesh)
    corners = mesh.faces[sides.face]
    corners = np.where(sides.sign[:, None] < 0, corners[:, ::-1], corners)
    keys, index = np.unique(sides.cell[:, None] * len(mesh.vertices) + corners, return_inverse=True)
    regions = np.column_stack([sides.cells[sides.cell], np.full(len(corners), OUTSIDE)])
    vertices = mesh.vertices_numpy()[keys % len(mesh.vertices)]
    numbers = _numbers(measured.cells, ("region",))
    apart = Mesh(vertices, index.reshape(-1, 3), regions)
    return apart, {name: values[sides.cell] for name, values in numbers.items()}


def labels_grid(mesh: Mesh, voxel_size: tuple[float, float, float], image: Grid | None) -> Grid:
    """Return the grid of a label image.

    With the grid of an image: the same volume in other voxels. Without: around the mesh, with voxel
    centres at whole multiples of the voxel size, from 0 on if the mesh begins there.

    Raises
    ------
    InputError
        For a voxel size that is not positive, or so small that the labels would be enormous.
    """
    size = np.asarray(Grid((1, 1, 1), voxel_size).voxel_size)
    if image is not None:
        side = np.asarray(image.voxel_size)
        corner = np.asarray(image.origin) - side / 2
        shape = np.maximum(1, np.rint(np.asarray(image.shape) * side / size))
        origin = corner + size / 2
    else:
        low, high = mesh.bounds()
        first = np.minimum(0, np.floor(low / size) - _MARGIN)
        shape = np.ceil(high / size) + _MARGIN + 1 - first
        origin = first * size
    if shape.prod() > _MOST_VOXELS:
        sides = " ".join(f"{s:g}" for s in size)
        raise InputError(f"voxels of {sides} um are too small: there would be {shape.prod():.3g}")
    z, y, x = (int(n) for n in shape)
    return Grid((z, y, x), voxel_size, tuple(origin.tolist()))


def about_place(labels: Grid, image: Grid | None) -> str:
    """Say where a label image begins if not at the origin of the mesh; "" if it does."""
    start = (0.0, 0.0, 0.0) if image is None else image.origin
    if np.allclose(labels.origin, start, rtol=0, atol=_ROUNDING):
        return ""
    place = " ".join(f"{o:.4g}" for o in np.subtract(labels.origin, start))
    return f"the first voxel of the labels lies at {place} um (Z Y X), from the origin of the mesh"


def labels_of(mesh: Mesh, grid: Grid) -> NDArray[np.integer]:
    """Return (Z, Y, X) the cell in which each voxel's centre lies, in the smallest sufficient type.

    Open cells have no inside and are left out.
    """
    closed = [int(k) for k in mesh.region_ids() if mesh.is_closed(int(k))]
    if not closed:
        return np.zeros(grid.shape, np.uint16)
    inside = np.isin(mesh.regions, closed)
    kept = inside.any(1)
    part = Mesh(mesh.vertices, mesh.faces[kept], np.where(inside, mesh.regions, OUTSIDE)[kept])
    labels = voxel_labels(part, grid.shape, grid.voxel_size, grid.origin)
    kind = np.uint16 if labels.max() < 2**16 else np.uint32
    if labels.max() >= 2**32:
        raise InputError(f"region {labels.max()} is too large a number for a label image")
    return labels.astype(kind)


def _numbers(table: Table, without: tuple[str, ...]) -> dict[str, FloatArray]:
    """Return the columns that hold numbers, (rows,) each; NaN for empty cells."""
    found = {}
    for column in table.columns:
        values = table.values(column.name)
        numbers = [v for v in values if isinstance(v, (int, float))]
        words = any(isinstance(v, str) for v in values)
        if column.name not in without and numbers and not words:
            found[column.name] = np.array([np.nan if v is None else v for v in values], np.float64)
    return found
