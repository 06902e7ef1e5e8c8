"""Lets thin sheets, necks and holes give way, on the mesh itself.

Where a region is thin between two others, one of these takes what lies between them: its own wall
there goes, that of the other side becomes a wall between the two, and a strip around closes the
thin region off. A neck is cut through and both ends are capped; a hole is a neck of what fills it.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations

import numpy as np
from scipy.spatial import cKDTree

from ..connected import sharing
from ..mesh import IntArray, Mesh, mesh_of_faces
from .change_sizes import SIZES
from .patches import Mask, Outward, cap, loops_around
from .submesh import Change, Submesh
from .thin_places import ThinPlace


def thinned(part: Submesh, place: ThinPlace, edge: float) -> Iterator[Change]:
    """Yield what a part may become when a thin place gives way; triangles are not good yet.

    Parameters
    ----------
    part
        The part around the place; its surfaces do not cross.
    place
        Place where one region is thin.
    edge
        um: the edge length of the mesh.
    """
    cut = _necks_cut if len(place.sides) == 1 else _sheet_opened
    middle = place.points[np.linalg.norm(place.points - place.center, axis=1).argmin()]
    for reach, extent in SIZES.thinned:
        own = np.linalg.norm(place.points - middle, axis=1) <= extent * edge
        away = cKDTree(place.points[own]).query(part.mesh.vertices_numpy())[0]
        near = (away < reach * edge)[part.mesh.faces].all(1)
        yield from cut(part.mesh, place, near)


# ------------------------------------------------------------------------ a sheet of a region


def _sheet_opened(mesh: Mesh, place: ThinPlace, near: Mask) -> Iterator[Change]:
    (thin,) = place.regions
    around = Outward(mesh, thin)
    for heir, other in permutations(place.sides):
        own = around.own & np.any(mesh.regions == heir, axis=1)
        facing = around.own & np.any(mesh.regions == other, axis=1)
        gone = _patch(mesh, near & own, place)
        # Within the other wall if it is large enough, else over the junctions around it.
        inner = _patch(mesh, near & facing & ~_at_junctions(mesh), place)
        wider = _patch(mesh, near & around.own & ~own, place, facing)
        wider = _grown_over_junctions(mesh, wider, around.own & ~own)
        for kept in (inner, wider):
            loops = [loops_around(around.faces, patch) for patch in (gone, kept)]
            if any(len(found) != 1 for found in loops) or set(loops[0][0]) & set(loops[1][0]):
                continue
            strip = _ring(mesh, ~gone, loops[0][0], loops[1][0][::-1])
            if strip is None:
                continue
            regions = mesh.regions.copy()
            regions[kept] = np.where(regions[kept] == thin, heir, regions[kept])
            yield _replaced(mesh, ~gone, regions, strip, (thin, heir))


def _at_junctions(mesh: Mesh) -> Mask:
    """Return the faces with a corner in a junction."""
    junction = np.zeros(len(mesh.vertices), bool)
    junction[mesh.edges()[mesh.edge_uses() > 2]] = True
    return np.asarray(junction[mesh.faces].any(1), dtype=bool)


def _grown_over_junctions(mesh: Mesh, patch: Mask, allowed: Mask) -> Mask:
    """Grow a patch of a region's surface until its border does not run along junctions.

    Empty if that is impossible.
    """
    patch, edge_of = patch.copy(), mesh.face_edges()
    junction = mesh.edge_uses() > 2
    surface = np.bincount(edge_of[allowed].reshape(-1), minlength=len(junction))
    for _ in range(SIZES.growing):
        within = np.bincount(edge_of[patch].reshape(-1), minlength=len(junction))
        bad = junction & (within == 1)
        if not bad.any():
            return patch
        if (surface[bad] != 2).any():  # the junction of the heir's wall
            break
        patch |= allowed & bad[edge_of].any(1)
    return np.zeros_like(patch)


# ------------------------------------------------------------------------------------- necks


def _necks_cut(mesh: Mesh, place: ThinPlace, near: Mask) -> Iterator[Change]:
    (thin,), (side,) = place.regions, place.sides
    around = Outward(mesh, thin)
    band = _patch(mesh, near & around.own & (mesh.regions == side).any(1), place)
    loops = loops_around(around.faces, band)
    if len(loops) != 2 or set(loops[0]) & set(loops[1]):
        return
    caps = np.concatenate([cap(mesh.vertices_numpy(), loop) for loop in loops])
    yield _replaced(mesh, ~band, mesh.regions, caps, (thin, side))


# --------------------------------------------------------------------------- patches and lines


def _patch(mesh: Mesh, mask: Mask, place: ThinPlace, seeds: Mask | None = None) -> Mask:
    """Return the group of faces, joined by edges within a mask, that is nearest to a place.

    With ``seeds``, one of these faces must be in the group.
    """
    rows = np.flatnonzero(mask)
    patch = np.zeros(len(mask), bool)
    start = np.flatnonzero(mask if seeds is None else mask & seeds)
    if not len(start):
        return patch
    middles = mesh.vertices_numpy()[mesh.faces[start]].mean(1)
    first = start[cKDTree(place.points).query(middles)[0].argmin()]
    number = sharing(mesh.face_edges()[rows], len(mesh.edges()))
    patch[rows[number == number[np.searchsorted(rows, first)]]] = True
    return patch


def _ring(mesh: Mesh, rest: Mask, one: list[int], other: list[int]) -> IntArray | None:
    """Join two closed lines that run the same way by triangles.

    The sum of squared diagonals is the least possible. Triangles follow the first line's edges, and
    those of the other one in reverse. None if that is impossible without an edge that other faces
    (rest) have already.
    """
    places = mesh.vertices_numpy()
    across = ((places[one][:, None] - places[other][None]) ** 2).sum(2)
    row, column = {v: i for i, v in enumerate(one)}, {v: j for j, v in enumerate(other)}
    for u, w in mesh.edges()[np.unique(mesh.face_edges()[rest])].tolist():
        for p, q in ((u, w), (w, u)):
            if p in row and q in column:
                across[row[p], column[q]] = np.inf
    i, j = (int(k) for k in np.unravel_index(int(across.argmin()), across.shape))
    one, other = [*one[i:], *one[: i + 1]], [*other[j:], *other[: j + 1]]
    across = np.roll(across, (-i, -j), (0, 1))
    across = across[np.ix_([*range(len(one) - 1), 0], [*range(len(other) - 1), 0])]
    m, n = across.shape
    cost = np.full((m, n), np.inf)
    cost[0] = np.cumsum(across[0])
    from_one = np.zeros((m, n), bool)
    for i in range(1, m):
        down = cost[i - 1] + across[i]
        cost[i, 0], from_one[i, 0] = down[0], True
        for j in range(1, n):
            right = cost[i, j - 1] + across[i, j]
            from_one[i, j] = down[j] <= right
            cost[i, j] = min(down[j], right)
    if not np.isfinite(cost[-1, -1]):
        return None
    faces = []
    i, j = m - 1, n - 1
    while i or j:
        if from_one[i, j]:
            faces.append([one[i - 1], one[i], other[j]])
            i -= 1
        else:
            faces.append([other[j], other[j - 1], one[i]])
            j -= 1
    return np.array(faces, np.int64)


def _replaced(
    mesh: Mesh, rest: Mask, regions: IntArray, added: IntArray, sides: tuple[int, int]
) -> Change:
    """Return a mesh with some faces left out and others added."""
    faces = np.concatenate([mesh.faces[rest], added])
    pairs = np.concatenate([regions[rest], np.tile(np.array(sides), (len(added), 1))])
    return Change(*mesh_of_faces(mesh.vertices_numpy(), faces, pairs))
