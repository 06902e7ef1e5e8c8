"""Divides a region of a mesh into two, or removes one: a cell divides, or leaves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import InputError
from ..mesh import OUTSIDE, FloatArray, IntArray, Mesh, mesh_of_faces
from ..remeshing import can_remesh, remesh

_LEAST_AROUND = 12  # edges around a new wall
# Edge lengths: vertices nearer to a plane count as in it, which avoids slivers. Junctions have a
# smaller one, or the new wall could run along a junction, where four walls would meet.
_ON_PLANE, _ON_PLANE_IN_JUNCTION = 0.25, 0.01


def divide_region(
    mesh: Mesh, region: int, point: ArrayLike, normal: ArrayLike, daughters: tuple[int, int]
) -> Mesh:
    """Cut a region by a plane into two, with a shared wall of good triangles between them.

    Faces that the plane cuts are split, and the daughters' surfaces remeshed; no other vertex
    moves.

    Parameters
    ----------
    mesh : um; the region's surface must be closed.
    region : the one that divides.
    point, normal : of the plane, (3,) um Z, Y, X.
    daughters : numbers of the regions behind the plane and in front of it, where the normal
        points. One of them may be that of the region itself.

    Raises
    ------
    InputError
        If there is no such region, its surface is open, a daughter's number is taken, or the
        plane does not cut it in just one loop.
    """
    place, direction = np.asarray(point, float), np.asarray(normal, float)
    if not (np.isfinite(place).all() and np.linalg.norm(direction) > 0):
        raise InputError("a plane needs a finite point and a normal that is not zero")
    is_closed = mesh.is_closed(region)
    taken = set(mesh.region_ids().tolist()) - {region}
    if len(set(daughters)) != 2 or taken & set(daughters) or min(daughters) < 1:
        raise InputError(f"the daughters of region {region} need two numbers that are free")
    if not is_closed:
        raise InputError(f"the surface of region {region} is not closed, so it cannot be cut")
    direction = direction / np.linalg.norm(direction)
    cut, front = _split(mesh, region, place, direction)
    loop = _loop(cut, region, front)
    wall = _wall(cut.vertices_numpy(), loop, direction)
    own = cut.regions == region
    names = np.where(front, daughters[1], daughters[0])[:, None]
    regions = np.concatenate(
        [np.where(own, names, cut.regions), np.tile(daughters, (len(wall), 1))]
    )
    divided = Mesh(cut.vertices, np.concatenate([cut.faces, wall]), regions)
    around = divided.vertices_numpy()[[*loop, loop[0]]]
    return _renewed(
        divided, daughters, float(np.linalg.norm(np.diff(around, axis=0), axis=1).sum())
    )


def remove_region(mesh: Mesh, region: int) -> Mesh | None:
    """Remove a region; the other sides of its walls then face the outside.

    Returns None if nothing is left. Raises InputError if the mesh has no such region.
    """
    if region not in mesh.region_ids():
        raise InputError(f"the mesh has no region {region}")
    regions = np.where(mesh.regions == region, OUTSIDE, mesh.regions)
    kept = regions[:, 0] != regions[:, 1]
    if not kept.any():
        return None
    return mesh_of_faces(mesh.vertices_numpy(), mesh.faces[kept], regions[kept])[0]


def _split(
    mesh: Mesh, region: int, point: FloatArray, normal: FloatArray
) -> tuple[Mesh, NDArray[np.bool_]]:
    """Split the region's faces at a plane; also return which faces lie in front of it."""
    vertices, edges, face_edges = mesh.vertices_numpy(), mesh.edges(), mesh.face_edges()
    height = (vertices - point) @ normal
    own = (mesh.regions == region).any(axis=1)
    near = np.full(len(vertices), _ON_PLANE)
    near[edges[mesh.edge_uses() > 2]] = _ON_PLANE_IN_JUNCTION
    near *= float(np.median(mesh.edge_lengths()[np.unique(face_edges[own])]))
    side = np.where(np.abs(height) < near, 0, np.sign(height)).astype(int)
    crossing = np.zeros(len(edges), bool)
    crossing[np.unique(face_edges[own])] = True
    crossing &= side[edges[:, 0]] * side[edges[:, 1]] < 0
    start, end = edges[crossing].T
    share = height[start] / (height[start] - height[end])
    added = vertices[start] + share[:, None] * (vertices[end] - vertices[start])
    middle = np.full(len(edges), -1)
    middle[crossing] = len(vertices) + np.arange(len(start))
    faces, parents = _subdivided(mesh.faces, middle[face_edges])
    height = np.concatenate([height * (side != 0), np.zeros(len(start))])
    front = height[faces].sum(axis=1) > 0
    return Mesh(np.concatenate([vertices, added]), faces, mesh.regions[parents]), front


