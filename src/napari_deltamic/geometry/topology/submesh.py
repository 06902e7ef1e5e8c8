"""Parts of a mesh that are cut out, changed, and put back, while the rest stays untouched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..contacts import between_cells
from ..mesh import OUTSIDE, FloatArray, IntArray, Mesh, mesh_of_faces
from ..remeshing import remesh
from .change_sizes import SIZES
from .crossings import crosses

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Change:
    """A changed mesh, and where its vertices come from.

    Attributes
    ----------
    mesh
        The mesh after the change.
    origin
        (V,) the old vertex, at the same place, that each of its vertices is; -1 for new ones.
    """

    mesh: Mesh
    origin: IntArray

    def then(self, later: Change) -> Change:
        """Combine this change with a later one of its mesh."""
        known = later.origin >= 0
        origin = np.where(known, self.origin[np.maximum(later.origin, 0)], -1)
        return Change(later.mesh, origin)


def unchanged(mesh: Mesh) -> Change:
    """Return a change that does nothing."""
    return Change(mesh, np.arange(len(mesh.vertices)))


@dataclass(frozen=True, eq=False)
class Submesh:
    """Some faces of a mesh as a mesh of their own.

    Attributes
    ----------
    mesh
        Its own vertices; open along the border where it was cut out.
    rows
        The faces of the whole mesh that it consists of, increasing.
    corners
        (v,) the vertex of the whole mesh that each of its vertices is.
    rim
        (v,) bool: vertices that it shares with faces of the rest. They and the edges between them
        must stay, or the part no longer fits.
    """

    mesh: Mesh
    rows: IntArray
    corners: IntArray
    rim: Mask


class Cutter:
    """Cuts parts out of a mesh.

    What it needs to know about the whole mesh is computed once.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.vertices = mesh.vertices_numpy()
        corners = self.vertices[mesh.faces]
        self._low, self._high = corners.min(1), corners.max(1)
        self._extent = float((self._high - self._low).max() / 2)
        self._middles = cKDTree((self._low + self._high) / 2)
        self._faces_at = np.bincount(mesh.faces.reshape(-1), minlength=len(self.vertices))

    def faces_in(self, low: FloatArray, high: FloatArray) -> IntArray:
        """Return the sorted rows of the faces that may reach into a box."""
        reach = float((high - low).max()) / 2 + self._extent
        near = self._middles.query_ball_point((low + high) / 2, reach, p=np.inf)
        rows = np.sort(np.array(near, np.int64))
        inside = (self._low[rows] <= high) & (self._high[rows] >= low)
        return rows[inside.all(1)]

    def part(self, rows: IntArray) -> Submesh:
        """Cut out some faces as a part."""
        whole = self.mesh
        mesh, corners = mesh_of_faces(self.vertices, whole.faces[rows], whole.regions[rows])
        elsewhere = self._faces_at[corners] > np.bincount(mesh.faces.reshape(-1))
        return Submesh(mesh, rows, corners, elsewhere)


def put_back(mesh: Mesh, changes: Sequence[tuple[Submesh, Change]]) -> Change:
    """Put changed parts back into the whole mesh.

    Faces and vertices of the rest come first, in their old order.

    Parameters
    ----------
    mesh
        The whole mesh.
    changes
        Parts that share no face, each with its change, which keeps the rim.
    """
    rest = np.ones(len(mesh.faces), bool)
    for part, _ in changes:
        rest[part.rows] = False
    kept = np.zeros(len(mesh.vertices), bool)
    kept[mesh.faces[rest]] = True
    for part, change in changes:
        kept[part.corners[change.origin[change.origin >= 0]]] = True
    number = np.cumsum(kept) - 1
    count = int(kept.sum())
    vertices, faces = [mesh.vertices_numpy()[kept]], [number[mesh.faces[rest]]]
    regions, origins = [mesh.regions[rest]], [np.flatnonzero(kept)]
    for part, change in changes:
        new = change.origin < 0
        index = np.empty(len(new), np.int64)
        index[~new] = number[part.corners[change.origin[~new]]]
        index[new] = count + np.arange(int(new.sum()))
        count += int(new.sum())
        vertices.append(change.mesh.vertices_numpy()[new])
        faces.append(index[change.mesh.faces])
        regions.append(change.mesh.regions)
        origins.append(np.full(int(new.sum()), -1))
    whole = Mesh(np.concatenate(vertices), np.concatenate(faces), np.concatenate(regions))
    return Change(whole, np.concatenate(origins))


def narrowed(part: Submesh, change: Change) -> tuple[Submesh, Change]:
    """Reduce a change of a part to the faces that differ before and after.

    The other faces can then belong to parts of other changes.
    """
    old = change.origin >= 0
    settled = np.flatnonzero(old[change.mesh.faces].all(1))
    before = _face_rows(part.mesh.faces, part.mesh.regions)
    after = _face_rows(change.origin[change.mesh.faces[settled]], change.mesh.regions[settled])
    _, index = np.unique(np.concatenate([before, after]), axis=0, return_inverse=True)
    index = index.reshape(-1)
    was = np.isin(index[: len(before)], index[len(before) :])
    stays = np.zeros(len(change.mesh.faces), bool)
    stays[settled] = np.isin(index[len(before) :], index[: len(before)])
    if stays.all() or was.all():  # a piece vanished and nothing is new, or the same the other way
        return part, change
    small, corners = _some(part.mesh, ~was)
    rest = np.zeros(len(part.corners), bool)
    rest[part.mesh.faces[was]] = True
    now, own = _some(change.mesh, ~stays)
    number = np.full(len(part.corners), -1)
    number[corners] = np.arange(len(corners))
    origin = change.origin[own]
    origin = np.where(origin >= 0, number[np.maximum(origin, 0)], -1)
    rim = (part.rim | rest)[corners]
    return Submesh(small, part.rows[~was], part.corners[corners], rim), Change(now, origin)


