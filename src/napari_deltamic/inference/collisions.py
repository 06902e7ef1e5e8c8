"""Steps that never make surfaces cross."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil
from typing import Any

import numpy as np

from ..geometry.mesh import Mesh
from .preconditioner import components
from .upkeep import median_edge

# As shares of the median edge:
_LONG = 2.0  # longer steps are checked in parts, whose swept boxes overlap fewer others
_ROOM = 0.1  # pairs are found for as many steps at once as the mean vertex needs to go this far
_SLACK = 0.03  # room around the way ahead, on top of
_ASIDE = 0.3  # this share of its length
_CONTACT = 1e-3  # surfaces this near that approach each other stop, or the gap would go to nothing
_TOUCH = 1e-9  # as good as crossing
# Counts:
_AHEAD = 10.0  # steps at most for which pairs are found at once
_PARTS = 8  # at most; what is longer still is cut
_ROUNDS = 3  # of shortening; what still collides then stays where it was
_GROUP = 32  # candidates that are asked about together
_ITERATIONS = 1000  # of the continuous test; a pair that takes more counts as colliding
_AGAIN = 10  # steps after which it is asked anew whether a surface still crosses


class CollisionGuard:
    """Shortens the steps of vertices whose faces would otherwise run into others.

    Candidates are the pairs of a vertex and a face, and of two edges, whose swept boxes overlap
    (ipctk). Where the step is free of collisions it is taken to the bit; else the vertices of each
    pair that collides stop before that, and the rest goes on: one vertex in a narrow place does
    not hold back the others. The continuous test is the additive one of M. Li et al.,
    "Codimensional Incremental Potential Contact", ACM Trans. Graph. 40, 2021.

    Surfaces that cross already are left alone, that is the pairs of walls that do; all others are
    guarded. Without ipctk nothing is.

    Parameters
    ----------
    active
        False: leave all steps alone.
    """

    def __init__(self, active: bool = True) -> None:
        self._library: Any = _library() if active else None
        self._mesh: Mesh | None = None
        self._told: set[tuple[int, ...]] = set()
        self._remark = ""

    def watch(self, mesh: Mesh) -> None:
        """Go on with this mesh, which may cross itself."""
        if self._library is None:
            return
        self._steps = 0
        self._groups: list[Any] | None = None
        self._near: Any = None  # candidates of vertices within boxes
        if self._mesh is None or self._mesh.faces is not mesh.faces:
            self._surface = _surface(self._library, mesh)
            self._edge = max(median_edge(mesh), 1e-9)
            self._lines = mesh.edges()
            self._ccd = self._library.AdditiveCCD(_ITERATIONS)
        self._mesh = mesh
        self._crossing = _Crossing(self._library, mesh, _TOUCH * self._edge)
        new = self._crossing.regions - self._told
        if new:
            self._told |= new
            self._remark = _sentence(new)

    def remark(self) -> str:
        """What there is to tell, once: which regions cross."""
        told, self._remark = self._remark, ""
        return told

    def allows(self, mesh: Mesh) -> bool:
        """Whether another triangulation crosses no more than the present one does."""
        if self._library is None or not crosses(mesh):
            return True
        return _Crossing(self._library, mesh, 0.0).regions <= self._crossing.regions

    def limited(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """As near to the end as each vertex may go from the start.

        Parameters
        ----------
        start, end
            (V, 3) um, of the mesh that is watched.

        Returns
        -------
        (V, 3) um; ``end`` itself where nothing collides.
        """
        if self._library is None or not np.isfinite(end).all():
            return end
        self._steps += 1
        if self._crossing and self._steps % _AGAIN == 0:
            assert self._mesh is not None
            self.watch(self._mesh.with_vertices(start))
        step = end - start
        length = np.linalg.norm(step, axis=1)
        largest = float(length.max())
        parts = ceil(largest / (_LONG * self._edge))
        if parts <= 1:
            return self._part(start, end)
        if parts > _PARTS:
            parts = _PARTS
            longest = _PARTS * _LONG * self._edge
            end = start + step * np.minimum(1.0, longest / np.maximum(length, longest))[:, None]
        place, free = start, True
        for left in range(parts, 0, -1):
            aim = end if left == 1 and free else place + (end - place) / left
            reached = self._part(place, aim)
            free = free and reached is aim
            place = reached
        return place

    def _part(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        pairs = self._candidates(start, end)
        ends = _columns(start), _columns(end)
        if len(pairs) == 0 or pairs.is_step_collision_free(self._surface, *ends, 0.0, self._ccd):
            return end
        share = self._shares(pairs, start, end - start)
        reached = end.copy()
        held = share < 1
        reached[held] = start[held] + share[held, None] * (end - start)[held]
        return reached

    def _candidates(self, start: np.ndarray, end: np.ndarray) -> Any:
        """Pairs that may collide on the way."""
        if self._near is not None:
            low, high, pairs = self._near
            if all((low <= place).all() and (place <= high).all() for place in (start, end)):
                return pairs
        # Steps resemble the last ones: each vertex gets a box around its way for the next few.
        step = end - start
        mean = float(np.sqrt((step**2).sum(1)).mean())
        ahead = min(_AHEAD, _ROOM * self._edge / max(mean, 1e-12 * self._edge))
        low, high = np.minimum(start, end), np.maximum(start, end)
        if ahead > 1:
            far = start + ahead * step
            aside = _ASIDE * np.abs(far - start).max(1, keepdims=True) + _SLACK * self._edge
            low, high = np.minimum(start, far) - aside, np.maximum(start, far) + aside
        pairs = self._library.Candidates()
        boxes = _columns(low), _columns(high)
        pairs.build(self._surface, *boxes, 0.0, self._library.LBVH())
        self._near, self._groups = (low, high, pairs), None
        if self._crossing:
            self._crossing.leave_out(pairs, self._surface)
        return pairs

    def _shares(self, pairs: Any, start: np.ndarray, step: np.ndarray) -> np.ndarray:
        """(V,) the share of its step that each vertex may go."""
        if self._groups is None:
            self._groups = list(self._grouped(pairs))
        share, turn = np.ones(len(start)), 0
        while True:
            end = start + share[:, None] * step
            ends = _columns(start), _columns(end)
            lower = share.copy()
            for group, stencils, vertices in self._groups:
                if group.is_step_collision_free(self._surface, *ends, 0.0, self._ccd):
                    continue
                for stencil, four in zip(stencils, vertices, strict=True):
                    before, after = start[four].reshape(-1), end[four].reshape(-1)
                    hit, time = stencil.ccd(before, after, 0.0, 1.0, self._ccd)
                    if hit:
                        near = stencil.compute_distance(before) < (_CONTACT * self._edge) ** 2
                        may = 0.0 if near or turn >= _ROUNDS else time
                        lower[four] = np.minimum(lower[four], may * share[four])
            if (lower == share).all():
                return share
            # Those around follow, if it goes on and on: a surface that crumples takes many turns.
            held = lower < share
            for _ in range(turn - _ROUNDS):
                held[self._lines[held[self._lines].any(1)]] = True
                lower[held] = 0.0
            share, turn = lower, turn + 1

    def _grouped(self, pairs: Any) -> Iterator[tuple[Any, list[Any], np.ndarray]]:
        """Candidates in small groups: to find those that collide takes long one by one."""
        corners = _corners(pairs, self._surface)
        for name, vertices in zip(("fv_candidates", "ee_candidates"), corners, strict=True):
            stencils = getattr(pairs, name)
            for first in range(0, len(stencils), _GROUP):
                some = slice(first, first + _GROUP)
                group = self._library.Candidates()
                setattr(group, name, stencils[some])
                yield group, stencils[some], vertices[some]


class _Crossing:
    """Which walls of a mesh cross, or touch, and which regions are theirs."""

    def __init__(self, library: Any, mesh: Mesh, touch: float) -> None:
        self.regions: set[tuple[int, ...]] = set()
        found = [*_crossing_pairs(library, mesh), *_touching_pairs(library, mesh, touch)]
        if not found:
            return
        # A wall: the faces of one piece between the same two regions.
        rows = np.column_stack([components(mesh)[mesh.faces[:, 0]], mesh.interfaces()[1]])
        walls, index = np.unique(rows, axis=0, return_inverse=True)
        self._of = np.zeros((len(mesh.vertices), len(walls)), bool)  # the walls of each vertex
        self._of[mesh.faces, index.reshape(-1, 1)] = True
        self._pairs = np.zeros((len(walls), len(walls)), bool)
        names = mesh.interfaces()[0][walls[:, 1], 0]
        for elements in found:
            one, other = (np.flatnonzero(self._of[k].all(0)) for k in elements)
            self._pairs[np.ix_(one, other)] = self._pairs[np.ix_(other, one)] = True
            self.regions.add(tuple(sorted({int(names[one[0]]), int(names[other[0]])})))

    def __bool__(self) -> bool:
        return bool(self.regions)

    def leave_out(self, candidates: Any, surface: Any) -> None:
        """Take the pairs of walls that cross out of the candidates."""
        points, lines = _corners(candidates, surface)
        kept = ~self._cross(points[:, :1], points[:, 1:])
        candidates.fv_candidates = [
            c for c, k in zip(candidates.fv_candidates, kept, strict=True) if k
        ]
        kept = ~self._cross(lines[:, :2], lines[:, 2:])
        candidates.ee_candidates = [
            c for c, k in zip(candidates.ee_candidates, kept, strict=True) if k
        ]

    def _cross(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        a, b = (self._of[k].all(1).astype(float) for k in (one, other))
        crossing: np.ndarray = ((a @ self._pairs) * b).sum(1) > 0
        return crossing


def crosses(mesh: Mesh) -> bool:
    """Whether a surface crosses itself or another of the mesh; False where ipctk is missing."""
    library = _library()
    if library is None:
        return False
    places = _columns(mesh.vertices_numpy())
    return bool(library.has_intersections(_surface(library, mesh), places, library.LBVH()))


def _crossing_pairs(library: Any, mesh: Mesh) -> list[tuple[np.ndarray, np.ndarray]]:
    """Vertices of each edge and of the face that it runs through."""
    if not crosses(mesh):
        return []
    places, edges, faces = mesh.vertices_numpy(), mesh.edges(), mesh.faces
    method = library.LBVH()
    method.build(_columns(places), edges, faces, 0.0)
    pairs = [(edges[k.edge_id], faces[k.face_id]) for k in method.detect_edge_face_candidates()]
    return [
        (edge, face)
        for edge, face in pairs
        if not np.isin(edge, face).any()
        and library.is_edge_intersecting_triangle(*places[edge], *places[face])
    ]


def _touching_pairs(library: Any, mesh: Mesh, touch: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Vertices of each vertex and face, or of two edges, less than ``touch`` um apart."""
    places, surface = mesh.vertices_numpy(), _surface(library, mesh)
    near = library.Candidates()
    near.build(surface, _columns(places), touch, library.LBVH())
    found = []
    parts = ((near.fv_candidates, 1), (near.ee_candidates, 2))
    for (stencils, split), corners in zip(parts, _corners(near, surface), strict=True):
        for stencil, four in zip(stencils, corners, strict=True):
            if stencil.compute_distance(places[four].reshape(-1)) < touch**2:
                found.append((four[:split], four[split:]))
    return found


