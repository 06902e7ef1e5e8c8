"""Make a usable mesh from the vertices and faces that a file holds, and say what was changed."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..common.words import counted
from ..errors import InputError
from .arrays import FloatArray, IntArray, to_numpy
from .connected import connected, sharing
from .mesh import OUTSIDE, Mesh
from .windings import fix_windings

MERGE_TOLERANCE = 1e-9  # of the box's diagonal: 0.1 picometre in 100 um is only rounding
FLAT_TOLERANCE = 1e-12  # height of a triangle over its longest edge


def repair(vertices: Any, faces: Any, regions: Any = None) -> tuple[Mesh, list[str]]:
    """Clean raw mesh data and orient it; report each change.

    Parameters
    ----------
    vertices : (V, 3) um, Z, Y, X.
    faces : (F, 3) integers.
    regions : (F, 2) integers, optional; as in ``Mesh``.

    Returns
    -------
    mesh : Mesh
        The larger region number comes first in each row of its regions.
    messages : list of str
        What was changed, in plain words with counts; empty if nothing was.

    Notes
    -----
    In this order: vertices that coincide (within 1e-9 of the bounding box diagonal) become one;
    faces that use a vertex twice, or have the same region on both sides, go; faces of zero area
    go, and where their middle vertex lies on an edge of other faces, those are split there, so
    that a closed surface stays closed; duplicate faces go; unused vertices go; the two regions of
    a face are put in the same order everywhere; windings are made to agree (``fix_windings``).
    Two coincident faces stay if a closed surface needs both (two bodies that touch).

    Raises InputError if there is nothing to make a mesh of: wrong shapes, indices out of range,
    NaN or infinite positions in use, no faces left.
    """
    messages: list[str] = []
    points, triangles, labels = _arrays(vertices, faces, regions)
    keep = labels[:, 0] != labels[:, 1]
    _note(messages, (~keep).sum(), "removed {} with the same region on both sides", "face")
    triangles, labels = triangles[keep], labels[keep]

    points, triangles = _without_unused(points, triangles, messages)
    points, triangles = _merged(points, triangles, messages)
    keep = ~_repeated(triangles)
    _note(messages, (~keep).sum(), "removed {} that used a vertex twice", "face")
    triangles, labels = _without_flat(points, triangles[keep], labels[keep], messages)
    triangles, labels = _in_order(triangles, labels, messages)
    keep = _first_copies(triangles, labels)
    _note(messages, (~keep).sum(), "removed {}", "duplicate face")
    if not keep.any():
        raise InputError("no usable face is left: every face is degenerate")
    triangles, labels = triangles[keep], labels[keep]

    points, triangles = _without_unused(points, triangles)
    mesh, winding_messages = fix_windings(Mesh(points, triangles, labels))
    return mesh, messages + winding_messages


def _note(messages: list[str], n: int, text: str, noun: str) -> None:
    if n:
        messages.append(text.format(counted(int(n), noun)))


def _arrays(vertices: Any, faces: Any, regions: Any) -> tuple[FloatArray, IntArray, IntArray]:
    """Check shapes and indices. Positions are checked later, as unused ones do not matter."""
    points = to_numpy(vertices).astype(np.float64)
    labels = None if regions is None else to_numpy(regions)
    same = None
    if labels is not None and labels.ndim == 2 and labels.shape[1:] == (2,):
        same = labels[:, 0] == labels[:, 1]
        labels = np.where(same[:, None], [1, OUTSIDE], labels)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"vertices must have shape (n, 3), not {points.shape}")
    checked = Mesh(np.zeros_like(points), faces, labels)  # Mesh's own checks
    result = checked.regions
    if same is not None:
        result = np.where(same[:, None], OUTSIDE, result)
    return points, checked.faces, result


def _without_unused(
    points: FloatArray, faces: IntArray, messages: list[str] | None = None
) -> tuple[FloatArray, IntArray]:
    used, index = np.unique(faces, return_inverse=True)
    if messages is not None:
        _note(messages, len(points) - len(used), "removed {}", "unused vertex")
    return points[used], index.reshape(-1, 3)


def _merged(
    points: FloatArray, faces: IntArray, messages: list[str]
) -> tuple[FloatArray, IntArray]:
    """Merge vertices that coincide; they take the position of the first one."""
    n_bad = int((~np.isfinite(points)).any(axis=1).sum())
    if n_bad:
        raise InputError(f"{n_bad} of {len(points)} vertices are NaN or infinite")
    if len(points) == 0:
        raise InputError("the mesh is empty: it has no faces")
    # Exact copies first: many of them in one place would make the pairs below explode.
    unique, first, inverse = np.unique(points, axis=0, return_index=True, return_inverse=True)
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    pairs = cKDTree(unique).query_pairs(MERGE_TOLERANCE * diagonal, output_type="ndarray")
    group = connected(pairs, len(unique))
    n_groups = int(group.max()) + 1
    if n_groups == len(points):
        return points, faces
    _note(messages, len(points) - n_groups, "merged {} into others", "duplicate vertex")
    # Keep the order of the file: groups are numbered by their first vertex.
    lowest = np.full(n_groups, len(points))
    np.minimum.at(lowest, group, first)
    order = np.argsort(lowest)
    rank = np.empty(n_groups, dtype=np.int64)
    rank[order] = np.arange(n_groups)
    return points[lowest[order]], rank[group[inverse.reshape(-1)]][faces]


def _repeated(faces: IntArray) -> NDArray[np.bool_]:
    return (faces == np.roll(faces, 1, axis=1)).any(axis=1)


# ---- zero area ----------------------------------------------------------------------------------


def _flat(points: FloatArray, faces: IntArray) -> tuple[NDArray[np.bool_], IntArray]:
    """Return (F,) which faces have no area, and the corner opposite each face's longest edge."""
    corners = points[faces]
    edges = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)  # opposite each corner
    lengths = np.linalg.norm(edges, axis=2)
    double_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    longest = lengths.max(axis=1)
    # Far from the origin, rounding of the positions themselves gives collinear points a height.
    rounding = 8 * np.finfo(np.float64).eps * np.abs(corners).max(axis=(1, 2))
    limit = np.maximum(FLAT_TOLERANCE * longest, rounding) * longest
    return double_area <= limit, lengths.argmax(axis=1)


