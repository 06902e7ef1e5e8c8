"""Projects a new mesh of the same regions onto an old one: walls and junctions each on theirs."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..compiled import native
from ..mesh import FloatArray, IntArray, Mesh
from .change_sizes import SIZES
from .region_sets import RegionSets, edge_sets, vertex_sets


def projected(mesh: Mesh, onto: Mesh, weight: FloatArray, edge: float) -> Mesh:
    """Move the vertices of a mesh to the nearest points of another one.

    Vertices within walls go to walls between the same regions, and those of junctions to junctions
    of the same regions; those of regions that only one of the meshes has stay.

    Parameters
    ----------
    mesh, onto
        Triangulations of the same regions.
    weight
        (V,) share of the way by which each vertex is moved.
    edge
        um: the edge length of the meshes.
    """
    places = mesh.vertices_numpy()
    target = places.copy()
    own = vertex_sets(mesh)
    moving = (weight > 0) & (own.size > 1)
    _to_faces(target, np.flatnonzero(moving & (own.size == 2)), mesh, own, onto, edge)
    _to_junctions(target, np.flatnonzero(moving & (own.size > 2)), own, onto, edge)
    moved = places + weight[:, None] * (target - places)
    return mesh.with_vertices(moved)


def _to_faces(
    target: FloatArray, rows: IntArray, mesh: Mesh, own: RegionSets, onto: Mesh, edge: float
) -> None:
    library = native()
    if library is None or not len(rows):
        return
    places = mesh.vertices_numpy()[rows]
    pairs, points = library.near_faces(
        np.ascontiguousarray(places),
        np.ascontiguousarray(onto.vertices_numpy()),
        np.ascontiguousarray(onto.faces),
        SIZES.counterpart * edge,
    )
    vertex, face = pairs.T
    same = own.key[rows[vertex]] == RegionSets.of_rows(onto.regions).key[face]
    vertex, points = vertex[same], points[same]
    apart = np.linalg.norm(points - places[vertex], axis=1)
    order = np.lexsort((apart, vertex))
    found, first = np.unique(vertex[order], return_index=True)
    target[rows[found]] = points[order[first]]


def _to_junctions(
    target: FloatArray, rows: IntArray, own: RegionSets, onto: Mesh, edge: float
) -> None:
    if not len(rows):
        return
    sample, keys = _junction_points(onto)
    order = np.argsort(keys, kind="stable")
    sample, keys = sample[order], keys[order]
    rows = rows[np.argsort(own.key[rows], kind="stable")]
    kinds, first = np.unique(own.key[rows], return_index=True)
    for key, members in zip(kinds, np.split(rows, first[1:]), strict=True):
        there = sample[np.searchsorted(keys, key) : np.searchsorted(keys, key, side="right")]
        if not len(there):
            continue
        apart, nearest = cKDTree(there).query(target[members])
        close = apart < SIZES.counterpart * edge
        target[members[close]] = there[nearest[close]]


def _junction_points(onto: Mesh) -> tuple[FloatArray, np.ndarray]:
    """Return points along the junctions, and the key of the regions that meet in each."""
    along, at = edge_sets(onto), vertex_sets(onto)
    rows = np.flatnonzero(along.size > 2)
    a, b = (onto.vertices_numpy()[onto.edges()[rows, k]] for k in (0, 1))
    share = (np.arange(SIZES.along) + 0.5) / SIZES.along
    within = (a[:, None] + share[:, None] * (b - a)[:, None]).reshape(-1, 3)
    corners = np.unique(onto.edges()[rows])
    places = np.concatenate([within, onto.vertices_numpy()[corners]])
    return places, np.concatenate([np.repeat(along.key[rows], SIZES.along), at.key[corners]])
