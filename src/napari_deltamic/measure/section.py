"""Where a plane cuts a mesh: the contour that a slice of the image shows."""

from __future__ import annotations

from math import isfinite

import numpy as np

from ..errors import InputError
from ..geometry.mesh import FloatArray, IntArray, Mesh


def section(mesh: Mesh, axis: int, position: float) -> tuple[FloatArray, IntArray]:
    """Cut a mesh with a plane across one axis.

    What lies exactly in the plane counts as below it, so the contour of a closed surface is closed
    wherever the plane lies, and that of a face in the plane is drawn once or not at all. Ends of
    segments that meet are equal to the last bit.

    Parameters
    ----------
    mesh : any mesh, also of many regions, um.
    axis : 0, 1 or 2 for a plane across Z, Y or X.
    position : um; where the plane lies on that axis.

    Returns
    -------
    segments : (S, 2, 2) um: each from one point to another, in the other two coordinates, in
        Z, Y, X order. S is 0 where the plane misses the mesh.
    faces : (S,) the face that each segment lies in; ``mesh.regions[faces]`` names its sides.

    Raises
    ------
    InputError
        For another axis, or a position that is not finite.
    """
    if axis not in (0, 1, 2):
        raise InputError(f"axis must be 0, 1 or 2 (Z, Y, X), not {axis}")
    if not isfinite(position):
        raise InputError(f"the position of a section must be finite, not {position}")
    vertices = mesh.vertices_numpy()
    above = (vertices[:, axis] > position)[mesh.faces]
    faces = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
    # One corner of such a face is on its own; the plane cuts the two edges that leave it.
    side = above[faces]
    alone = (side != (side.sum(axis=1) > 1)[:, None]).argmax(axis=1)
    rows = np.arange(len(faces))
    corner = mesh.faces[faces]
    first = corner[rows, alone]
    alone_above = side[rows, alone]
    ends = []
    for turn in (1, 2):
        second = corner[rows, (alone + turn) % 3]
        low, high = np.where(alone_above, [second, first], [first, second])
        ends.append(_crossing(vertices[low], vertices[high], axis, position))
    segments = np.stack(ends, axis=1)
    # A face that touches the plane only in a vertex leaves a point, which is no segment.
    kept = (segments[:, 0] != segments[:, 1]).any(axis=1)
    return segments[kept], faces[kept].astype(np.int64)


def _crossing(low: FloatArray, high: FloatArray, axis: int, position: float) -> FloatArray:
    """Return (S, 2) where edges cross the plane; from low to high, so that neighbours agree."""
    others = [k for k in range(3) if k != axis]
    share = (position - low[:, axis]) / (high[:, axis] - low[:, axis])
    points: FloatArray = low[:, others] + share[:, None] * (high[:, others] - low[:, others])
    return points
