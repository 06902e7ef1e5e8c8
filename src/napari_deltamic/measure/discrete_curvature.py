"""Mean and Gaussian curvature of triangulated cells and walls, summed over them.

Both are sums that hold on any mesh, not values at points, which scatter with the triangles:

* For a whole cell, mean curvature sits in the edges: ``1/2 sum of length * turn``, with the angle
  by which the outward normal turns across the edge (J. Steiner, 1840; exact for a polyhedron, so
  ridges along junctions count). Gaussian curvature sits in the vertices: ``2 pi - sum of angles``;
  over a closed surface it adds up to ``2 pi`` times the Euler characteristic (Gauss-Bonnet).
* For a wall, the mean curvature is the change of area as its vertices move along the normal:
  ``1/2 sum of K . n`` with ``K = 1/2 sum over edges of (cot a + cot b) (x_i - x_j)`` (M. Meyer et
  al., "Discrete differential-geometry operators for triangulated 2-manifolds", 2003), over the
  vertices inside the wall, whose surroundings are whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import nan

import numpy as np

from ..geometry.connected import sharing
from ..geometry.mesh import FloatArray, IntArray, Mesh
from .sides import Sides


@dataclass(frozen=True, eq=False)
class CellCurvature:
    """Curvature of each cell, (C,).

    mean : um; integral of the mean curvature over the surface, ridges included.
    gaussian : integral of the Gaussian curvature.
    parts : number of separate surfaces that the cell has.

    NaN where the surface is not closed, or where more than two of its faces meet at an edge.
    """

    mean: FloatArray
    gaussian: FloatArray
    parts: IntArray


@dataclass(frozen=True, eq=False)
class WallCurvature:
    """Curvature of each wall, (W,), in the order of ``mesh.interfaces()``.

    mean : 1/um; the average inside the wall, positive where it bulges out of the pair's first
        region.
    gaussian : 1/um^2; the average inside the wall.
    inside : number of vertices inside the wall; if 0, the others are NaN.
    """

    mean: FloatArray
    gaussian: FloatArray
    inside: IntArray


def cell_curvature(sides: Sides) -> CellCurvature:
    """Integrate the curvature over the whole surface of each cell."""
    mesh = sides.mesh
    n = len(sides.cells)
    cell, _, count = sides.edges
    usable = np.bincount(cell, count != 2, n) == 0
    mean = np.where(usable, _turning(sides), nan)
    corner_cell = np.repeat(sides.cell, 3)
    vertices = mesh.faces[sides.face].reshape(-1)
    keys, index = np.unique(corner_cell * len(mesh.vertices) + vertices, return_inverse=True)
    n_vertices = np.bincount(keys // len(mesh.vertices), minlength=n)
    angles = np.bincount(corner_cell, corner_angles(mesh)[sides.face].reshape(-1), n)
    gaussian = np.where(usable, 2 * np.pi * n_vertices - angles, nan)
    piece = sharing(index.reshape(-1, 3), len(keys))
    first = np.unique(piece, return_index=True)[1]
    return CellCurvature(mean, gaussian, np.bincount(sides.cell[first], minlength=n))


def wall_curvature(mesh: Mesh) -> WallCurvature:
    """Average the curvature over the inside of each wall."""
    pairs, wall = mesh.interfaces()
    n, size = len(pairs), len(mesh.vertices)
    corner_wall, vertices = np.repeat(wall, 3), mesh.faces.reshape(-1)
    keys, index = np.unique(corner_wall * size + vertices, return_inverse=True)
    inside = ~np.isin(keys, _rim(mesh, wall))

    def at(values: FloatArray) -> FloatArray:
        """Sum values of corners (F, 3) over the faces of a wall around each of its vertices."""
        return np.bincount(index, values.reshape(-1), len(keys)).astype(np.float64)

    areas = mesh.areas()
    # Out of the pair's first region.
    out = np.where(mesh.regions[:, 0] == pairs[wall, 0], 1.0, -1.0)
    normals = mesh.normals() * out[:, None]
    pull = np.stack([at(c) for c in np.moveaxis(_area_gradient(mesh, normals, out), 2, 0)], 1)
    each = np.repeat(areas[:, None] / 3, 3, 1)
    normal = np.stack([at(each * c[:, None]) for c in normals.T], 1)
    length = np.linalg.norm(normal, axis=1)
    along = np.einsum("vi,vi->v", pull, normal) / np.where(length > 0, length, 1)
    deficit = 2 * np.pi - at(corner_angles(mesh))
    own, kept = keys // size, inside.astype(float)
    area = np.bincount(own, kept * at(each), n)
    area = np.where(area > 0, area, nan)
    mean = np.bincount(own, kept * along / 2, n) / area
    gaussian = np.bincount(own, kept * deficit, n) / area
    return WallCurvature(mean, gaussian, np.bincount(own[inside], minlength=n))


def corner_angles(mesh: Mesh) -> FloatArray:
    """Return (F, 3) the angle of each face at each of its corners, radians."""
    corners = mesh.vertices_numpy()[mesh.faces]
    one = np.roll(corners, -1, axis=1) - corners
    other = np.roll(corners, 1, axis=1) - corners
    sine = np.linalg.norm(np.cross(one, other), axis=2)
    found: FloatArray = np.arctan2(sine, np.einsum("fki,fki->fk", one, other))
    return found


def _turning(sides: Sides) -> FloatArray:
    """Return (C,) half the sum over edges of length times turn of the outward normal, um."""
    turn, length = _hinges(sides)
    cell = sides.hinges[0]
    return np.bincount(cell, length * turn / 2, len(sides.cells)).astype(np.float64)


def _hinges(sides: Sides) -> tuple[FloatArray, FloatArray]:
    """Return the turn of the outward normal across each hinge, radians, and its length, um."""
    mesh = sides.mesh
    v = mesh.vertices_numpy()
    _, edge, one, other = sides.hinges
    ends = mesh.edges()[edge]
    normals = mesh.normals()[sides.face] * sides.sign[:, None]
    first, second = normals[one], normals[other]
    middle = v[ends].mean(1)
    beyond = v[mesh.faces[sides.face[other]]].mean(1) - middle
    back = v[mesh.faces[sides.face[one]]].mean(1) - middle
    # A ridge if each face lies below the plane of the other; where they fold onto each other,
    # neither is clear alone, so the two are added.
    bulges = np.einsum("hi,hi->h", first, beyond) + np.einsum("hi,hi->h", second, back)
    sine = np.linalg.norm(np.cross(first, second), axis=1)
    turn = np.arctan2(sine, np.einsum("hi,hi->h", first, second))
    length = mesh.edge_lengths()[edge]
    return np.where(bulges > 0, -turn, turn), length


def _area_gradient(mesh: Mesh, normals: FloatArray, out: FloatArray) -> FloatArray:
    """Return (F, 3, 3) the derivative of each face's area by each of its corners, um."""
    corners = mesh.vertices_numpy()[mesh.faces]
    opposite = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)
    # At right angles to the opposite edge, towards the corner, half as long; Z, Y, X components
    # are left-handed.
    found: FloatArray = -0.5 * np.cross(normals[:, None] * out[:, None, None], opposite)
    return found


def _rim(mesh: Mesh, wall: IntArray) -> IntArray:
    """Return keys (wall * vertices + vertex) of the vertices on the rim of their wall."""
    edges = mesh.edges()
    keys, count = np.unique(
        (wall[:, None] * len(edges) + mesh.face_edges()).reshape(-1), return_counts=True
    )
    own, edge = np.divmod(keys[count != 2], len(edges))
    return np.unique(own[:, None] * len(mesh.vertices) + edges[edge])
