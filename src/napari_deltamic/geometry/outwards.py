"""Outward directions at the vertices of a surface."""

from __future__ import annotations

import numpy as np

from .mesh import OUTSIDE, FloatArray, Mesh


def outwards(mesh: Mesh) -> FloatArray:
    """Return (V, 3) unit normals towards the outside (region 0); 0 at vertices not on it."""
    return -out_of(mesh, OUTSIDE)


def out_of(mesh: Mesh, region: int) -> FloatArray:
    """Return (V, 3) unit normals out of a region, averaged by area; 0 at vertices not on it."""
    sign = (mesh.regions[:, 0] == region).astype(float) - (mesh.regions[:, 1] == region)
    each = mesh.normals() * (sign * mesh.areas())[:, None]
    rows, n = mesh.faces.T.ravel(), len(mesh.vertices)
    summed = np.stack([np.bincount(rows, np.tile(one, 3), n) for one in each.T], 1)
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    return np.divide(summed, length, out=np.zeros_like(summed), where=length > 0)
