"""Finds and removes pieces of regions apart from the rest: pockets, and fragments of cells."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..compiled import native
from ..mesh import OUTSIDE, IntArray, Mesh, mesh_of_faces
from .submesh import Change, Submesh
from .thin_places import ThinPlace


def small_pieces(mesh: Mesh, volume: float) -> list[ThinPlace]:
    """Find the pieces of regions that are smaller than ``volume`` um^3 and may vanish.

    These are pockets of the outside that cells enclose, and all pieces of a cell but its largest.
    """
    pieces = _Pieces(mesh)
    small = pieces.outer & (pieces.volume < volume) & ~pieces.largest
    places = []
    for k, rows in zip(np.flatnonzero(small).tolist(), pieces.faces_of(small), strict=True):
        region, size = int(pieces.region[k]), float(pieces.volume[k])
        around = mesh.regions[rows]
        sides = tuple(np.unique(around[around != region]).tolist())
        corners = mesh.vertices_numpy()[mesh.faces[rows]]
        points = np.concatenate([corners.reshape(-1, 3), corners.mean(1)])
        width = float(np.cbrt(size))
        places.append(ThinPlace((region,), sides, np.unique(points, axis=0), width, size))
    return places


def absorbed(part: Submesh, place: ThinPlace, _: float) -> Iterator[Change]:
    """Yield a part in which a small piece belongs to the cell with the largest border to it.

    If it borders only the outside, it vanishes. Yields nothing if the piece is gone. Triangles are
    not good yet.

    Parameters
    ----------
    part
        The part around the piece; it may have changed a little since the piece was found.
    place
        From :func:`small_pieces`.
    """
    mesh, region = part.mesh, place.regions[0]
    rows = _rows_of(part, place)
    if rows is None:
        return
    beyond, rank = np.unique(mesh.regions[rows].sum(1) - region, return_inverse=True)
    areas = np.bincount(rank, mesh.areas()[rows])
    areas[beyond == OUTSIDE] = 0
    heir = int(beyond[areas.argmax()])
    regions = mesh.regions.copy()
    regions[rows] = np.where(regions[rows] == region, heir, regions[rows])
    kept = regions[:, 0] != regions[:, 1]
    if not kept.any():
        return
    yield Change(*mesh_of_faces(mesh.vertices_numpy(), mesh.faces[kept], regions[kept]))


def _rows_of(part: Submesh, place: ThinPlace) -> IntArray | None:
    """Return the faces around a piece; None if the piece is gone."""
    mesh, pieces = part.mesh, _Pieces(part.mesh)
    open_ones = np.zeros(len(pieces.region), bool)
    open_ones[pieces.piece[part.rim[mesh.faces].any(1)]] = True
    fit = pieces.outer & ~open_ones & (pieces.region == place.regions[0])
    fit &= pieces.volume < 2 * place.volume
    vertices = mesh.vertices_numpy()
    for rows in pieces.faces_of(fit):
        if np.linalg.norm(vertices[mesh.faces[rows]].mean((0, 1)) - place.center) < place.width:
            return rows
    return None


class _Pieces:
    """The connected pieces of all regions.

    A piece is what one outer shell encloses. Inner shells, around things within a region, and the
    shells of a cluster seen from outside have negative volumes.

    Attributes
    ----------
    piece
        (F, 2) number of the piece that each face bounds on each of its sides.
    region, volume
        (P,) region and volume (um^3) of each piece.
    outer
        (P,) bool: pieces with a positive volume.
    largest
        (P,) bool: the largest piece of each cell.
    """

    def __init__(self, mesh: Mesh) -> None:
        library = native()
        assert library is not None, "pieces are only looked for where meshes can be changed"
        self.piece: IntArray = library.region_pieces(
            np.ascontiguousarray(mesh.face_edges()),
            np.ascontiguousarray(mesh.regions),
            len(mesh.edges()),
        )
        count = int(self.piece.max()) + 1
        self.region = np.zeros(count, np.int64)
        self.region[self.piece] = mesh.regions
        signed = mesh.signed_volumes()
        self.volume = np.bincount(self.piece[:, 0], signed, count)
        self.volume -= np.bincount(self.piece[:, 1], signed, count)
        self.outer = self.volume > 0
        order = np.lexsort((self.volume, self.region))
        last = np.append(np.diff(self.region[order]) != 0, True)
        self.largest = np.zeros(count, bool)
        self.largest[order[last]] = True
        self.largest &= self.region != OUTSIDE

    def faces_of(self, chosen: NDArray[np.bool_]) -> list[IntArray]:
        """Return the rows of the faces of each chosen piece."""
        rows, side = np.nonzero(chosen[self.piece])
        number = self.piece[rows, side]
        order = np.argsort(number, kind="stable")
        ends = np.searchsorted(number[order], np.flatnonzero(chosen), side="right")
        return np.split(rows[order], ends[:-1]) if len(ends) else []
