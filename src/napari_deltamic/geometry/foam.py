"""Starting surfaces from spheres: where they overlap, cells that share walls (a power diagram)."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import connected_components

from ..errors import InputError
from .labels.meshes import surfaces_of_labels
from .mesh import FloatArray, IntArray, Mesh
from .primitives import sphere
from .remeshing import can_remesh

_VOXELS_PER_EDGE = 2.5  # fine enough that walls come out smooth
_MAX_VOXELS = 60_000_000  # a typing error in edge_length would fill the memory: 0.7 GB


def foam(centers: FloatArray, radii: FloatArray, edge_length: float) -> Mesh:
    """Make one closed region for each sphere; spheres that overlap share flat walls.

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
    parts, lost = spheres_of_foam(centers, radii, edge_length)
    for number, reason in lost.items():
        raise InputError(f"sphere {number} {reason}")
    return Mesh.merge(parts)


def spheres_of_foam(
    centers: FloatArray, radii: FloatArray, edge_length: float
) -> tuple[list[Mesh], dict[int, str]]:
    """Do the work of `foam`: meshes, one a cluster, and what is wrong with each unusable sphere."""
    parts: list[Mesh] = []
    lost: dict[int, str] = {}
    for group in _overlapping(centers, radii):
        if len(group) == 1 or not can_remesh():
            for k in group:
                ball = sphere(centers[k], float(radii[k]), edge_length)
                parts.append(_numbered(ball, k + 1))
        else:
            parts += _cluster(centers, radii, group, edge_length, lost)
    return parts, lost


def _cluster(
    centers: FloatArray, radii: FloatArray, group: IntArray, edge: float, lost: dict[int, str]
) -> list[Mesh]:
    """Mesh a group of overlapping spheres; those of which nothing is left are added to ``lost``."""
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
        # The power distance is negative only within the sphere.
        box = tuple(slice(*np.searchsorted(x, (-radii[k], radii[k]))) for x in away)
        own_power = sum(x**2 for x in np.ix_(*(x[b] for x, b in zip(away, box, strict=True))))
        own_power = own_power - radii[k] ** 2
        nearer = own_power < power[box]
        labels[box][nearer] = k + 1
        power[box][nearer] = own_power[nearer]
    found = surfaces_of_labels(labels, (spacing,) * 3, tuple(low), edge, gap=0)
    for k in np.setdiff1d(group + 1, labels).tolist():
        lost[k] = "lies wholly inside others: move it, or make it larger"
    for k in found.too_small:
        lost[k] = f"is too small for edges of {edge:g} um"
    return found.meshes


def _overlapping(centers: FloatArray, radii: FloatArray) -> list[IntArray]:
    """Group the spheres that overlap."""
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=2)
    group = connected_components(apart < radii[:, None] + radii[None], directed=False)[1]
    return [np.flatnonzero(group == g) for g in np.unique(group)]


def _numbered(mesh: Mesh, region: int) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces, np.where(mesh.regions > 0, region, 0))
