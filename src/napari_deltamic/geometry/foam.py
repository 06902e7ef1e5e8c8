"""Starting surfaces from spheres: where they overlap, cells that share walls (a power diagram)."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import connected_components

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.labels.meshes import mesh_from_labels
from napari_deltamic.geometry.mesh import FloatArray, IntArray, Mesh
from napari_deltamic.geometry.primitives import sphere
from napari_deltamic.geometry.remeshing import can_remesh

_VOXELS_PER_EDGE = 2.5  # fine enough that walls come out smooth
_MAX_VOXELS = 60_000_000


def foam(centers: FloatArray, radii: FloatArray, edge_length: float) -> Mesh:
    """One closed region for each sphere; those that overlap share flat walls.

    A point in several spheres belongs to the one with the smallest power distance
    ``|x - center|^2 - radius^2`` (F. Aurenhammer, "Power diagrams", SIAM J. Comput. 16, 1987).

    Parameters
    ----------
    centers : (n, 3) um, Z, Y, X.
    radii : (n,) um, positive.
    edge_length : um.

    Returns
    -------
    Mesh with regions 1 to n in the order of the spheres.

    Raises
    ------
    InputError
        If a sphere lies so deep in others that nothing is left of it.
    """
    parts = []
    for group in _overlapping(centers, radii):
        if len(group) == 1 or not can_remesh():
            for k in group:
                ball = sphere(centers[k], float(radii[k]), edge_length)
                parts.append(_numbered(ball, k + 1))
        else:
            parts.append(_cluster(centers, radii, group, edge_length))
    return Mesh.merge(parts)


def _cluster(centers: FloatArray, radii: FloatArray, group: IntArray, edge: float) -> Mesh:
    spacing = edge / _VOXELS_PER_EDGE
    own, reach = centers[group], radii[group, None]
    low, high = (own - reach).min(0) - 2 * spacing, (own + reach).max(0) + 2 * spacing
    shape = np.ceil((high - low) / spacing).astype(int) + 1
    if np.prod(shape.astype(float)) > _MAX_VOXELS:
        raise InputError(f"edges of {edge:g} um are too short for spheres as large as these")
    labels = np.zeros(shape, np.int32)
    power = np.zeros(shape)
    axes = [a + spacing * np.arange(n) for a, n in zip(low, shape, strict=True)]
    for k in group:
        away = [axis - c for axis, c in zip(axes, centers[k], strict=True)]
        own_power = sum(x**2 for x in np.ix_(*away)) - radii[k] ** 2
        nearer = own_power < power
        labels[nearer] = k + 1
        power[nearer] = own_power[nearer]
    lost = np.setdiff1d(group + 1, labels)
    if len(lost):
        raise InputError(f"sphere {lost[0]} lies wholly inside others: move it, or make it larger")
    return mesh_from_labels(labels, (spacing,) * 3, tuple(low), edge, gap=0)


def _overlapping(centers: FloatArray, radii: FloatArray) -> list[IntArray]:
    """Groups of spheres that overlap."""
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=2)
    group = connected_components(apart < radii[:, None] + radii[None], directed=False)[1]
    return [np.flatnonzero(group == g) for g in np.unique(group)]


def _numbered(mesh: Mesh, region: int) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces, np.where(mesh.regions > 0, region, 0))
