"""Two spheres that share a flat wall: the simplest cluster, whose shape is known exactly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.mesh import FloatArray, Mesh
from napari_deltamic.geometry.remeshing import can_remesh, remesh

_ROUNDS = 3  # of remeshing and putting back. Measured: after none the least angle is 28, then 31


def joined_spheres(
    center: Sequence[float] | FloatArray,
    radii: tuple[float, float],
    distance: float,
    edge_length: float,
) -> Mesh:
    """Two spheres along X, cut off by the plane in which they meet.

    With equal radii at a distance of one radius this is the double bubble of equal volumes, whose
    walls meet at 120 degrees.

    Parameters
    ----------
    center : (3,) um, Z, Y, X: where the plane of the wall meets the axis.
    radii : um; of region 1, at lower X, and of region 2.
    distance : um; between the centres.
    edge_length : um.

    Raises
    ------
    InputError
        If the spheres do not meet in a circle.
    """
    first, second = radii
    if not abs(first - second) < distance < first + second:
        raise InputError("joined spheres must meet in a circle: change radii or distance")
    # The plane of equal power lies here on the axis, from the centre of the first.
    wall = (distance**2 + first**2 - second**2) / (2 * distance)
    centers = np.array([[0.0, 0.0, -wall], [0.0, 0.0, distance - wall]])
    mesh = foam(centers, np.array(radii), edge_length)
    rounds = _ROUNDS if can_remesh() else 0
    mesh = _projected(mesh, centers, radii)
    for _ in range(rounds):
        mesh = _projected(remesh(mesh, edge_length, passes=2).mesh, centers, radii)
    return mesh.translated(center)


def _projected(mesh: Mesh, centers: FloatArray, radii: tuple[float, float]) -> Mesh:
    """Every vertex on the sphere, the plane or the circle that it belongs to."""
    v = mesh.vertices_numpy().copy()
    touches = np.zeros((len(v), 3), bool)  # the outer walls of regions 1 and 2, the shared wall
    kinds = np.where((mesh.regions != 0).all(1), 2, mesh.regions.max(1) - 1)
    np.logical_or.at(touches, (mesh.faces, kinds[:, None]), True)
    wall, several = touches[:, 2], touches.sum(1) > 1
    v[wall, 2] = 0
    rim = np.sqrt(radii[0] ** 2 - centers[0, 2] ** 2)
    v[several, :2] *= rim / np.linalg.norm(v[several, :2], axis=1)[:, None]
    for k in (0, 1):
        cap = touches[:, k] & ~several
        d = v[cap] - centers[k]
        v[cap] = centers[k] + d * (radii[k] / np.linalg.norm(d, axis=1)[:, None])
    return mesh.with_vertices(v)
