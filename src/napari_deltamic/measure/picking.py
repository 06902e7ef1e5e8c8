"""Finds the cell at a place: in a slice, or behind a face."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry.brush import nearest_on_segments
from ..geometry.mesh import OUTSIDE, FloatArray, Mesh
from .section import section


def region_in_slice(mesh: Mesh, axis: int, point: FloatArray, near: float) -> int:
    """Return the region around a point (3,) um in the slice across an axis, or with a contour near.

    If regions lie within one another, it is the one with the nearest contour. 0 if there is none.
    """
    segments, faces = section(mesh, axis, float(point[axis]))
    if not len(segments):
        return OUTSIDE
    here = np.delete(point, axis)
    _, distance = nearest_on_segments(segments, here)
    sides = mesh.regions[faces]
    found = []
    for region in np.unique(sides[sides != OUTSIDE]).tolist():
        own = (sides == region).any(axis=1)
        nearest = float(distance[own].min())
        inside = _crossings(segments[own], here) % 2 == 1
        if inside or nearest <= near:
            found.append((not inside, nearest, region))
    return int(min(found)[2]) if found else OUTSIDE


def region_behind(mesh: Mesh, face: int, direction: FloatArray) -> int:
    """Return the region behind a face, seen along a direction; the one in front if none is."""
    first, second = mesh.regions[face].tolist()
    towards = float(mesh.normals()[face] @ direction) < 0
    behind, front = (first, second) if towards else (second, first)
    return int(behind or front)


def _crossings(segments: NDArray[np.float64], point: FloatArray) -> int:
    """Count the segments that a ray from a point along the last axis crosses; odd if inside."""
    (y, x), (a, b) = point, (segments[:, 0], segments[:, 1])
    cut = (a[:, 0] > y) != (b[:, 0] > y)
    a, b = a[cut], b[cut]
    at = a[:, 1] + (y - a[:, 0]) / (b[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    return int((at > x).sum())
