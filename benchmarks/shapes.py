"""Boxes and tori, whose every number is known, and scaled meshes. All positions are um, Z, Y, X."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np

from napari_deltamic.geometry.mesh import FloatArray, IntArray, Mesh
from napari_deltamic.geometry.primitives import _count, _outward


def torus(
    center: Sequence[float] | FloatArray,
    major_radius: float,
    minor_radius: float,
    edge_length: float | None = None,
) -> Mesh:
    """A torus around the Z axis; edges are about this long or shorter, or minor_radius / 4."""
    edge = minor_radius / 4 if edge_length is None else edge_length
    lengths = major_radius + minor_radius, minor_radius
    n, m = (max(3, _count(2 * pi * length, edge)) for length in lengths)
    around, tube = np.meshgrid(
        np.arange(n) * (2 * pi / n), np.arange(m) * (2 * pi / m), indexing="ij"
    )
    ring, height = major_radius + minor_radius * np.cos(tube), minor_radius * np.sin(tube)
    points = np.stack([height, ring * np.sin(around), ring * np.cos(around)], axis=-1)
    index = np.pad(np.arange(n * m).reshape(n, m), ((0, 1), (0, 1)), mode="wrap")
    return _outward(points.reshape(-1, 3) + np.asarray(center, float), _grid_faces(index))


def box(
    center: Sequence[float] | FloatArray,
    size: float | Sequence[float],
    edge_length: float | None = None,
) -> Mesh:
    """A box with sides along Z, Y, X, cut in equal parts no longer than ``edge_length``.

    The diagonal of a triangle is up to sqrt(2) longer; without a length sides are not cut.
    """
    sizes = np.broadcast_to(np.asarray(size, float), 3)
    counts = np.array([1 if edge_length is None else _count(s, edge_length) for s in sizes])
    lattice, faces, offset = [], [], 0
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        shape = (int(counts[first]) + 1, int(counts[second]) + 1)
        for end in (0, int(counts[axis])):
            points = np.full((*shape, 3), end)
            points[..., first], points[..., second] = np.indices(shape)
            index = np.arange(points.size // 3).reshape(shape) + offset
            lattice.append(points.reshape(-1, 3))
            way = -1 if end else 1  # opposite sides, opposite ways
            faces.append(_grid_faces(index)[:, ::way])
            offset += index.size
    points, inverse = np.unique(np.concatenate(lattice), axis=0, return_inverse=True)
    vertices = (points / counts - 0.5) * sizes + np.asarray(center, float)
    return _outward(vertices, inverse.reshape(-1)[np.concatenate(faces)])


def scaled(mesh: Mesh, factor: float | Sequence[float]) -> Mesh:
    """The mesh scaled about the origin by one positive factor, or one per axis Z, Y, X."""
    return mesh.with_vertices(mesh.vertices_numpy() * np.asarray(factor, float))


def _grid_faces(index: IntArray) -> IntArray:
    """Two triangles for each cell of a grid of vertex indices."""
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
