"""How curved a surface is around each of its vertices."""

from __future__ import annotations

import numpy as np

from .mesh import FloatArray, Mesh


def vertex_curvature(mesh: Mesh) -> FloatArray:
    """Return (V,) magnitude of the mean curvature, 1/um, averaged over a vertex and its neighbours.

    It is a quarter of the sum of length times turn of the edges around a vertex, over a third of
    the areas of its faces (J. Steiner, 1840). Edges on junctions and borders turn for other reasons
    and are left out. Noise moves neighbouring vertices to either side, so most of it cancels.
    """
    edges, sides = mesh.edges(), mesh.face_edges().reshape(-1)
    order = np.argsort(sides, kind="stable")
    count = mesh.edge_uses()
    smooth = count == 2
    first = (np.cumsum(count) - count)[smooth]
    one, other = (order[first + k] // 3 for k in (0, 1))
    length, n = mesh.edge_lengths()[smooth], len(mesh.vertices)

    def around(values: FloatArray) -> FloatArray:
        """Sum values over each vertex and its neighbours."""
        return values + np.bincount(edges.reshape(-1), values[edges[:, ::-1]].reshape(-1), n)

    turned = np.repeat(length * _turn(mesh, one, other) / 4, 2)
    bent = np.bincount(edges[smooth].reshape(-1), turned, n).astype(float)
    area = np.bincount(mesh.faces.reshape(-1), np.repeat(mesh.areas() / 3, 3), n).astype(float)
    found: FloatArray = np.abs(around(bent)) / np.maximum(around(area), 1e-300)
    return found


def _turn(mesh: Mesh, one: np.ndarray, other: np.ndarray) -> FloatArray:
    """Return the angle (rad) by which the normal turns between two faces; negative in hollows.

    Faces of a wall may be wound either way, so the side does not matter.
    """
    normals, middles = mesh.normals(), mesh.vertices_numpy()[mesh.faces].mean(1)
    alike = np.where((mesh.regions[one] == mesh.regions[other]).all(1), 1.0, -1.0)
    first, second = normals[one], normals[other] * alike[:, None]
    cosine = np.einsum("ei,ei->e", first, second)
    away = np.einsum("ei,ei->e", first, middles[other] - middles[one])
    angle: FloatArray = np.arccos(np.clip(cosine, -1, 1))
    return np.where(away > 0, angle, -angle)
