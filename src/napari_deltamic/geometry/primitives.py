"""Spheres and ellipsoids. All positions are um, Z, Y, X."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, sqrt

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
