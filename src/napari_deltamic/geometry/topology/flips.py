"""Exchanges of neighbours where a wall or a junction is small (T1 transitions), on the mesh itself.

Nothing but the faces at that place changes, unlike in :mod:`.rearranging`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise, product

import numpy as np
from scipy.spatial import cKDTree

from ..mesh import FloatArray, IntArray, Mesh, mesh_of_faces
from .change_sizes import SIZES
from .submesh import Change, Submesh, stayed
from .thin_places import ThinPlace

_SAME_PLACE = 1e-9  # um: points of a place are vertices of the mesh, up to rounding
_Flip = Callable[[Mesh, ThinPlace, float], Change | None]
_Way = Callable[[Mesh, list[int], ThinPlace], FloatArray]


def flipped(part: Submesh, place: ThinPlace, edge: float) -> Iterator[Change]:
    """Yield what a part may become by an exchange of neighbours; triangles are not good yet.

    At a small wall (:func:`small_walls`) its two cells part, and the neighbour with the longest
    border to it grows in between. At a short junction (:func:`short_junctions`) the cells at its
    two ends come to touch.

    Parameters
    ----------
    part
        The part around the place; its surfaces do not cross.
    place
        A small wall of two regions, or a short junction of three.
    edge
        um: the edge length of the mesh.
    """
    changes: tuple[_Flip, ...] = (_without_wall,)
    if len(place.regions) == 3:
        # A junction that has collapsed has no direction of its own; its ends have.
        changes = partial(_with_wall, way_of=_along), partial(_with_wall, way_of=_from_end_to_end)
    for share, change in product(SIZES.opened, changes):
        made = change(part.mesh, place, share * edge)
        if made is not None:
            yield made


# ----------------------------------------------------------------------------- a wall goes


def _without_wall(mesh: Mesh, place: ThinPlace, apart: float) -> Change | None:
    """Part the two cells of a small wall: a cell around it grows in between."""
    one, other = place.regions
    wall = _faces_at(mesh, place)
    rim = _rim(mesh, wall, place)
    if rim is None:
        return None
    vertices = mesh.vertices_numpy()
    lengths = dict.fromkeys(sorted(rim.values()), 0.0)
    for (u, w), side in rim.items():
        lengths[side] += float(np.linalg.norm(vertices[u] - vertices[w]))
    heir = max(lengths, key=lambda side: (lengths[side], -side))
    own = np.unique(mesh.faces[wall])
    copy = {int(v): len(vertices) + k for k, v in enumerate(own)}
    draft = _Draft(mesh)
    inside = set(wall.tolist())
    for row in np.flatnonzero(np.isin(mesh.faces, own).any(1)).tolist():
        pair, corners = draft.pairs[row], draft.faces[row]
        if row in inside:
            draft.pairs[row] = _renamed(pair, other, heir)
            draft.add([copy[v] for v in corners], _renamed(pair, one, heir))
        elif other in pair:
            draft.faces[row] = [copy.get(v, v) for v in corners]
        elif one not in pair and sum(v in copy for v in corners) > 1:
            return None
    for (u, w), side in rim.items():
        if side != heir:
            draft.patch([u, w, copy[w]], {heir, side})
            draft.patch([u, copy[w], copy[u]], {heir, side})
    for v, q, row in _meeting(mesh, own, place.regions, other):
        draft.patch([v, copy[v], q], set(mesh.regions[row].tolist()))
    normal = _normals_from(mesh, wall, own, one)
    shift = np.zeros_like(vertices)
    shift[own] = -apart * normal
    return draft.change(np.concatenate([vertices + shift, vertices[own] + apart * normal]))


def _faces_at(mesh: Mesh, place: ThinPlace) -> IntArray:
    """Return the faces of a small wall."""
    rows = np.flatnonzero((np.sort(mesh.regions, 1) == sorted(place.regions)).all(1))
    apart = cKDTree(place.points).query(mesh.vertices_numpy()[mesh.faces[rows]])[0]
    return rows[(apart < _SAME_PLACE * max(place.width, 1.0)).all(1)]


def _rim(mesh: Mesh, wall: IntArray, place: ThinPlace) -> dict[tuple[int, int], int] | None:
    """Return the edges around a wall and the region beyond each; None if the rim branches.

    Its parts may touch each other in a vertex.
    """
    edge, count = np.unique(mesh.face_edges()[wall], return_counts=True)
    if not len(wall) or (count > 2).any():
        return None
    around: dict[int, set[int]] = {int(e): set() for e in edge[count == 1]}
    rows = np.flatnonzero(np.isin(mesh.face_edges(), edge[count == 1]).any(1))
    for row in rows:
        for e in mesh.face_edges()[row].tolist():
            if e in around:
                around[e] |= set(mesh.regions[row].tolist()) - set(place.regions)
    ends = mesh.edges()[list(around)]
    degree = Counter(ends.reshape(-1).tolist())
    if any(len(sides) != 1 for sides in around.values()) or set(degree.values()) - {2, 4}:
        return None
    return {(int(u), int(w)): next(iter(around[e])) for e, (u, w) in zip(around, ends, strict=True)}


def _meeting(
    mesh: Mesh, own: IntArray, regions: Sequence[int], kept: int
) -> list[tuple[int, int, int]]:
    """Return (vertex, neighbour, face) where other walls end at a face of region ``kept``."""
    found = []
    for row in np.flatnonzero(np.isin(mesh.faces, own).any(1)):
        if np.isin(mesh.regions[row], regions).any():
            continue
        (v,) = [x for x in mesh.faces[row].tolist() if x in own]
        for q in mesh.faces[row].tolist():
            ends = (mesh.faces == v).any(1) & (mesh.faces == q).any(1)
            if q != v and (mesh.regions[ends] == kept).any():
                found.append((v, q, int(row)))
    return found


def _normals_from(mesh: Mesh, wall: IntArray, own: IntArray, region: int) -> FloatArray:
    """Return (len(own), 3) unit normals of a wall at its vertices, away from a region."""
    sign = np.where(mesh.regions[wall, 0] == region, 1.0, -1.0)
    weighted = (sign * mesh.areas()[wall])[:, None] * mesh.normals()[wall]
    total = np.zeros((len(own), 3))
    np.add.at(total, np.searchsorted(own, mesh.faces[wall]).reshape(-1), weighted.repeat(3, 0))
    unit: FloatArray = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
    return unit


# --------------------------------------------------------------------------- a wall appears


def _with_wall(mesh: Mesh, place: ThinPlace, apart: float, *, way_of: _Way) -> Change | None:
    """Widen a short junction of three cells to a tube, through which the cells at its ends touch.

    way_of : gives the direction of the tube.
    """
    line = _line(mesh, place)
    if line is None:
        return None
    vertices, three = mesh.vertices_numpy(), place.regions
    reaching, reached = place.sides
    walls = [frozenset((three[k], three[(k + 1) % 3])) for k in range(3)]
    # Copies of each vertex, one for each of the three walls; walls with the cells at the ends
    # take that of the wall between the same cell and the next.
    number = {v: [len(vertices) + 3 * k + j for j in range(3)] for k, v in enumerate(line)}
    draft = _Draft(mesh)
    for row in np.flatnonzero(np.isin(mesh.faces, line).any(1)).tolist():
        pair = set(draft.pairs[row])
        if frozenset(pair) in walls:
            j = walls.index(frozenset(pair))
        elif len(pair & set(three)) == 1:
            if sum(v in number for v in draft.faces[row]) > 1:
                return None
            j = three.index(next(iter(pair & set(three))))
        else:
            return None
        draft.faces[row] = [number[v][j] if v in number else v for v in draft.faces[row]]
    for end, region in ((line[0], reaching), (line[-1], reached)):
        for j, wall in enumerate(walls):
            beyond = _beyond(mesh, end, wall | {region})
            if beyond is None:
                return None
            draft.patch(
                [number[end][j], number[end][(j + 1) % 3], beyond], {region, three[(j + 1) % 3]}
            )
    for u, w in pairwise(line):
        for j in range(3):
            k = (j + 1) % 3
            pair = {reaching, three[k]}
            draft.patch([number[u][j], number[u][k], number[w][k]], pair)
            draft.patch([number[u][j], number[w][k], number[w][j]], pair)
    draft.patch(number[line[-1]], {reaching, reached})
    # A junction that has collapsed is drawn out, or the tube has no length.
    way = way_of(mesh, line, place)
    length = float(np.linalg.norm(vertices[line[-1]] - vertices[line[0]]))
    longer = max(apart - length, 0.0) * way
    along = {v: (k / (len(line) - 1) - 0.5) * longer for k, v in enumerate(line)}
    places = [
        vertices[v] + along[v] + apart * _into(mesh, v, way, wall) for v in line for wall in walls
    ]
    return draft.change(np.concatenate([vertices, places]))


def _line(mesh: Mesh, place: ThinPlace) -> list[int] | None:
    """Return the vertices of a short junction, from the first of the sides to the second."""
    vertices = mesh.vertices_numpy()
    own = np.flatnonzero(cKDTree(place.points).query(vertices)[0] < _SAME_PLACE)
    meet: dict[int, set[int]] = {int(v): set() for v in own}
    for row in np.flatnonzero(np.isin(mesh.faces, own).any(1)):
        for v in mesh.faces[row].tolist():
            if v in meet:
                meet[v] |= set(mesh.regions[row].tolist())
    three = set(place.regions)
    own = np.array([v for v, regions in meet.items() if three <= regions], np.int64)
    ends = [[v for v in own.tolist() if side in meet[v]] for side in place.sides]
    if any(len(end) != 1 for end in ends) or ends[0] == ends[1]:
        return None
    if any(len(meet[v]) != (4 if v in ends[0] + ends[1] else 3) for v in own.tolist()):
        return None
    edges = mesh.edges()[np.isin(mesh.edges(), own).all(1)]
    steps = {(int(u), int(w)) for u, w in edges if _around(mesh, int(u), int(w)) == three}
    line = ends[0].copy()
    while line[-1] != ends[1][0]:
        nexts = [
            w
            for w in own.tolist()
            if w not in line and (min(line[-1], w), max(line[-1], w)) in steps
        ]
        if len(nexts) != 1:
            return None
        line += nexts
    return line if len(line) == len(own) else None


def _around(mesh: Mesh, u: int, w: int) -> set[int]:
    """Return the regions that meet in an edge."""
    rows = (mesh.faces == u).any(1) & (mesh.faces == w).any(1)
    return set(mesh.regions[rows].reshape(-1).tolist())


def _beyond(mesh: Mesh, vertex: int, three: frozenset[int]) -> int | None:
    """Return the other end of the junction edge of three regions at a vertex."""
    rows = (mesh.faces == vertex).any(1)
    near = [v for v in np.unique(mesh.faces[rows]).tolist() if v != vertex]
    found = [v for v in near if _around(mesh, vertex, v) == three]
    return found[0] if len(found) == 1 else None


def _along(mesh: Mesh, line: list[int], _: ThinPlace) -> FloatArray:
    """Return the unit vector along a junction, from its first vertex to its last."""
    first, last = mesh.vertices_numpy()[[line[0], line[-1]]]
    unit: FloatArray = (last - first) / max(float(np.linalg.norm(last - first)), 1e-300)
    return unit


def _from_end_to_end(mesh: Mesh, line: list[int], place: ThinPlace) -> FloatArray:
    """Return the unit vector from the region at one end of a junction to that at the other."""
    centers = []
    for end, region in zip((line[0], line[-1]), place.sides, strict=True):
        rows = (mesh.faces == end).any(1) & (mesh.regions == region).any(1)
        centers.append(mesh.vertices_numpy()[mesh.faces[rows]].mean((0, 1)))
    way = centers[1] - centers[0]
    unit: FloatArray = way / max(float(np.linalg.norm(way)), 1e-300)
    return unit


def _into(mesh: Mesh, vertex: int, along: FloatArray, wall: frozenset[int]) -> FloatArray:
    """Return the unit vector across a junction, from a vertex of it into one of its walls."""
    vertices = mesh.vertices_numpy()
    rows = (mesh.faces == vertex).any(1) & (np.sort(mesh.regions, 1) == sorted(wall)).all(1)
    way = vertices[mesh.faces[rows]].mean((0, 1)) - vertices[vertex]
    way = way - (way @ along) * along
    unit: FloatArray = way / max(float(np.linalg.norm(way)), 1e-300)
    return unit


# ------------------------------------------------------------------------------- new faces


class _Draft:
    """Faces of a mesh that is being changed; new ones are wound to match their neighbours."""

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh
        self.faces: list[list[int]] = mesh.faces.tolist()
        self.pairs: list[tuple[int, int]] = [(a, b) for a, b in mesh.regions.tolist()]
        self._open: list[tuple[list[int], set[int]]] = []

    def add(self, corners: list[int], pair: tuple[int, int]) -> None:
        """Add a face whose normal points from the first region to the second."""
        self.faces.append(corners)
        self.pairs.append(pair)

    def patch(self, corners: list[int], pair: set[int]) -> None:
        """Add a face between two regions whose winding is not known yet."""
        self._open.append((corners, pair))

    def change(self, vertices: FloatArray) -> Change | None:
        """Make the changed mesh, whose vertices begin with those of the given one.

        None if the patches do not fit. Vertices without faces are left out.
        """
        ends = {v for corners, _ in self._open for v in corners}
        # For each directed edge the regions that a face which has it bounds from their inside.
        bounded: set[tuple[int, int, int]] = set()
        for face, sides in zip(self.faces, self.pairs, strict=True):
            if ends.intersection(face):
                bounded |= _borders(face, sides)
        waiting = self._open
        while waiting:
            left = []
            for corners, pair in waiting:
                low, high = min(pair), max(pair)
                turns = [(turn, (low, high)) for turn in (corners, corners[::-1])]
                fits = [t for t in turns if any((w, u, r) in bounded for u, w, r in _borders(*t))]
                if len(fits) == 1:
                    self.add(*fits[0])
                    bounded |= _borders(*fits[0])
                else:
                    left.append((corners, pair))
            if len(left) == len(waiting):
                return None
            waiting = left
        made, used = mesh_of_faces(vertices, np.array(self.faces), np.array(self.pairs))
        return stayed(self._mesh, made, np.where(used < len(self._mesh.vertices), used, -1))


def _borders(corners: list[int], pair: tuple[int, int]) -> set[tuple[int, int, int]]:
    """Return the directed edges of a face as seen from outside each of its two regions."""
    found = set()
    for k in range(3):
        u, w = corners[k], corners[(k + 1) % 3]
        found |= {(u, w, pair[0]), (w, u, pair[1])}
    return found


def _renamed(pair: tuple[int, int], old: int, new: int) -> tuple[int, int]:
    return (new if pair[0] == old else pair[0], new if pair[1] == old else pair[1])
