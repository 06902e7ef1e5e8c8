"""Values at the vertices of a mesh, carried to another triangulation of the same surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .mesh import Mesh


def same_triangles(a: Mesh, b: Mesh) -> bool:
    """Whether two meshes have the same faces, so that equal indices mean the same vertex."""
    return a.faces is b.faces or (
        len(a.vertices) == len(b.vertices) and np.array_equal(a.faces, b.faces)
    )


def carried(values: NDArray[Any], before: Mesh, after: Mesh) -> NDArray[Any]:
    """Carry values (V, ...) at the vertices of a mesh to those of another triangulation, (V', ...).

    Each vertex takes the value of the nearest old one: remeshing leaves the surface where it is.
    """
    if same_triangles(before, after):
        return values
    nearest = cKDTree(before.vertices_numpy()).query(after.vertices_numpy())[1]
    taken: NDArray[Any] = values[nearest]
    return taken