def _without_flat(
    points: FloatArray, faces: IntArray, regions: IntArray, messages: list[str]
) -> tuple[IntArray, IntArray]:
    n_flat = int(_flat(points, faces)[0].sum())
    _note(messages, n_flat, "removed {} of zero area", "face")
    # Each pass shortens the longest edge of the flat faces, so this ends; the cap is for safety.
    for _ in range(50 if n_flat else 0):
        flat, apex = _flat(points, faces)
        if not flat.any():
            return faces, regions
        faces, regions = _split_at_flat(faces, regions, np.nonzero(flat)[0], apex)
    keep = ~_flat(points, faces)[0] if n_flat else slice(None)
    return faces[keep], regions[keep]


def _split_at_flat(
    faces: IntArray, regions: IntArray, flat: IntArray, apex: IntArray
) -> tuple[IntArray, IntArray]:
    """Remove flat faces, and split the other faces at their longest edge by their apex.

    An edge of a flat face a-m-b that others share as a-b would be left open; with the others
    split at m, each region's surface stays closed, also where more than two faces meet.
    """
    by_edge = defaultdict(list)
    wanted = {frozenset(np.delete(faces[f], apex[f]).tolist()) for f in flat}
    rows = np.nonzero(np.isin(faces, faces[flat]).sum(axis=1) >= 2)[0]
    for row in rows.tolist():
        for corner in range(3):
            edge = frozenset(np.delete(faces[row], corner).tolist())
            if edge in wanted:
                by_edge[edge].append((row, corner))
    removed: set[int] = set()
    new_faces, new_regions = [], []
    for f in flat.tolist():
        around = by_edge[frozenset(np.delete(faces[f], apex[f]).tolist())]
        if any(row in removed for row, _ in around):
            continue  # a neighbour has changed: next pass
        middle = faces[f, apex[f]]
        removed.update(row for row, _ in around)
        for row, corner in around:
            if row == f:
                continue
            for end in (1, 2):
                part = faces[row].copy()
                part[(corner + end) % 3] = middle
                if len(set(part.tolist())) == 3:
                    new_faces.append(part)
                    new_regions.append(regions[row])
    keep = np.ones(len(faces), dtype=bool)
    keep[list(removed)] = False
    return (
        np.concatenate([faces[keep], np.reshape(new_faces, (-1, 3)).astype(np.int64)]),
        np.concatenate([regions[keep], np.reshape(new_regions, (-1, 2)).astype(np.int64)]),
    )


