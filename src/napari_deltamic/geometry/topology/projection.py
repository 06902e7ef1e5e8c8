"""A new mesh of the same regions brought back onto an old one: walls on walls, junctions on
junctions."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from napari_deltamic.geometry.mesh import FloatArray, IntArray, Mesh
from napari_deltamic.geometry.native import native

_REACH = 0.7  # edge lengths: what has no counterpart within is left where it is
_ALONG = 8  # points of a junction edge in which the nearest is looked for


def projected(mesh: Mesh, onto: Mesh, weight: FloatArray, edge: float) -> Mesh:
    """The mesh with vertices moved to the nearest point of another one.

    Vertices within walls go to walls between the same regions, those of junctions to junctions of
    the same regions.

    Parameters
    ----------
    mesh, onto
        Of the same regions.
    weight
        (V,) share of the way that each vertex goes.
    edge
        um: the edge length of the meshes.
    """
    places = mesh.vertices_numpy()
    target = places.copy()
    own, others = _sets(mesh), _sets(onto)
    inner = own.sum(1) == 2
    moving = (weight > 0) & (own.any(1))
    _to_faces(target, np.flatnonzero(moving & inner), mesh, own, onto, edge)
    sample, bits = _junction_points(onto, others)
    if len(sample):
        _to_points(target, np.flatnonzero(moving & ~inner), own, sample, bits, edge)
    moved = places + weight[:, None] * (target - places)
    return mesh.with_vertices(moved)


def _sets(mesh: Mesh) -> np.ndarray:
    """(V, R) bool: the regions that meet in each vertex."""
    bits = np.zeros((len(mesh.vertices), int(mesh.regions.max()) + 1), bool)
    for side in (0, 1):
        bits[mesh.faces, mesh.regions[:, side][:, None]] = True
    return bits


def _to_faces(
    target: FloatArray, rows: IntArray, mesh: Mesh, own: np.ndarray, onto: Mesh, edge: float
) -> None:
    library = native()
    if library is None or not len(rows):
        return
    places = mesh.vertices_numpy()[rows]
    pairs, points = library.near_faces(
        np.ascontiguousarray(places),
        np.ascontiguousarray(onto.vertices_numpy()),
        np.ascontiguousarray(onto.faces),
        _REACH * edge,
    )
    vertex, face = pairs.T
    same = own[rows[vertex][:, None], onto.regions[face]].all(1)
    vertex, points = vertex[same], points[same]
    apart = np.linalg.norm(points - places[vertex], axis=1)
    order = np.lexsort((apart, vertex))
    found, first = np.unique(vertex[order], return_index=True)
    target[rows[found]] = points[order[first]]


def _junction_points(onto: Mesh, others: np.ndarray) -> tuple[FloatArray, np.ndarray]:
    """Points along the junctions, and the regions that meet in each."""
    ends = np.sort(onto.faces[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2), axis=1)
    edges, count = np.unique(ends, axis=0, return_counts=True)
    edges = edges[count > 2]
    if not len(edges):
        return np.zeros((0, 3)), np.zeros((0, others.shape[1]), bool)
    places = onto.vertices_numpy()
    share = (np.arange(_ALONG) + 0.5) / _ALONG
    a, b = places[edges[:, 0]], places[edges[:, 1]]
    within = (a[:, None] + share[:, None] * (b - a)[:, None]).reshape(-1, 3)
    common = np.repeat(others[edges[:, 0]] & others[edges[:, 1]], _ALONG, axis=0)
    corners = np.unique(edges)
    return np.concatenate([within, places[corners]]), np.concatenate([common, others[corners]])


def _to_points(
    target: FloatArray,
    rows: IntArray,
    own: np.ndarray,
    sample: FloatArray,
    bits: np.ndarray,
    edge: float,
) -> None:
    kinds, kind = np.unique(own[rows], axis=0, return_inverse=True)
    for k, wanted in enumerate(kinds):
        there = (bits == wanted[: bits.shape[1]]).all(1) & ~wanted[bits.shape[1] :].any()
        if not there.any():
            continue
        members = rows[kind.reshape(-1) == k]
        apart, nearest = cKDTree(sample[there]).query(target[members])
        close = apart < _REACH * edge
        target[members[close]] = sample[there][nearest[close]]
