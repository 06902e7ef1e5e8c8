"""Starting surfaces for a fit: from points and an image, from label images, from spheres."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..common.reading import one_reason, read_text, reading
from ..errors import InputError, RepairWarning
from ..images.missing import unmasked
from .foam import spheres_of_foam
from .labels.basins import label_basins
from .labels.meshes import EDGE_IN_VOXELS, edge_within, surfaces_of_labels
from .labels.regions_at_points import regions_at
from .mesh import FloatArray, IntArray, Mesh
from .refused import Refused, told
from .three_numbers import three_numbers

Triple = Sequence[float]
FEWEST_SLICES = 3  # along each axis: else a region has no voxel with a crest on either side
_ALL = slice(None)
_NAMED = 10  # most lines named in a message: nobody would read more of them


def labels_from_points(
    image: ArrayLike,
    voxel_size: Triple,
    points: ArrayLike,
    origin: Triple = (0.0, 0.0, 0.0),
    *,
    dark: bool = False,
) -> NDArray[np.int32]:
    """Label the dark region that each point lies in, up to the crest of its bright membrane.

    If there is none, as in a nucleus, it is the cell that is found there without points.

    Parameters
    ----------
    image : (Z, Y, X) array, membranes bright.
    voxel_size : um, Z, Y, X.
    points : (n, 3), um, Z, Y, X; one inside each object.
    origin : um; centre of the first voxel.
    dark : dark regions only.

    Returns
    -------
    (Z, Y, X) int32: k for the object of the k-th point (from 1), 0 elsewhere. Objects without a
    point and the outside stay 0.

    Points that lie outside the image, on a membrane or in no closed region, in the region of an
    earlier point, or in one that is too small or lies mostly on the border of the image, are left
    out; one RepairWarning names them all.

    Raises
    ------
    InputError
        The image is not a finite 3D array; the points are no (n, 3) numbers; none of them can be
        used.
    """
    data, centres = _checked_image(image), _checked_points(points)
    size, start = (
        three_numbers(voxel_size, "voxel size"),
        three_numbers(origin, "origin", positive=False),
    )
    voxels, refused = _point_voxels(centres, size, start, data.shape)
    names = sorted(voxels)
    regions = label_basins if dark else regions_at
    labels, more = regions(data, size, _rows(voxels, names), names)
    _tell([*refused, *more], len(centres))
    return labels


def seeds_from_points(
    image: ArrayLike,
    voxel_size: Triple,
    points: ArrayLike,
    radii: ArrayLike | None = None,
    origin: Triple = (0.0, 0.0, 0.0),
    edge_length: float | None = None,
) -> Mesh:
    """Make starting surfaces for the objects that points name; region k is the k-th point (from 1).

    If `radii` (um, one a point; nan or 0 = not known) give a radius, the surface is a sphere;
    spheres that overlap become cells that share walls, see `foam`. Otherwise it follows the
    membrane around the point, see `labels_from_points`. Points that cannot be used, for the reasons
    given there, because a radius is no length, or because their sphere lies within others, are left
    out; one RepairWarning names them all.

    Raises
    ------
    InputError
        As in `labels_from_points`, or if the number of radii is not that of points.
    """
    parts, refused = surfaces_of_points(image, voxel_size, points, radii, origin, edge_length)
    _tell(refused, len(np.asarray(points)))
    return Mesh.merge(parts)


def surfaces_of_points(
    image: ArrayLike,
    voxel_size: Triple,
    points: ArrayLike,
    radii: ArrayLike | None = None,
    origin: Triple = (0.0, 0.0, 0.0),
    edge_length: float | None = None,
) -> tuple[list[Mesh], list[Refused]]:
    """Do the work of `seeds_from_points`: return meshes, maybe none, and the points left out."""
    data, centres = _checked_image(image), _checked_points(points)
    size, start = (
        three_numbers(voxel_size, "voxel size"),
        three_numbers(origin, "origin", positive=False),
    )
    edge = EDGE_IN_VOXELS * float(size.min()) if edge_length is None else float(edge_length)
    radius, refused = _known_radii(radii, centres)
    refused += _spheres_of_another_unit(radius, centres, size, start, data.shape)
    voxels, outside = _point_voxels(centres, size, start, data.shape)
    refused += outside
    left_out = {one.points[-1] for one in refused}
    parts: list[Mesh] = []
    free = [k for k in sorted(voxels) if k not in left_out and radius[k - 1] == 0]
    if free:
        labels, more = regions_at(data, size, _rows(voxels, free), free)
        refused += more
        if labels.any():
            found = surfaces_of_labels(labels, voxel_size, origin, edge)
            parts += found.meshes
            reason = f"is too small for edges of {edge:g} um"
            refused += [Refused(f"the region of point {k} {reason}", (k,)) for k in found.too_small]
    spheres = [k for k in sorted(voxels) if k not in left_out and radius[k - 1] > 0]
    if spheres:
        rows = np.array(spheres) - 1
        if edge_length is None:
            area = 4 * np.pi * float((radius[rows] ** 2).sum())
            edge = edge_within(size, area, len(spheres))
        balls, lost = spheres_of_foam(centres[rows], radius[rows], edge)
        numbers = np.array([0, *spheres])
        parts += [Mesh(b.vertices, b.faces, numbers[b.regions]) for b in balls]
        for k, reason in lost.items():
            number = spheres[k - 1]
            refused.append(Refused(f"the sphere of point {number} {reason}", (number,)))
    return parts, refused


def read_points_csv(path: str | Path) -> tuple[FloatArray, FloatArray | None]:
    """Read points (n, 3) in um and, if there is a fourth column, their radii in um.

    The header is `z,y,x` or `z,y,x,radius`. An empty radius is read as nan: not known.

    Raises
    ------
    InputError
        The file cannot be read, has another header, no points, or lines without numbers, of which
        the first are named.
    """
    rows = _rows_of(path)
    header = [field.lower() for field in rows[0]] if rows else []
    if len(header) == 1 and any(other in header[0] for other in ";\t"):
        raise InputError(f"{path}: columns must be separated by commas, with decimal points")
    if header not in (["z", "y", "x"], ["z", "y", "x", "radius"]):
        raise InputError(
            f"{path}: the first line must be z,y,x or z,y,x,radius; a Points layer that napari "
            "saved is read as well"
        )
    values = _values(path, rows[1:], len(header))
    return values[:, :3], values[:, 3] if len(header) == 4 else None


def read_napari_points(path: str | Path) -> FloatArray | None:
    """Read the (n, 3) voxel numbers of a Points layer that napari saved as CSV.

    None if the file is another table. Other columns are not read.

    Raises
    ------
    InputError
        The file cannot be read, its points are not in 3D, it has none, or lines without numbers.
    """
    rows = _rows_of(path)
    header = rows[0] if rows else []
    if header[:2] != ["index", "axis-0"]:
        return None
    axes = [name for name in header[1:] if name.startswith("axis-")]
    if len(axes) != 3:
        raise InputError(f"{path}: its points have {len(axes)} coordinates, not Z, Y and X")
    return _values(path, rows[1:], len(header), slice(1, 4))


def _rows_of(path: str | Path) -> list[list[str]]:
    with reading("points", path):
        try:
            lines = read_text(path).splitlines()
            return [[field.strip() for field in row] for row in csv.reader(lines)]
        except csv.Error as error:
            raise InputError(str(error)) from error


def _values(
    path: str | Path, rows: Sequence[Sequence[str]], columns: int, used: slice = _ALL
) -> FloatArray:
    """Read the used columns of the lines after the first, without empty lines.

    columns : number of fields that each line should have.
    """
    table: list[list[float]] = []
    wrong: list[str] = []
    for number, row in enumerate(rows, 2):
        if not any(row):
            continue
        try:
            table.append(_numbers(row, columns, used))
        except ValueError as error:
            wrong.append(f"line {number}: {one_reason(error)}")
    if wrong:  # skipping lines would shift the numbers of all later points
        more = f"; and {len(wrong) - _NAMED} more" if len(wrong) > _NAMED else ""
        raise InputError(f"{path}, {'; '.join(wrong[:_NAMED])}{more}")
    if not table:
        raise InputError(f"{path}: no points")
    return np.array(table)


# Checks ---------------------------------------------------------------------------------------


def _checked_image(image: ArrayLike) -> FloatArray:
    data = np.asarray(unmasked(image), np.float64)
    if data.ndim != 3 or not np.isfinite(data).all():
        raise InputError(f"the image must be a finite 3D array, not {data.ndim}D or with nan")
    if min(data.shape) < FEWEST_SLICES:
        raise InputError(
            f"points need an image of {FEWEST_SLICES} voxels or more along each axis, not "
            f"{data.shape}: nothing closes around them"
        )
    if data.max() == data.min():
        raise InputError("the image has the same value everywhere")
    return data


def _checked_points(points: ArrayLike) -> FloatArray:
    array = np.asarray(points, np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or not len(array):
        raise InputError("points must be an (n, 3) array with at least one row (um, Z, Y, X)")
    return array


def _numbers(row: Sequence[str], columns: int, used: slice) -> list[float]:
    """Read a line of a table of points. ValueError says what is wrong with it."""
    if len(row) != columns:
        raise ValueError(f"{len(row)} fields instead of {columns}")
    row = row[used]
    values = [float(field) for field in (*row[:3], *(field or "nan" for field in row[3:]))]
    if not np.isfinite(values[:3]).all():
        raise ValueError("a coordinate is not finite")
    return values


def _known_radii(radii: ArrayLike | None, points: FloatArray) -> tuple[FloatArray, list[Refused]]:
    """Return (n,) radii in um, 0 = not known, and the points whose radius is no length."""
    if radii is None:
        return np.zeros(len(points)), []
    array = np.asarray(radii, np.float64)
    if array.shape != (len(points),):
        raise InputError(f"{len(points)} points need as many radii, not {array.size}")
    wrong = np.flatnonzero((array < 0) | np.isinf(array)).tolist()
    texts = {k + 1: f"point {k + 1}: radius {array[k]:g} is not a length" for k in wrong}
    return np.nan_to_num(array), [Refused(text, (k,)) for k, text in texts.items()]


def _spheres_of_another_unit(
    radius: FloatArray,
    points: FloatArray,
    size: FloatArray,
    origin: FloatArray,
    shape: tuple[int, ...],
) -> list[Refused]:
    """Refuse spheres whose surface does not meet the image, or that are smaller than a voxel."""
    last = origin + size * (np.array(shape) - 1)
    corner = np.maximum(np.abs(points - origin), np.abs(points - last))
    around = radius > np.linalg.norm(corner, axis=1)
    within = (radius > 0) & (2 * radius < size.min())
    texts = {
        k + 1: f"point {k + 1}: a sphere of radius {radius[k]:g} um "
        + ("holds the whole image" if around[k] else "is smaller than a voxel")
        + ": radii are in um"
        for k in np.flatnonzero(around | within).tolist()
    }
    return [Refused(text, (k,)) for k, text in texts.items()]


def _point_voxels(
    points: FloatArray, size: FloatArray, origin: FloatArray, shape: tuple[int, ...]
) -> tuple[dict[int, IntArray], list[Refused]]:
    """Return the voxel of each point in the image, by its number, and the points outside."""
    voxels: dict[int, IntArray] = {}
    refused = []
    for number, point in enumerate(points, 1):
        place = np.floor((point - origin) / size + 0.5)
        where = ", ".join(f"{value:g}" for value in point)
        if not np.isfinite(point).all():
            text = f"point {number} ({where} um): a coordinate is not finite"
            refused.append(Refused(text, (number,)))
        elif ((place < 0) | (place >= np.array(shape))).any():
            text = f"point {number} ({where} um) lies outside the image"
            refused.append(Refused(text, (number,)))
        else:
            voxels[number] = place.astype(np.int64)
    return voxels, refused


def _rows(voxels: dict[int, IntArray], names: Sequence[int]) -> IntArray:
    return np.array([voxels[name] for name in names], np.int64).reshape(-1, 3)


def _tell(refused: Sequence[Refused], count: int) -> None:
    if refused:
        one_each = {one.points[-1]: one.text for one in refused}
        text = told([one_each[k] for k in sorted(one_each)], count, "point")
        warnings.warn(text, RepairWarning, stacklevel=3)
