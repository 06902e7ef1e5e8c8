"""Converts meshes from and to trimesh, which uses x, y, z and has no regions of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
_SIDES = ("region_a", "region_b")  # as .ply and .vtk files call them


def to_trimesh(vertices: FloatArray, faces: IntArray, regions: IntArray) -> Any:
    """Make a ``trimesh.Trimesh`` with vertices in x, y, z (um), none joined or left out.

    The arrays are those of a :class:`~.mesh.Mesh`: vertices (V, 3) in Z, Y, X, faces and regions.
    Its ``face_attributes`` hold the regions as ``region_a`` and ``region_b``. Faces look away from
    the larger region number, thus outward; a wall between two cells is there once, so that only
    ``mesh.region_surface(k).to_trimesh()`` is watertight where cells share walls.
    """
    import trimesh  # slow to import

    sorted_regions = np.sort(regions, axis=1)[:, ::-1]
    made: Any = trimesh.Trimesh(
        vertices[:, ::-1],
        outward(faces, regions),
        face_attributes=dict(zip(_SIDES, sorted_regions.T, strict=True)),
        process=False,
    )
    return made


def from_trimesh(other: Any) -> tuple[FloatArray, Any, Any]:
    """Return the arrays of a mesh from a ``trimesh.Trimesh`` with vertices in x, y, z (um).

    Vertices (V, 3) in Z, Y, X, faces (F, 3) and regions (F, 2), unrepaired.

    Regions are its ``face_attributes`` ``region_a`` and ``region_b``; None if these are missing,
    which means a single region, (1, 0).

    Raises
    ------
    InputError
        If it has no triangles.
    """
    faces = getattr(other, "faces", None)
    if faces is None or not hasattr(other, "vertices"):
        raise InputError(f"a trimesh.Trimesh is needed, not {type(other).__name__}")
    given = getattr(other, "face_attributes", {})
    regions = None
    if all(side in given for side in _SIDES):
        regions = np.column_stack([np.asarray(given[side]) for side in _SIDES])
    return np.asarray(other.vertices, np.float64)[:, ::-1], np.asarray(faces), regions


def outward(faces: IntArray, regions: IntArray) -> IntArray:
    """Wind faces from the larger region number to the smaller, thus towards the outside."""
    return np.where((regions[:, 0] < regions[:, 1])[:, None], faces[:, ::-1], faces)
