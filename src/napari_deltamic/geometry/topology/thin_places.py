"""Finds where topology is about to change: thin regions, and very small walls or junctions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..compiled import native
from ..connected import connected, sharing
from ..contacts import junction_edges, walls
from ..mesh import FloatArray, IntArray, Mesh
from .change_sizes import SIZES

_SAMPLE = 200  # vertices from which the number of faces within reach is estimated; chosen
_PAIRS = 500_000  # of a vertex and a face at a time: about 500 MB; chosen


@dataclass(frozen=True, eq=False)
class ThinPlace:
    """A place where regions are thin.

    Attributes
    ----------
    regions
        The thin region, 0 for a gap between cells or a hole through one; the two of a small wall;
        the three of a short junction.
    sides
        The regions around it, smaller numbers first; only one for a neck or a hole; those at the
        two ends of a short junction.
    points
        (n, 3) um: midway between the sides.
    width
        um: the mean distance of the sides there; for a wall the square root of its area, for a
        junction its length, for a piece the cube root of its volume.
    volume
        um^3, of a small piece that may vanish as a whole; 0 for all others.
    """

    regions: tuple[int, ...]
    sides: tuple[int, ...]
    points: FloatArray
    width: float
    volume: float = 0.0

    @property
    def is_thin(self) -> bool:
        """Whether a region is thin here: neither a small wall or junction nor a small piece."""
        return len(self.regions) == 1 and not self.volume

    @property
    def is_gap(self) -> bool:
        """Whether two cells nearly touch here."""
        return self.is_thin and self.regions[0] == 0 and len(self.sides) == 2

    @property
    def center(self) -> FloatArray:
        """Mean of the points, (3,) um."""
        mean: FloatArray = self.points.mean(axis=0)
        return mean


def thin_places(
    mesh: Mesh,
    reach: float,
    apart: float | None = None,
    wanted: Callable[[int, tuple[int, ...]], bool] | None = None,
) -> list[ThinPlace]:
    """Find the places where a region is thinner than ``reach`` um.

    The corner between two walls along their junction does not count.

    Parameters
    ----------
    mesh
        Closed regions.
    reach
        um; well below the length of the edges.
    apart
        um: points farther apart belong to different places. Default: five times the reach.
    wanted
        ``wanted(region, sides)``: whether to look for such places. Default: for all.
    """
    found = _facing(mesh, reach)
    if not len(found.points):
        return []
    places = []
    names, group = np.unique(
        np.column_stack([found.region, np.sort(found.sides, axis=1)]), axis=0, return_inverse=True
    )
    for k, (region, one, other) in enumerate(names.tolist()):
        sides = tuple(sorted({one, other}))
        if wanted is not None and not wanted(region, sides):
            continue
        own = np.flatnonzero(group.reshape(-1) == k)
        for part in _near_each_other(found.points[own], 5 * reach if apart is None else apart):
            rows = own[part]
            if len(np.unique(found.vertex[rows])) < SIZES.fewest:
                continue
            width = float(found.width[rows].mean())
            places.append(ThinPlace((region,), sides, found.points[rows], width))
    return places


def small_walls(mesh: Mesh, area: float, apart: float = 0.0) -> list[ThinPlace]:
    """Find pieces of walls between two cells that are smaller than ``area`` um^2.

    Pieces between the same cells that share a vertex, or whose corners are no more than ``apart``
    um from each other, are one place.
    """
    pairs, wall = mesh.interfaces()
    vertices, areas, meet = mesh.vertices_numpy(), mesh.areas(), _Meeting(mesh)
    places = []
    for row in _with_small_pieces(mesh, pairs, wall, area):
        own = np.flatnonzero(wall == row)
        corners, corner = np.unique(mesh.faces[own], return_inverse=True)
        piece = _pieces_of(corner.reshape(-1, 3), vertices[corners], apart)
        size = np.bincount(piece, areas[own])
        for k in np.flatnonzero((size < area) & (size > 0)):
            faces = mesh.faces[own[piece == k]]
            one, other = (int(r) for r in pairs[row])
            sides = tuple(sorted(meet.at(np.unique(faces)) - {one, other}))
            if sides:
                points = np.concatenate([vertices[np.unique(faces)], vertices[faces].mean(1)])
                places.append(ThinPlace((other, one), sides, points, float(np.sqrt(size[k]))))
    return places


def _with_small_pieces(mesh: Mesh, pairs: IntArray, wall: IntArray, area: float) -> IntArray:
    """Return walls between two cells with a piece (joined by vertices) smaller than an area."""
    n = len(mesh.vertices)
    corners, corner = np.unique(wall[:, None] * n + mesh.faces, return_inverse=True)
    piece = sharing(corner.reshape(-1, 3), len(corners))
    small = np.bincount(piece, mesh.areas()) < area
    rows = np.unique(wall[small[piece]])
    return rows[(pairs[rows] > 0).all(1)]


def short_junctions(mesh: Mesh, length: float) -> list[ThinPlace]:
    """Find junctions of three regions, shorter than ``length`` um, between two that do not touch.

    The three are the regions of such a place, the two at the ends of the junction its sides.
    """
    edges = mesh.edges()
    rows, around = junction_edges(mesh)
    triples, triple = np.unique(around, axis=0, return_inverse=True)
    vertices, meet = mesh.vertices_numpy(), _Meeting(mesh)
    touching = walls(mesh)
    # Lines: edges of the same three regions that share a vertex.
    keys = triple.reshape(-1, 1) * len(vertices) + edges[rows]
    corners, corner = np.unique(keys, return_inverse=True)
    corner = corner.reshape(-1, 2)
    line_of = connected(corner, len(corners))
    extent = np.bincount(line_of[corner[:, 0]], mesh.edge_lengths()[rows])
    places = []
    for p in np.flatnonzero(extent < length):
        own = corners[line_of == p]
        line, three = own % len(vertices), triples[own[0] // len(vertices)]
        ends = tuple(sorted(meet.at(line) - set(three.tolist())))
        if len(ends) == 2 and ends not in touching:
            points = np.concatenate([vertices[line], [vertices[line].mean(0)]])
            places.append(ThinPlace(tuple(three.tolist()), ends, points, float(extent[p])))
    return places


def _pieces_of(faces: IntArray, points: FloatArray, apart: float) -> IntArray:
    """Return the piece of each face: its faces share vertices or have corners near each other."""
    links = np.concatenate([faces[:, :2], faces[:, 1:]])
    if apart > 0:
        links = np.concatenate([links, cKDTree(points).query_pairs(apart, output_type="ndarray")])
    return connected(links, len(points))[faces[:, 0]]


@dataclass(frozen=True, eq=False)
class _Facing:
    """Vertices that face another surface across a region, each with the nearest place on it."""

    vertex: IntArray
    region: IntArray
    sides: IntArray
    points: FloatArray
    width: FloatArray


def _facing(mesh: Mesh, reach: float) -> _Facing:
    library = native()
    if library is None:
        return _all_of([])
    places, faces = (
        np.ascontiguousarray(mesh.vertices_numpy()),
        np.ascontiguousarray(mesh.faces),
    )
    used, normals = np.unique(faces), mesh.normals()

    def near(vertices: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
        pairs, point = library.near_faces(places[vertices], places, faces, float(reach))
        return vertices[pairs[:, 0]], pairs[:, 1], point

    # Under a wide PSF a vertex has thousands of faces within reach: some vertices at a time.
    sample = used[:: -(-len(used) // _SAMPLE)]
    each = -(-len(near(sample)[0]) // len(sample))
    at_once = max(1, _PAIRS // max(each, 1))
    return _all_of(
        [
            _of_pairs(mesh, normals, *near(used[first : first + at_once]))
            for first in range(0, len(used), at_once)
        ]
    )


def _all_of(parts: list[_Facing]) -> _Facing:
    none = np.zeros(0, np.int64)
    parts = [_Facing(none, none, none.reshape(0, 2), np.zeros((0, 3)), np.zeros(0)), *parts]
    names = ("vertex", "region", "sides", "points", "width")
    return _Facing(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _of_pairs(
    mesh: Mesh, normals: FloatArray, vertex: IntArray, face: IntArray, point: FloatArray
) -> _Facing:
    """Select the pairs of a vertex and a face (with its nearest point) that face each other."""
    places, faces, regions = mesh.vertices_numpy(), mesh.faces, mesh.regions
    way = point - places[vertex]
    width = np.linalg.norm(way, axis=1)
    height = (way * normals[face]).sum(1)
    keep = ~(faces[face] == vertex[:, None]).any(1) & (np.abs(height) > SIZES.across * width)
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
    best = best[cosine[best] < SIZES.facing]
    pair = index[best]
    vertex, face, region, width = vertex[pair], face[pair], region[pair], width[pair]
    sides = np.column_stack([regions[own[best]].sum(1) - region, beyond[pair]])
    good = np.flatnonzero(~_corner(mesh, vertex, face, np.column_stack([region, sides])))
    # Of what a vertex faces across a region, the nearest tells where that is thin.
    keys = np.column_stack([vertex[good], region[good], sides[good]])
    nearest = np.argsort(width[good], kind="stable")
    good = good[np.sort(nearest[np.unique(keys[nearest], axis=0, return_index=True)[1]])]
    middle = places[vertex] + way[pair] / 2
    return _Facing(vertex[good], region[good], sides[good], middle[good], width[good])


def _incident(mesh: Mesh, vertices: IntArray) -> tuple[IntArray, IntArray]:
    """Return, for each face of each vertex, the position in ``vertices`` and the face."""
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
    meeting = _Meeting(mesh)
    rows = np.arange(len(vertex))
    ends = np.column_stack([vertex, mesh.faces[face]])
    # The junction runs through the vertex, or through a corner of the face.
    meet = np.stack([meeting.has(ends[:, k, None], three).all(1) for k in range(4)], axis=1)
    beside = np.zeros(len(rows), bool)
    edges, n = mesh.edges(), len(mesh.vertices)
    keys = edges[:, 0] * n + edges[:, 1]  # sorted
    for k in range(1, 4):
        key = np.minimum(vertex, ends[:, k]) * n + np.maximum(vertex, ends[:, k])
        row = np.searchsorted(keys, key).clip(0, len(keys) - 1)
        beside |= (keys[row] == key) & (meet[:, 0] | meet[:, k])
    return differ & beside


class _Meeting:
    """Regions that meet in each vertex, as a sorted list: a table would need a column for each."""

    def __init__(self, mesh: Mesh) -> None:
        self._size = int(mesh.regions.max()) + 1
        keys = mesh.faces[:, :, None] * self._size + mesh.regions[:, None, :]
        self._keys = np.unique(keys)
        self._start = np.searchsorted(
            self._keys, np.arange(len(mesh.vertices) + 1) * self._size
        ).tolist()

    def at(self, vertices: IntArray) -> set[int]:
        """Return the regions that meet in any of some vertices."""
        spans = (self._keys[self._start[v] : self._start[v + 1]] for v in vertices.tolist())
        return {int(key % self._size) for span in spans for key in span}

    def has(self, vertices: IntArray, regions: IntArray) -> np.ndarray:
        """Return (...) bool: whether a region is one of those that meet in a vertex."""
        wanted = vertices * self._size + regions
        row = np.searchsorted(self._keys, wanted).clip(0, len(self._keys) - 1)
        found: np.ndarray = self._keys[row] == wanted
        return found


def _near_each_other(points: FloatArray, reach: float) -> list[IntArray]:
    """Group points; groups are farther than about ``reach`` from each other."""
    # Crumpled places hold a great many points: cells of a grid stand for them.
    index = np.floor(2 * points / reach).astype(np.int64)
    cells, cell = np.unique(index, axis=0, return_inverse=True)
    # The reach is two cells; points lie anywhere within theirs, which could be half a cell more.
    pairs = cKDTree(cells).query_pairs(2.5, output_type="ndarray")
    group = connected(pairs, len(cells))[cell.reshape(-1)]
    return [np.flatnonzero(group == g) for g in range(int(group.max()) + 1)]
