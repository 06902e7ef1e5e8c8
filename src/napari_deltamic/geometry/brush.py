"""Tools for changing a mesh by hand: where it is touched, and how far each vertex follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .connected import connected
from .mesh import OUTSIDE, FloatArray, IntArray, Mesh
from .outwards import out_of


@dataclass(frozen=True, eq=False)
class Touch:
    """A point of a surface.

    point : (3,) um, Z, Y, X.
    face : index of the face that it lies in.
    """

    point: FloatArray
    face: int


def touched_by_ray(mesh: Mesh, start: FloatArray, direction: FloatArray) -> Touch | None:
    """Find the first point at which a line meets a mesh.

    Parameters
    ----------
    mesh : any mesh, um.
    start : (3,) um, any point of the line; points of the mesh before it count as well.
    direction : (3,) the direction of view along the line; any length but 0.

    Returns
    -------
    The touch, or None where the line misses the mesh.

    Notes
    -----
    T. Moeller, B. Trumbore, "Fast, minimum storage ray/triangle intersection", J. Graphics Tools 2,
    1997, for all faces at once.
    """
    start, direction = np.asarray(start, np.float64), np.asarray(direction, np.float64)
    length = float(np.linalg.norm(direction))
    if not length > 0:
        raise InputError("a line needs a direction")
    direction = direction / length
    corners = mesh.vertices_numpy()[mesh.faces]
    a = corners[:, 0]
    ab, ac = corners[:, 1] - a, corners[:, 2] - a
    across = np.cross(direction, ac)
    size = np.einsum("fi,fi->f", ab, across)
    seen = np.flatnonzero(np.abs(size) > 0)  # not edge-on
    if not len(seen):
        return None
    a, ab, ac, across, size = a[seen], ab[seen], ac[seen], across[seen], size[seen]
    away = start - a
    u = np.einsum("fi,fi->f", away, across) / size
    turned = np.cross(away, ab)
    v = turned @ direction / size
    distance = np.einsum("fi,fi->f", turned, ac) / size
    inside = np.flatnonzero((u >= 0) & (v >= 0) & (u + v <= 1))
    if not len(inside):
        return None
    nearest = inside[distance[inside].argmin()]
    return Touch(start + distance[nearest] * direction, int(seen[nearest]))


def touched_on_section(
    segments: FloatArray, faces: IntArray, axis: int, point: FloatArray, reach: float
) -> Touch | None:
    """Find the point of a contour nearest to a point of its plane.

    Parameters
    ----------
    segments, faces : (S, 2, 2) um and (S,): a section, see ``measure.section``.
    axis : perpendicular to the plane.
    point : (3,) um, in the plane.
    reach : um; a contour farther away than this is not touched.

    Returns
    -------
    The touch, or None where the contour is farther away than that.
    """
    if not len(segments):
        return None
    others = [k for k in range(3) if k != axis]
    places, distance = nearest_on_segments(segments, point[others])
    nearest = int(distance.argmin())
    if distance[nearest] > reach:
        return None
    on_contour = np.array(point, np.float64)
    on_contour[others] = places[nearest]
    return Touch(on_contour, int(faces[nearest]))


def nearest_on_segments(segments: FloatArray, point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the point (S, 2) of each segment (S, 2, 2) nearest to a point (2,), and how far it is.

    Distances are (S,).
    """
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    length = np.maximum((along**2).sum(axis=1), 1e-300)
    share = np.clip(((point - start) * along).sum(axis=1) / length, 0, 1)
    places: FloatArray = start + share[:, None] * along
    return places, np.linalg.norm(places - point, axis=1)


def falloff(mesh: Mesh, touch: Touch, radius: float) -> FloatArray:
    """Return the share of a displacement that each vertex follows.

    ``(1 - (d / r)^2)^2`` with the distance d from the touch: 1 there, and flat at both ends. Only
    vertices connected with the touched face within the radius r move, so the far side of a thin
    cell stays. If no vertex is that near, the brush grows to reach those of the touched face.

    Parameters
    ----------
    mesh : um.
    touch : where the mesh is touched.
    radius : um, positive.

    Returns
    -------
    (V,) between 0 and 1.
    """
    if not radius > 0:
        raise InputError("a brush needs a positive radius")
    vertices, corners = mesh.vertices_numpy(), mesh.faces[touch.face]
    distance = np.linalg.norm(vertices - touch.point, axis=1)
    radius = max(radius, 2 * float(distance[corners].min()))
    within = distance < radius
    weights = np.where(within, (1 - (distance / radius) ** 2) ** 2, 0.0)
    weights[~_together(mesh, within, corners)] = 0
    return weights


def _together(mesh: Mesh, within: np.ndarray, corners: IntArray) -> np.ndarray:
    """Return (V,) bool: which vertices of a set are connected with some corners."""
    within = within.copy()
    within[corners] = True
    edges = mesh.edges()
    edges = edges[within[edges].all(axis=1)]
    piece = connected(edges, len(within))
    return within & (piece == piece[corners[0]])


def outward(mesh: Mesh, face: int) -> FloatArray:
    """Return unit normals at the vertices, pointing out of the region that a face bounds.

    Weighted by area. A face between two cells bounds the one that its normal points out of.

    Returns
    -------
    (V, 3) Z, Y, X; 0 at vertices that are not on the region's surface.
    """
    inner, outer = (int(r) for r in mesh.regions[face])
    return out_of(mesh, outer if inner == OUTSIDE else inner)
