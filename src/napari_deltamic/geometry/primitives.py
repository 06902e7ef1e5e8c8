"""Simple closed surfaces: starting shapes, examples, tests. All positions are um, Z, Y, X."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, pi, sqrt

import numpy as np

from ..errors import InputError
from .mesh import FloatArray, IntArray, Mesh, _triple

MAX_FACES = 5_000_000  # a typing error in edge_length would fill the memory
_ICOSAHEDRON_EDGE = 1.0514622242382672  # exact, for a circumscribed radius of 1


def sphere(
    center: Sequence[float] | FloatArray,
    radius: float | Sequence[float],
    edge_length: float | None = None,
    subdivisions: int | None = None,
) -> Mesh:
    """Make a sphere or an ellipsoid with axes along Z, Y, X, from a subdivided icosahedron.

    Parameters
    ----------
    center : (3,) um, Z, Y, X.
    radius : um; one number, or three (Z, Y, X) for an ellipsoid. Every vertex lies on the surface,
        so the volume is a little below that of the smooth shape.
    edge_length : um; the typical edge, about this or shorter (on the longest axis).
    subdivisions : each adds a factor of 4 in faces: 20 * 4**subdivisions. The default is 3.

    Raises InputError if a size is not positive, or both edge_length and subdivisions are given.
    """
    radii = _positive(radius, "radius")
    if edge_length is not None and subdivisions is not None:
        raise InputError("give edge_length or subdivisions, not both")
    if edge_length is not None:
        n = _count(_ICOSAHEDRON_EDGE * radii.max(), edge_length)
    else:
        level = 3 if subdivisions is None else subdivisions
        if level < 0 or level > 8:
            raise InputError("subdivisions must be 0 to 8")
        n = 2**level
    _check_size(20 * n * n)
    corners, faces = _icosahedron()
    points, triangles = _subdivided(corners, faces, n)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return _outward(points * radii + _triple(center, "center"), triangles)


def torus(
    center: Sequence[float] | FloatArray,
    major_radius: float,
    minor_radius: float,
    edge_length: float | None = None,
) -> Mesh:
    """Make a torus around the Z axis.

    Parameters
    ----------
    center : (3,) um, Z, Y, X.
    major_radius : um; from the centre to the middle of the tube.
    minor_radius : um; of the tube; smaller than major_radius.
    edge_length : um; about this or shorter; by default minor_radius / 4.

    Raises InputError if a size is not positive or the tube meets itself.
    """
    major, minor = (
        float(_positive(value, name)[0])
        for value, name in ((major_radius, "major_radius"), (minor_radius, "minor_radius"))
    )
    if minor >= major:
        raise InputError("minor_radius must be smaller than major_radius")
    edge = minor / 4 if edge_length is None else edge_length
    n, m = (max(3, _count(2 * pi * length, edge)) for length in (major + minor, minor))
    _check_size(2 * n * m)
    around, tube = np.meshgrid(
        np.arange(n) * (2 * pi / n), np.arange(m) * (2 * pi / m), indexing="ij"
    )
    ring = major + minor * np.cos(tube)
    points = np.stack([minor * np.sin(tube), ring * np.sin(around), ring * np.cos(around)], axis=-1)
    index = np.arange(n * m).reshape(n, m)
    index = np.pad(index, ((0, 1), (0, 1)), mode="wrap")
    return _outward(points.reshape(-1, 3) + _triple(center, "center"), _grid_faces(index))


def box(
    center: Sequence[float] | FloatArray,
    size: float | Sequence[float],
    edge_length: float | None = None,
) -> Mesh:
    """Make a box with sides along Z, Y, X.

    Parameters
    ----------
    center : (3,) um, Z, Y, X.
    size : um; one number for a cube, or three side lengths (Z, Y, X).
    edge_length : um; sides are cut in equal parts no longer than this (a triangle's diagonal is
        up to sqrt(2) longer); by default they are not cut: 12 faces.

    Raises InputError if a size is not positive.
    """
    sizes = _positive(size, "size")
    counts = np.array([1 if edge_length is None else _count(s, edge_length) for s in sizes])
    _check_size(4 * int(counts @ np.roll(counts, 1)))
    lattice, faces, offset = [], [], 0
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        shape = (int(counts[first]) + 1, int(counts[second]) + 1)
        for end in (0, int(counts[axis])):
            points = np.full((*shape, 3), end)
            points[..., first], points[..., second] = np.indices(shape)
            index = np.arange(points.size // 3).reshape(shape) + offset
            lattice.append(points.reshape(-1, 3))
            faces.append(
                _grid_faces(index)[:, :: -1 if end else 1]
            )  # opposite sides, opposite ways
            offset += index.size
    points, inverse = np.unique(np.concatenate(lattice), axis=0, return_inverse=True)
    vertices = (points / counts - 0.5) * sizes + _triple(center, "center")
    return _outward(vertices, inverse.reshape(-1)[np.concatenate(faces)])


def _positive(value: float | Sequence[float], name: str) -> FloatArray:
    values = _triple(value, name)
    if not (np.isfinite(values).all() and (values > 0).all()):
        raise InputError(f"{name} must be positive")
    return values


def _count(length: float, edge_length: float) -> int:
    """Return how many parts of at most edge_length make up length."""
    if not edge_length > 0:
        raise InputError("edge_length must be positive")
    # The small slack keeps 1.0 / 0.1 at 10 parts.
    return max(1, ceil(min(length / edge_length, 1e9) * (1 - 1e-12)))


def _check_size(n_faces: int) -> None:
    if n_faces > MAX_FACES:
        raise InputError(f"edge_length is too small: it asks for {n_faces} faces")


def _outward(vertices: FloatArray, faces: IntArray) -> Mesh:
    mesh = Mesh(vertices, faces)
    return mesh if mesh.region_volume(1) > 0 else Mesh(vertices, faces[:, ::-1])


def _grid_faces(index: IntArray) -> IntArray:
    """Return two triangles for each cell of a grid of vertex indices."""
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)


def _icosahedron() -> tuple[FloatArray, IntArray]:
    golden = (1 + sqrt(5)) / 2
    flat = np.array([[0, s, t * golden] for s in (-1, 1) for t in (-1, 1)])
    corners = np.concatenate([np.roll(flat, shift, axis=1) for shift in range(3)])
    # Faces are the triples of corners at the edge length, 2, from each other.
    near = np.abs(np.linalg.norm(corners[:, None] - corners, axis=-1) - 2) < 1e-9  # rounding
    i, j, k = np.nonzero(near[:, :, None] & near[:, None, :] & near[None])
    faces = np.stack([i, j, k], axis=1)[(i < j) & (j < k)]
    a, b, c = (corners[faces[:, corner]] for corner in range(3))
    inward = np.einsum("fi,fi->f", a, np.cross(b, c)) > 0  # all alike, whichever way that is
    faces[inward] = faces[inward][:, ::-1]
    return corners, faces


def _subdivided(corners: FloatArray, faces: IntArray, n: int) -> tuple[FloatArray, IntArray]:
    """Cut each triangle in n * n, on its plane; points on shared edges are shared."""
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
    keep = i + j <= n
    weights = np.stack([n - i - j, i, j], axis=1)[keep]
    index = np.full((n + 2, n + 2), -1)
    index[i[keep], j[keep]] = np.arange(len(weights))
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]
    up, down = (a >= 0) & (b >= 0) & (c >= 0), (b >= 0) & (c >= 0) & (d >= 0)
    local = np.concatenate(
        [np.stack([a[up], b[up], c[up]], axis=1), np.stack([b[down], d[down], c[down]], axis=1)]
    )
    # A point is named by its weights on the corners of the whole solid: exact, in integers.
    names = np.zeros((len(faces), len(weights), len(corners)), dtype=np.int16)
    rows = np.arange(len(faces))[:, None]
    for corner in range(3):
        names[rows, np.arange(len(weights)), faces[:, corner, None]] = weights[:, corner]
    unique, inverse = np.unique(names.reshape(-1, len(corners)), axis=0, return_inverse=True)
    triangles = inverse.reshape(len(faces), len(weights))[:, local].reshape(-1, 3)
    return unique.astype(np.float64) @ corners / n, triangles
