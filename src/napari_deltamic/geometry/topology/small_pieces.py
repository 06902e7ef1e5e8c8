"""Pieces of regions that lie apart from the rest: pockets between cells, fragments of cells."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from napari_deltamic.geometry.mesh import OUTSIDE, IntArray, Mesh
from napari_deltamic.geometry.topology.flips import tidied
from napari_deltamic.geometry.topology.thin_places import ThinPlace


def small_pieces(mesh: Mesh, volume: float) -> list[ThinPlace]:
    """Pieces of regions that are smaller than ``volume`` um^3 and may vanish.

    A pocket of the outside that cells enclose is one, and each piece of a cell but its largest.
    """
    places = []
    for region in (OUTSIDE, *mesh.region_ids().tolist()):
        pieces = _pieces(mesh, region)
        for rows, size in pieces if region == OUTSIDE else pieces[1:]:
            if size >= volume:
                continue
            around = mesh.regions[rows]
            sides = tuple(np.unique(around[around != region]).tolist())
            corners = mesh.vertices_numpy()[mesh.faces[rows]]
            points = np.concatenate([corners.reshape(-1, 3), corners.mean(1)])
            width = float(np.cbrt(size))
            places.append(ThinPlace((region,), sides, np.unique(points, axis=0), width, size))
    return places


def absorbed(mesh: Mesh, place: ThinPlace, edge: float) -> Mesh | None:
    """The mesh with a small piece given to the cell with the largest border to it.

    Outside the cells it vanishes. None if the piece is not there.

    Parameters
    ----------
    mesh
        Closed regions; it may have changed a little since the piece was found.
    place
        From :func:`small_pieces`.
    edge
        um: the edge length of the mesh.
    """
    region = place.regions[0]
    rows = _rows_of(mesh, place)
    if rows is None:
        return None
    beyond = mesh.regions[rows].sum(1) - region
    areas = np.bincount(beyond, mesh.areas()[rows])
    areas[OUTSIDE] = 0
    heir = int(areas.argmax())
    regions = mesh.regions.copy()
    regions[rows] = np.where(regions[rows] == region, heir, regions[rows])
    kept = regions[:, 0] != regions[:, 1]
    used, index = np.unique(mesh.faces[kept], return_inverse=True)
    return tidied(
        Mesh(mesh.vertices_numpy()[used], index.reshape(-1, 3), regions[kept]), place, edge
    )


def _rows_of(mesh: Mesh, place: ThinPlace) -> IntArray | None:
    """The faces around a piece."""
    vertices = mesh.vertices_numpy()
    for rows, size in _pieces(mesh, place.regions[0]):
        apart = np.linalg.norm(vertices[mesh.faces[rows]].mean((0, 1)) - place.center)
        if size < 2 * place.volume and apart < place.width:
            return rows
    return None


def _pieces(mesh: Mesh, region: int) -> list[tuple[IntArray, float]]:
    """Rows of faces and volume (um^3) of each piece of a region, the largest first.

    A piece is what one outer shell encloses: inner ones, around what lies within a region, and the
    shells of a cluster seen from outside have negative volumes.
    """
    rows = np.flatnonzero((mesh.regions == region).any(axis=1))
    edge = mesh.face_edges()[rows]
    count, n = len(rows), len(rows) + len(mesh.edges())
    graph = coo_matrix(
        (np.ones(3 * count), (np.repeat(np.arange(count), 3), count + edge.reshape(-1))),
        shape=(n, n),
    )
    number = connected_components(graph, directed=False)[1][:count]
    _, number = np.unique(number, return_inverse=True)
    outward = np.where(mesh.regions[rows, 0] == region, 1.0, -1.0)
    volumes = np.bincount(number, outward * mesh.signed_volumes()[rows])
    order = np.argsort(-volumes, kind="stable")
    return [(rows[number == k], float(volumes[k])) for k in order if volumes[k] > 0]
