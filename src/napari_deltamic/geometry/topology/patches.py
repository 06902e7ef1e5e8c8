"""Patches of a surface: the closed lines around them, what fills these, and what is cut off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..mesh import OUTSIDE, FloatArray, IntArray, Mesh, mesh_of_faces

Mask = NDArray[np.bool_]


class Outward:
    """A region's faces (own), and all faces turned so that the region lies behind its own."""

    def __init__(self, mesh: Mesh, region: int) -> None:
        self.own: Mask = (mesh.regions == region).any(1)
        turned = mesh.regions[:, 1] == region
        self.faces: IntArray = np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces)


def loops_around(faces: IntArray, patch: Mask) -> list[list[int]]:
    """Return the closed lines around a patch of faces, as these run; none if one touches itself."""
    ends = faces[patch][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()
    directed = {(u, w) for u, w in ends}
    border = [(u, w) for u, w in directed if (w, u) not in directed]
    after = dict(sorted(border))
    if len(after) != len(border):
        return []
    loops = []
    while after:
        first = next(iter(after))
        loop, at = [first], after.pop(first)
        while at != first:
            if at not in after:
                return []
            loop.append(at)
            at = after.pop(at)
        loops.append(loop)
    return loops


def cap(places: FloatArray, loop: Sequence[int]) -> IntArray:
    """Fill a closed line with triangles; the squared lengths of diagonals have the least sum.

    G. T. Klincsek, "Minimal triangulations of polygonal domains", Ann. Discrete Math. 9, 1980.
    """
    n, points = len(loop), places[list(loop)]
    square = ((points[:, None] - points[None]) ** 2).sum(2)
    cost, between = np.zeros((n, n)), np.zeros((n, n), np.int64)
    for width in range(2, n):
        for i in range(n - width):
            j = i + width
            total = cost[i, i + 1 : j] + cost[i + 1 : j, j]
            best = int(total.argmin())
            cost[i, j], between[i, j] = total[best] + square[i, j], i + 1 + best
    faces, waiting = [], [(0, n - 1)]
    while waiting:
        i, j = waiting.pop()
        if j - i > 1:
            k = int(between[i, j])
            faces.append([loop[i], loop[k], loop[j]])
            waiting += [(i, k), (k, j)]
    return np.array(faces, np.int64).reshape(-1, 3)


def cut_off(mesh: Mesh, region: int, gone: Mask) -> Mesh | None:
    """The mesh without a part of the surface of a cell; a fan of triangles closes each hole.

    None where that part leaves nothing, or its border touches itself.

    Parameters
    ----------
    mesh
        Closed surfaces.
    region
        The cell; it touches no other.
    gone
        (F,) bool: the part.
    """
    around = Outward(mesh, region)
    gone = _without_notches(mesh, gone & around.own, around.own)
    loops = loops_around(around.faces, gone)
    if not loops:
        return None
    places = mesh.vertices_numpy()
    middles = np.array([places[loop].mean(0) for loop in loops])
    fans = [_fan(loop, len(places) + n) for n, loop in enumerate(loops)]
    faces = np.concatenate([mesh.faces[~gone], *fans])
    added = len(faces) - int((~gone).sum())
    pairs = np.concatenate([mesh.regions[~gone], np.tile((region, OUTSIDE), (added, 1))])
    return mesh_of_faces(np.concatenate([places, middles]), faces, pairs)[0]


def _without_notches(mesh: Mesh, patch: Mask, allowed: Mask) -> Mask:
    """A patch grown until no face beside it has two of its edges in the border."""
    patch, edge_of = patch.copy(), mesh.face_edges()
    while True:
        uses = np.bincount(edge_of[patch].ravel(), minlength=len(mesh.edges()))
        notches = allowed & ~patch & ((uses == 1)[edge_of].sum(1) >= 2)
        if not notches.any():
            return patch
        patch |= notches


def _fan(loop: Sequence[int], middle: int) -> IntArray:
    """Triangles around a middle that face as those did which a closed line ran around."""
    return np.array([(a, b, middle) for a, b in zip(loop, [*loop[1:], loop[0]], strict=True)])