def _corners(candidates: Any, surface: Any) -> tuple[np.ndarray, np.ndarray]:
    """(N, 4) vertices of pairs of a vertex and a face, and of two edges."""
    points = [(k.vertex_id, k.face_id) for k in candidates.fv_candidates]
    lines = [(k.edge0_id, k.edge1_id) for k in candidates.ee_candidates]
    vertex, face = np.array(points, np.int64).reshape(-1, 2).T
    one, other = np.array(lines, np.int64).reshape(-1, 2).T
    faces, edges = np.asarray(surface.faces), np.asarray(surface.edges)
    return np.column_stack([vertex, faces[face]]), np.column_stack([edges[one], edges[other]])


def _sentence(regions: set[tuple[int, ...]]) -> str:
    """Which regions cross, for the user."""
    alone = ", ".join(str(r[0]) for r in sorted(regions) if len(r) == 1)
    pairs = ", ".join(f"{r[0]} and {r[1]}" for r in sorted(regions) if len(r) == 2)
    parts = [f"the surface of region {alone} crosses itself"] if alone else []
    parts += [f"the surfaces of regions {pairs} cross"] if pairs else []
    return " and ".join(parts) + ": the fit goes on, but does not keep them apart"


def _surface(library: Any, mesh: Mesh) -> Any:
    return library.CollisionMesh(_columns(mesh.vertices_numpy()), mesh.edges(), mesh.faces)


def _columns(vertices: np.ndarray) -> np.ndarray:
    return np.asfortranarray(vertices, np.float64)


def _library() -> Any:
    try:
        import ipctk
    except ImportError:
        return None
    return ipctk