# ---- duplicates and label order ------------------------------------------------------------------


def _in_order(faces: IntArray, regions: IntArray, messages: list[str]) -> tuple[IntArray, IntArray]:
    """Put the larger region number first in each row; the winding turns with it."""
    turned = regions[:, 0] < regions[:, 1]
    ordered = np.where(turned[:, None], regions[:, ::-1], regions)
    # Only a wall written in both ways is a flaw; writing all of it as (0, 1) is just a convention.
    _, wall = np.unique(ordered, axis=0, return_inverse=True)
    wall = wall.reshape(-1)
    total, n_turned = np.bincount(wall), np.bincount(wall, turned)
    n_mixed = int(np.minimum(n_turned, total - n_turned).sum())
    _note(messages, n_mixed, "put the regions of {} in the order of the rest of the wall", "face")
    return np.where(turned[:, None], faces[:, ::-1], faces), ordered


def _first_copies(faces: IntArray, regions: IntArray) -> NDArray[np.bool_]:
    """Return (F,) which faces to keep, so that none is there twice without need.

    Coincident faces are judged by the patch that they form. One copy stays if that opens no edge.
    Where it would, the patch is a contact of two surfaces, which both need it: as many copies stay
    as keep the surface closed, one or two.
    """
    named = np.column_stack([np.sort(faces, axis=1), regions])
    _, group, counts = np.unique(named, axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    order = np.argsort(group, kind="stable")
    copy = np.empty(len(faces), dtype=np.int64)  # 0 for the first of a group, 1 for the second...
    copy[order] = np.arange(len(faces)) - np.repeat(np.cumsum(counts) - counts, counts)
    if (counts == 1).all():
        return copy == 0
    index = Mesh(np.zeros((int(faces.max()) + 1, 3)), faces).face_edges()
    # Edges of one region: the larger number of a pair is never the outside.
    _, edge = np.unique(index + regions[:, :1] * (index.max() + 1), return_inverse=True)
    edge = edge.reshape(-1, 3)
    n_edges = int(edge.max()) + 1
    doubled = np.nonzero(counts[group] > 1)[0]
    patch = sharing(edge[doubled], n_edges)

    odd_now, odd_single = (
        np.bincount(edge[rows].reshape(-1), minlength=n_edges) % 2
        for rows in (copy >= 0, copy == 0)
    )
    border = np.unique(np.stack([np.repeat(patch, 3), edge[doubled].reshape(-1)]), axis=1)
    opened = np.bincount(border[0], (odd_single - odd_now)[border[1]])
    others = np.setdiff1d(np.arange(len(faces)), doubled)
    alone = np.isin(edge, edge[others]).sum(axis=1) == 0
    n_direct = np.bincount(group, _is_direct(faces))
    mixed = (n_direct > 0) & (n_direct < counts)  # both windings occur
    needed = ~alone[doubled] | mixed[group[doubled]]
    contact = np.logical_and(opened > 0, np.bincount(patch, needed) > 0)
    keep = copy == 0
    keep[doubled] |= contact[patch] & (copy[doubled] == 1) & (counts[group[doubled]] % 2 == 0)
    return keep


def _is_direct(faces: IntArray) -> NDArray[np.bool_]:
    """Whether the corner after the smallest index is the middle one, not the largest."""
    follower = faces[np.arange(len(faces)), (faces.argmin(axis=1) + 1) % 3]
    return np.equal(follower, np.sort(faces, axis=1)[:, 1])
