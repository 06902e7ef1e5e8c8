"""Where surfaces cross themselves or each other."""

from __future__ import annotations

import numpy as np

from ..compiled import native
from ..connected import pieces
from ..mesh import FloatArray, IntArray, Mesh


def crossings(mesh: Mesh, near: float = 0.0) -> IntArray:
    """Return (n, 2) rows of an edge (in ``mesh.edges()``) and of a face that it runs through.

    Pairs no more than ``near`` um apart count as well; edges and faces that share a vertex do not.
    Empty if the compiled extension is missing.
    """
    library = native()
    if library is None:
        return np.zeros((0, 2), np.int64)
    found: IntArray = library.crossings(
        np.ascontiguousarray(mesh.vertices_numpy(), np.float64),
        np.ascontiguousarray(mesh.edges(), np.int64),
        np.ascontiguousarray(mesh.faces, np.int64),
        float(near),
    )
    return found


def crossing_corners(mesh: Mesh, near: float = 0.0) -> FloatArray:
    """Return the corners of edges and faces that cross, (n, 3) um; near : as in `crossings`."""
    found = crossings(mesh, near)
    corners = np.concatenate([mesh.edges()[found[:, 0]], mesh.faces[found[:, 1]]], axis=1)
    return mesh.vertices_numpy()[np.unique(corners)]


def crosses(mesh: Mesh) -> bool:
    """Whether a surface crosses itself or another; False if the extension is missing."""
    return len(crossings(mesh)) > 0


class CrossingWalls:
    """The walls of a mesh that cross, and their regions.

    A wall is all faces of one connected piece between the same two regions.

    Attributes
    ----------
    regions
        For each pair of walls that cross, the larger region number of each wall; only one number if
        both are the same.
    wall
        (F,) number of each face's wall.
    pairs
        (W, W) bool: walls that cross each other.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.regions: set[tuple[int, ...]] = set()
        self.wall: IntArray = np.zeros(len(mesh.faces), np.int64)
        self.pairs = np.zeros((0, 0), bool)
        found = crossings(mesh)
        if not len(found):
            return
        rows = np.column_stack([pieces(mesh)[mesh.faces[:, 0]], mesh.interfaces()[1]])
        walls, wall = np.unique(rows, axis=0, return_inverse=True)
        self.wall = wall.reshape(-1).astype(np.int64)
        self.pairs = np.zeros((len(walls), len(walls)), bool)
        name = mesh.interfaces()[0][walls[:, 1], 0]
        edge_of_face = mesh.face_edges().reshape(-1)
        order = np.argsort(edge_of_face, kind="stable")
        starts = np.searchsorted(edge_of_face[order], [found[:, 0], found[:, 0] + 1])
        for (first, last), face in zip(starts.T, found[:, 1], strict=True):
            one, other = self.wall[order[first:last] // 3], self.wall[face]
            self.pairs[one, other] = self.pairs[other, one] = True
            self.regions |= {tuple(sorted({int(name[k]), int(name[other])})) for k in one}

    def __bool__(self) -> bool:
        return bool(self.regions)
