"""Where the topology of a mesh is about to change: thin regions, and walls that hardly exist."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from napari_deltamic.geometry.mesh import FloatArray, IntArray, Mesh
from napari_deltamic.geometry.native import native

_ACROSS = 0.7  # cosine: the way to the other side runs along its normal
_FACING = -0.5  # cosine: the two sides look away from each other
_FEWEST = 2  # vertices that make a place


@dataclass(frozen=True, eq=False)
class ThinPlace:
    """A place where regions are thin.

    Attributes
    ----------
    regions
        The thin one, 0 for a gap between cells or a hole through one; or the two of a small wall.
    sides
        What lies around, smaller numbers first; only one for a neck or a hole.
    points
        (n, 3) um: midway between the sides.
    width
        um: the mean distance of the sides there.
    """

    regions: tuple[int, ...]
    sides: tuple[int, ...]
    points: FloatArray
    width: float

    @property
    def center(self) -> FloatArray:
        """(3,) um."""
        mean: FloatArray = self.points.mean(axis=0)
        return mean


def thin_places(mesh: Mesh, reach: float, apart: float | None = None) -> list[ThinPlace]:
    """Places where a region is thinner than ``reach`` um.

    The corner between two walls along the junction in which they meet is none.

    Parameters
    ----------
    mesh
        Closed regions.
    reach
        um; well below the length of the edges.
    apart
        um: what lies further away is another place. Default: five times the reach.
    """
    found = _facing(mesh, reach)
    if not len(found.points):
        return []
    places = []
    names, group = np.unique(
        np.column_stack([found.region, np.sort(found.sides, axis=1)]), axis=0, return_inverse=True
    )
    for k, (region, one, other) in enumerate(names.tolist()):
        own = np.flatnonzero(group.reshape(-1) == k)
        for part in _near_each_other(found.points[own], 5 * reach if apart is None else apart):
            rows = own[part]
            if len(np.unique(found.vertex[rows])) < _FEWEST:
                continue
            width = float(found.width[rows].mean())
            sides = tuple(sorted({one, other}))
            places.append(ThinPlace((region,), sides, found.points[rows], width))
    return places


def small_walls(mesh: Mesh, area: float) -> list[ThinPlace]:
    """Pieces of walls between two cells that are smaller than ``area`` um^2."""
    pairs, wall = mesh.interfaces()
    rows = np.flatnonzero((pairs[wall] > 0).all(1))
    if not len(rows):
        return []
    edge = mesh.face_edges()[rows]
    key = (wall[rows][:, None] * len(mesh.edges()) + edge).reshape(-1)
    _, node = np.unique(key, return_inverse=True)
    face, n = np.repeat(np.arange(len(rows)), 3), len(rows)
    size = n + int(node.max()) + 1
    graph = coo_matrix((np.ones(len(face)), (face, n + node.reshape(-1))), shape=(size, size))
    piece = connected_components(graph, directed=False)[1][:n]
    areas = np.bincount(piece, mesh.areas()[rows])
    meet = _regions_at(mesh)
    places = []
    for k in np.flatnonzero((areas < area) & (areas > 0)):
        own = rows[piece == k]
        one, other = (int(r) for r in pairs[wall[own[0]]])
        corners = np.unique(mesh.faces[own])
        around = np.flatnonzero(meet[corners].any(0)).tolist()
        sides = tuple(sorted(set(around) - {one, other}))
        if sides:
            points = np.concatenate(
                [mesh.vertices_numpy()[corners], mesh.vertices_numpy()[mesh.faces[own]].mean(1)]
            )
            places.append(ThinPlace((other, one), sides, points, float(np.sqrt(areas[k]))))
    return places


@dataclass(frozen=True, eq=False)
class _Facing:
    """Vertices that face a face across a region; an entry of each array for each such pair."""

    vertex: IntArray
    region: IntArray
    sides: IntArray
    points: FloatArray
    width: FloatArray


def _facing(mesh: Mesh, reach: float) -> _Facing:
    places, faces, regions, normals = (
        mesh.vertices_numpy(),
        mesh.faces,
        mesh.regions,
        mesh.normals(),
    )
    library = native()
    none = np.zeros(0, np.int64)
    if library is None:
        return _Facing(none, none, none.reshape(0, 2), np.zeros((0, 3)), np.zeros(0))
    used = np.unique(faces)
    pairs, point = library.near_faces(
        np.ascontiguousarray(places[used]),
        np.ascontiguousarray(places),
        np.ascontiguousarray(faces),
        float(reach),
    )
    vertex, face = used[pairs[:, 0]], pairs[:, 1]
    way = point - places[vertex]
    width = np.linalg.norm(way, axis=1)
    height = (way * normals[face]).sum(1)
    keep = ~(faces[face] == vertex[:, None]).any(1) & (np.abs(height) > _ACROSS * width)
    vertex, face, way, width = vertex[keep], face[keep], way[keep], width[keep]
    # The way ends on the side of the face from which it comes.
    front = (height[keep] < 0).astype(np.int64)
    rows = np.arange(len(face))
    region, beyond = regions[face][rows, front], regions[face][rows, 1 - front]
    # Each with the faces of the vertex: one of them must bound the region too, and look back.
    index, own = _incident(mesh, vertex)
    side = np.where(regions[own] == region[index][:, None], [0, 1], -1).max(1)
    outward = np.where(side[:, None] == 0, normals[own], -normals[own])
    cosine = (outward * way[index]).sum(1) / np.maximum(width[index], 1e-300)
    cosine[side < 0] = 1
    order = np.lexsort((cosine, index))
    first = np.unique(index[order], return_index=True)[1]
    best = order[first]
    best = best[cosine[best] < _FACING]
    pair = index[best]
    vertex, face, region, width = vertex[pair], face[pair], region[pair], width[pair]
    sides = np.column_stack([regions[own[best]].sum(1) - region, beyond[pair]])
    good = ~_corner(mesh, vertex, face, np.column_stack([region, sides]))
    middle = places[vertex] + way[pair] / 2
    return _Facing(vertex[good], region[good], sides[good], middle[good], width[good])


def _incident(mesh: Mesh, vertices: IntArray) -> tuple[IntArray, IntArray]:
    """Position in ``vertices`` and face, for each face of each of them."""
    corners = mesh.faces.reshape(-1)
    order = np.argsort(corners, kind="stable")
    start = np.searchsorted(corners[order], vertices)
    count = np.searchsorted(corners[order], vertices, side="right") - start
    index = np.repeat(np.arange(len(vertices)), count)
    within = np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count)
    return index, order[start[index] + within] // 3


def _corner(mesh: Mesh, vertex: IntArray, face: IntArray, three: IntArray) -> np.ndarray:
    """Whether a vertex and a face lie at a junction in which their walls meet."""
    differ = three[:, 1] != three[:, 2]
    bits = _regions_at(mesh)
    rows = np.arange(len(vertex))
    ends = np.column_stack([vertex, mesh.faces[face]])
    # The junction runs through the vertex, or through a corner of the face.
    meet = np.stack([bits[ends[:, k, None], three].all(1) for k in range(4)], axis=1)
    beside = np.zeros(len(rows), bool)
    edges, n = mesh.edges(), len(mesh.vertices)
    keys = edges[:, 0] * n + edges[:, 1]  # sorted
    for k in range(1, 4):
        key = np.minimum(vertex, ends[:, k]) * n + np.maximum(vertex, ends[:, k])
        row = np.searchsorted(keys, key).clip(0, len(keys) - 1)
        beside |= (keys[row] == key) & (meet[:, 0] | meet[:, k])
    return differ & beside


def _regions_at(mesh: Mesh) -> np.ndarray:
    """(V, R) bool: the regions that meet in each vertex."""
    bits = np.zeros((len(mesh.vertices), int(mesh.regions.max()) + 1), bool)
    for side in (0, 1):
        bits[mesh.faces, mesh.regions[:, side][:, None]] = True
    return bits


def _near_each_other(points: FloatArray, reach: float) -> list[IntArray]:
    """Rows of points in groups further than about ``reach`` from each other."""
    # Crumpled places hold a great many points: cells of a grid stand for them.
    index = np.floor(2 * points / reach).astype(np.int64)
    cells, cell = np.unique(index, axis=0, return_inverse=True)
    pairs = cKDTree(cells).query_pairs(2.5, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(cells),) * 2)
    group = connected_components(graph, directed=False)[1][cell.reshape(-1)]
    return [np.flatnonzero(group == g) for g in range(int(group.max()) + 1)]
