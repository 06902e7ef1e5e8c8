"""Meshes from and to trimesh, which has x, y, z and no regions of its own."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from .files.with_trimesh import outward
from .mesh import Mesh

_SIDES = ("region_a", "region_b")  # as .ply and .vtk files call them


def to_trimesh(mesh: Mesh) -> Any:
    """A ``trimesh.Trimesh`` of a mesh, vertices in x, y, z (um), none joined or left out.

    Its ``face_attributes`` hold the regions as ``region_a`` and ``region_b``. Faces look away from
    the larger region number, thus outward; a wall between two cells is there once, so that only
    ``mesh.region_surface(k).to_trimesh()`` is watertight where cells share walls.
    """
    import trimesh  # slow to import

    faces = outward(mesh.faces, mesh.regions)
    regions = np.sort(mesh.regions, axis=1)[:, ::-1]
    made: Any = trimesh.Trimesh(
        mesh.vertices_numpy()[:, ::-1],
        faces,
        face_attributes=dict(zip(_SIDES, regions.T, strict=True)),
        process=False,
    )
    return made


def from_trimesh(other: Any) -> Mesh:
    """The mesh of a ``trimesh.Trimesh`` with vertices in x, y, z (um), unchanged and unrepaired.

    Regions are its ``face_attributes`` ``region_a`` and ``region_b``; without them all is one
    region, (1, 0).

    Raises
    ------
    InputError
        If it has no triangles, or what no :class:`~.mesh.Mesh` may have.
    """
    faces = getattr(other, "faces", None)
    if faces is None or not hasattr(other, "vertices"):
        raise InputError(f"a trimesh.Trimesh is needed, not {type(other).__name__}")
    given = getattr(other, "face_attributes", {})
    regions = None
    if all(side in given for side in _SIDES):
        regions = np.column_stack([np.asarray(given[side]) for side in _SIDES])
    return Mesh(np.asarray(other.vertices, np.float64)[:, ::-1], np.asarray(faces), regions)
