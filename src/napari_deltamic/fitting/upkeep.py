"""Triangles stay good while a surface is moved far: when to remesh, and what goes along."""

from __future__ import annotations

import numpy as np

from ..geometry.mesh import Mesh
from ..geometry.remeshing import Remeshed, can_remesh, remesh, smallest_angles

_BAD_ANGLE = 15.0  # degrees
_MANY = 0.02  # share of bad triangles from which on the mesh is remeshed
# The median edge may grow by this factor over that of the start, where a surface grew: details
# need vertices, but a seed that is far too small should not end with a million of them.
_GROWTH = 1.5


class Upkeep:
    """Remeshes a surface when too many of its triangles have become slivers.

    The edge length is that which the surface had at the start: the user's choice.
    """

    def __init__(self, mesh: Mesh) -> None:
        # A face with one corner twice has no third edge to split, collapse or flip.
        corners = np.sort(mesh.faces, axis=1)
        whole = bool((corners[:, 1:] != corners[:, :-1]).all())
        self.able = can_remesh() and whole
        self._start = median_edge(mesh)
        self.left = 0.0  # share of slivers that the last remeshing left: no use to try again

    def wanted(self, mesh: Mesh) -> bool:
        """Whether the mesh has too many slivers."""
        return self.able and _slivers(mesh) > self.left + _MANY

    def renewed(
        self, mesh: Mesh, carried: np.ndarray, fixed: np.ndarray, apart: bool = False
    ) -> Remeshed:
        """The mesh with better triangles; numbers of its vertices and fixed ones go along.

        ``apart``: surfaces that do not cross stay so.
        """
        length = min(max(median_edge(mesh), self._start), _GROWTH * self._start)
        done = remesh(mesh, length, passes=3, carried=carried, fixed=fixed, apart=apart)
        self.left = _slivers(done.mesh)
        return done

    def refused(self, mesh: Mesh) -> None:
        """The mesh was kept as it was: it is tried again when more slivers have come."""
        self.left = _slivers(mesh)


def _slivers(mesh: Mesh) -> float:
    return float((smallest_angles(mesh) < _BAD_ANGLE).mean())


def median_edge(mesh: Mesh) -> float:
    """um."""
    ends = mesh.vertices_numpy()[mesh.edges()]
    return float(np.median(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)))
