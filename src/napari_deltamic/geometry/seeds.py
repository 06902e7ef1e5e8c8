"""Starting surfaces for a fit: from points and an image, from label images, from spheres."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.labels.basins import label_basins
from napari_deltamic.geometry.labels.meshes import EDGE_IN_VOXELS, mesh_from_labels
from napari_deltamic.geometry.mesh import FloatArray, IntArray, Mesh

Triple = Sequence[float]


def labels_from_points(
    image: ArrayLike,
    voxel_size: Triple,
    points: ArrayLike,
    origin: Triple = (0.0, 0.0, 0.0),
    *,
    smoothing: float | None = None,
) -> NDArray[np.int32]:
    """Label the dark region that each point lies in, up to the crest of its bright membrane.

    Parameters
    ----------
    image : (Z, Y, X) array, membranes bright.
    voxel_size : um, Z, Y, X.
    points : (n, 3), um, Z, Y, X; one inside each object.
    origin : um; centre of the first voxel.
    smoothing : um; standard deviation of the Gaussian applied first. Default: the smallest voxel
        side.

    Returns
    -------
    (Z, Y, X) int32: k for the object of the k-th point (from 1), 0 elsewhere. Objects without a
    point and the outside stay 0.

    Raises
    ------
    InputError
        The image is not a finite 3D array; a point lies outside the image, on a membrane or in no
        closed region; two points lie in the same region; a region is too small or lies mostly on
        the border of the image.
    """
    data, centres = _checked_image(image), _checked_points(points)
    size, start = _triple(voxel_size, "voxel size"), _triple(origin, "origin", positive=False)
    voxels = _point_voxels(centres, size, start, data.shape)
    return label_basins(data, size, voxels, list(range(1, len(voxels) + 1)), smoothing)


def seeds_from_points(
    image: ArrayLike,
    voxel_size: Triple,
    points: ArrayLike,
    radii: ArrayLike | None = None,
    origin: Triple = (0.0, 0.0, 0.0),
    edge_length: float | None = None,
) -> Mesh:
    """Starting surfaces for the objects that points name; region k is the k-th point (from 1).

    Where `radii` (um, one a point; nan or 0 = not known) gives a radius the surface is a sphere;
    spheres that overlap become cells that share walls, see `foam`. Elsewhere it follows the
    membrane around the point, see `labels_from_points`.

    Raises
    ------
    InputError
        As `labels_from_points`, a negative or infinite radius, or not one radius a point.
    """
    data, centres = _checked_image(image), _checked_points(points)
    size, start = _triple(voxel_size, "voxel size"), _triple(origin, "origin", positive=False)
    edge = EDGE_IN_VOXELS * float(size.min()) if edge_length is None else float(edge_length)
    radius = np.zeros(len(centres)) if radii is None else np.nan_to_num(_radii(radii, centres))
    voxels = _point_voxels(centres, size, start, data.shape)
    parts: list[Mesh] = []
    free = np.flatnonzero(radius == 0)
    if len(free):
        labels = label_basins(data, size, voxels[free], (free + 1).tolist(), None)
        parts.append(mesh_from_labels(labels, voxel_size, origin, edge))
    round_ = np.flatnonzero(radius > 0)
    if len(round_):
        balls = foam(centres[round_], radius[round_], edge)
        numbers = np.concatenate([[0], round_ + 1])
        parts.append(Mesh(balls.vertices, balls.faces, numbers[balls.regions]))
    return Mesh.merge(parts)


def read_points_csv(path: str | Path) -> tuple[FloatArray, FloatArray | None]:
    """Read points (n, 3) in um and, if there is a fourth column, their radii in um.

    The header is `z,y,x` or `z,y,x,radius`. An empty radius is read as nan: not known.

    Raises
    ------
    InputError
        The file cannot be read, has another header, no points, or a field that is not a number.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read points from {path}: {error}") from error
    rows = [[field.strip() for field in row] for row in csv.reader(text.splitlines())]
    header = [field.lower() for field in rows[0]] if rows else []
    if header not in (["z", "y", "x"], ["z", "y", "x", "radius"]):
        raise InputError(f"{path}: the first line must be z,y,x or z,y,x,radius")
    table: list[list[float]] = []
    for number, row in enumerate(rows[1:], 2):
        if not any(row):
            continue
        if len(row) != len(header):
            raise InputError(f"{path}, line {number}: {len(row)} fields instead of {len(header)}")
        filled = row[:3] + [field or "nan" for field in row[3:]]
        try:
            table.append([float(field) for field in filled])
        except ValueError as error:
            raise InputError(f"{path}, line {number}: {error}") from error
        if not np.isfinite(table[-1][:3]).all():
            raise InputError(f"{path}, line {number}: a coordinate is not finite")
    if not table:
        raise InputError(f"{path}: no points")
    values = np.array(table)
    return values[:, :3], values[:, 3] if len(header) == 4 else None


# Checks ---------------------------------------------------------------------------------------


def _triple(values: Triple, name: str, *, positive: bool = True) -> FloatArray:
    array = np.asarray(values, np.float64)
    if array.shape != (3,) or not np.isfinite(array).all() or (positive and (array <= 0).any()):
        raise InputError(f"{name} must be 3 {'positive ' * positive}numbers (um, Z, Y, X)")
    return array


def _checked_image(image: ArrayLike) -> FloatArray:
    data = np.asarray(image, np.float64)
    if data.ndim != 3 or not np.isfinite(data).all():
        raise InputError(f"the image must be a finite 3D array, not {data.ndim}D or with nan")
    if data.max() == data.min():
        raise InputError("the image has the same value everywhere")
    return data


def _checked_points(points: ArrayLike) -> FloatArray:
    array = np.asarray(points, np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or not len(array) or not np.isfinite(array).all():
        raise InputError("points must be a finite (n, 3) array with at least one row (um, Z, Y, X)")
    return array


def _radii(radii: ArrayLike, points: FloatArray) -> FloatArray:
    array = np.asarray(radii, np.float64)
    if array.shape != (len(points),):
        raise InputError(f"{len(points)} points need as many radii, not {array.size}")
    for k in np.flatnonzero((array < 0) | np.isinf(array)):
        raise InputError(f"point {k + 1}: radius {array[k]:g} is not a length")
    return array


def _point_voxels(
    points: FloatArray, size: FloatArray, origin: FloatArray, shape: tuple[int, ...]
) -> IntArray:
    voxels = np.floor((points - origin) / size + 0.5).astype(np.int64)
    outside = ((voxels < 0) | (voxels >= np.array(shape))).any(axis=1)
    for k in np.flatnonzero(outside):
        where = ", ".join(f"{value:g}" for value in points[k])
        raise InputError(f"point {k + 1} ({where} um) lies outside the image")
    return voxels