def _subdivided(faces: IntArray, middle: IntArray) -> tuple[IntArray, IntArray]:
    """Cut faces at new vertices on their edges (one opposite each corner; -1: none).

    Also return which face each part belongs to.
    """
    count = (middle >= 0).sum(axis=1)
    rows = np.flatnonzero(count == 0)
    parts, parents = [faces[rows]], [rows]
    for row in np.flatnonzero(count):
        ring: list[int] = []
        for corner in range(3):
            ring.append(int(faces[row, corner]))
            between = int(middle[row, (corner + 2) % 3])  # opposite the corner after the next
            ring += [between] if between >= 0 else []
        # A fan from a new vertex never has three corners on one edge of the face.
        first = next(k for k, vertex in enumerate(ring) if vertex in middle[row])
        ring = ring[first:] + ring[:first]
        fan = [(ring[0], ring[k], ring[k + 1]) for k in range(1, len(ring) - 1)]
        parts.append(np.array(fan, np.int64))
        parents.append(np.full(len(fan), row))
    return np.concatenate(parts), np.concatenate(parents)


def _loop(mesh: Mesh, region: int, front: NDArray[np.bool_]) -> list[int]:
    """Return the vertices around the cut, in order."""
    own = (mesh.regions == region).any(axis=1)
    sides = np.zeros((len(mesh.edges()), 2), int)
    np.add.at(sides, (mesh.face_edges()[own].ravel(), np.repeat(front[own], 3).astype(int)), 1)
    edges = mesh.edges()[(sides == 1).all(axis=1)]
    if not len(edges):
        raise InputError(f"the plane does not cut region {region}")
    nexts: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        nexts.setdefault(a, []).append(b)
        nexts.setdefault(b, []).append(a)
    if any(len(ends) != 2 for ends in nexts.values()):
        raise InputError(f"the plane touches region {region} without cutting it cleanly")
    loop, last = [int(edges[0, 0])], -1
    while True:
        ends = nexts[loop[-1]]
        follower = ends[0] if ends[0] != last else ends[1]
        last = loop[-1]
        if follower == loop[0]:
            break
        loop.append(follower)
    if len(loop) != len(nexts):
        raise InputError(f"the plane cuts region {region} more than once")
    return loop


def _wall(vertices: FloatArray, loop: Sequence[int], normal: FloatArray) -> IntArray:
    """Triangulate the polygon by ear clipping, with normals along that of the plane."""
    axis = np.eye(3)[np.abs(normal).argmin()]
    across = np.cross(normal, axis)
    across /= np.linalg.norm(across)
    flat = vertices[list(loop)] @ np.stack([across, np.cross(normal, across)], axis=1)
    left = list(range(len(loop)))
    if _signed_area(flat) < 0:
        left.reverse()
    triangles = []
    while len(left) > 3:
        k = _best_ear(flat, left)
        triangles.append([left[k - 1], left[k], left[(k + 1) % len(left)]])
        left.pop(k)
    triangles.append(left)
    faces = np.asarray(loop)[np.array(triangles)]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    # In Z, Y, X a face's normal is minus the cross product; see Mesh.
    if float((np.cross(b - a, c - a) @ normal).sum()) > 0:
        faces = faces[:, ::-1]
    return np.asarray(faces, np.int64)


def _best_ear(flat: FloatArray, left: list[int]) -> int:
    """Return the corner that can be cut off with the best triangle."""
    ring = flat[left]
    before, after = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
    area = _cross(ring - before, after - before)
    sides = [((p - q) ** 2).sum(1) for p, q in ((ring, before), (after, ring), (before, after))]
    quality = area / np.maximum(np.sum(sides, axis=0), 1e-300)
    for k in np.argsort(-quality):
        others = np.roll(ring, 1 - k, axis=0)[3:]
        if area[k] > 0 and not _inside(others, (before[k], ring[k], after[k])).any():
            return int(k)
    return int(np.argmax(quality))  # the polygon crosses itself: any order is as good


def _inside(points: FloatArray, corners: tuple[FloatArray, ...]) -> NDArray[np.bool_]:
    if not len(points):
        return np.zeros(0, bool)
    inside = np.ones(len(points), bool)
    for k in range(3):
        start, end = corners[k], corners[(k + 1) % 3]
        inside &= _cross(np.broadcast_to(end - start, points.shape), points - start) >= 0
    return inside


def _cross(p: FloatArray, q: FloatArray) -> FloatArray:
    area: FloatArray = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    return area


def _signed_area(ring: FloatArray) -> float:
    return float(_cross(ring, np.roll(ring, -1, axis=0)).sum())


def _renewed(mesh: Mesh, daughters: tuple[int, int], around: float) -> Mesh:
    """Remesh the daughters, including junctions, to good triangles; other vertices stay."""
    if not can_remesh():
        return mesh
    own = np.isin(mesh.regions, daughters).any(axis=1)
    wall = np.isin(mesh.regions, daughters).all(axis=1)
    fixed = np.ones(len(mesh.vertices), bool)
    fixed[mesh.faces[own]] = False
    length = float(np.median(mesh.edge_lengths()[np.unique(mesh.face_edges()[~wall])]))
    length = min(length, around / _LEAST_AROUND)
    return remesh(mesh, length, passes=3, fixed=fixed).mesh