def _face_rows(faces: IntArray, regions: IntArray) -> IntArray:
    return np.column_stack([np.sort(faces, axis=1), np.sort(regions, axis=1)])


def _some(mesh: Mesh, mask: Mask) -> tuple[Mesh, IntArray]:
    """Return a mesh of some faces, and the given mesh's vertices that it has."""
    return mesh_of_faces(mesh.vertices_numpy(), mesh.faces[mask], mesh.regions[mask])


def evened_around(part: Submesh, change: Change, points: FloatArray, edge: float) -> Change:
    """Make good triangles around some points of a changed part; nothing moves elsewhere.

    Parameters
    ----------
    part
        The part before the change.
    change
        Its change, which keeps the rim.
    points
        (n, 3) um.
    edge
        um: the edge length.
    """
    rim = np.zeros(len(change.origin), bool)
    old = change.origin >= 0
    rim[old] = part.rim[change.origin[old]]
    # The faces beyond the rim are not known here, so vertices beside it stay, too.
    away = cKDTree(points).query(change.mesh.vertices_numpy())[0]
    held = away > SIZES.free * edge
    held[change.mesh.faces[rim[change.mesh.faces].any(1)]] = True
    done = remesh(change.mesh, edge, SIZES.passes, fixed=held, sealed=rim, apart=True)
    return change.then(stayed(change.mesh, done.mesh, done.origin))


def stayed(old: Mesh, new: Mesh, origin: IntArray) -> Change:
    """Return a change in which vertices that have moved count as new."""
    known = np.flatnonzero(origin >= 0)
    same = (new.vertices_numpy()[known] == old.vertices_numpy()[origin[known]]).all(1)
    kept = np.full(len(origin), -1)
    kept[known[same]] = origin[known[same]]
    return Change(new, kept)


# -------------------------------------------------------------------------------- soundness


@dataclass(frozen=True, eq=False)
class Census:
    """The regions and walls of a mesh, kept up to date while parts of it change.

    Attributes
    ----------
    walls
        Number of faces between two regions, by both numbers, the larger one first.
    volumes
        um^3, by region.
    """

    walls: dict[tuple[int, int], int]
    volumes: dict[int, float]

    @staticmethod
    def of(mesh: Mesh, middle: FloatArray | None = None) -> Census:
        """Count a mesh; volumes of an open part are relative to ``middle``, (3,) um."""
        pairs, wall = mesh.interfaces()
        count = np.bincount(wall, minlength=len(pairs)).tolist()
        walls = {(a, b): n for (a, b), n in zip(pairs.tolist(), count, strict=True)}
        return Census(walls, mesh.volumes(middle))

    def with_part(self, before: Mesh, after: Mesh) -> Census:
        """Return the census after a part of the mesh has changed."""
        middle = before.vertices_numpy().mean(0)
        walls, volumes = dict(self.walls), dict(self.volumes)
        own_pairs = set[tuple[int, int]]()
        for mesh, sign in ((before, -1), (after, 1)):
            own = Census.of(mesh, middle)
            own_pairs.update(own.walls)
            for pair, count in own.walls.items():
                walls[pair] = walls.get(pair, 0) + sign * count
            for region, volume in own.volumes.items():
                volumes[region] = volumes.get(region, 0.0) + sign * volume
        gone = [pair for pair in own_pairs if not walls[pair]]
        for pair in gone:
            del walls[pair]
        if gone:  # rare, while this method is called thousands of times with many cells
            there = {region for pair in walls for region in pair}
            volumes = {r: v for r, v in volumes.items() if r in there}
        return Census(walls, volumes)

    @property
    def regions(self) -> set[int]:
        """All regions but the outside."""
        return set(self.volumes)

    @property
    def contacts(self) -> set[tuple[int, int]]:
        """Pairs of cells that share a wall, the smaller number first."""
        return between_cells(self.walls)

    @property
    def at_surface(self) -> set[int]:
        """Cells that meet the outside."""
        return {a for a, b in self.walls if b == OUTSIDE}


def fits(part: Submesh, change: Change) -> bool:
    """Whether a changed part keeps every region closed, and crosses nowhere.

    Its border must be as it was, as the rest closes the regions that are open there.
    """
    old = change.origin >= 0
    if not np.isin(np.flatnonzero(part.rim), change.origin[old]).all():
        return False
    corners = np.where(old, change.origin, -1)
    before, after = _open_edges(part.mesh), _open_edges(change.mesh)
    named = np.column_stack([after[:, 0], np.sort(corners[after[:, 1:]], axis=1)])
    if len(after) != len(before) or not np.array_equal(_sorted(named), _sorted(before)):
        return False
    branches = [m.edge_uses().max() for m in (change.mesh, part.mesh)]
    return bool(branches[0] <= max(SIZES.most_walls, branches[1])) and not crosses(change.mesh)


def _open_edges(mesh: Mesh) -> IntArray:
    """Return (n, 3) region and vertices of each edge that an odd number of its faces share."""
    edges, count = mesh.edges(), len(mesh.edges())
    keys = mesh.regions.T[:, :, None] * count + mesh.face_edges()
    found, times = np.unique(keys, return_counts=True)
    region, edge = np.divmod(found[times % 2 == 1], count)
    return np.column_stack([region, np.sort(edges[edge], axis=1)])


def _sorted(rows: IntArray) -> IntArray:
    return rows[np.lexsort(rows.T[::-1])]
