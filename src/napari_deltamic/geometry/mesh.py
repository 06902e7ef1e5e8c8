"""The multimaterial triangle mesh that everything else reads."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from .arrays import FloatArray, IntArray, checked_vertices, is_tensor, to_numpy
from .connectivity import OUTSIDE, Connectivity
from .trimesh_exchange import from_trimesh, to_trimesh

__all__ = ["OUTSIDE", "FloatArray", "IntArray", "Mesh", "mesh_of_faces"]


class Mesh:
    """Triangles that separate regions (cells); they may share walls and meet in junctions.

    Parameters
    ----------
    vertices : (V, 3) array or torch tensor, um
        Positions in Z, Y, X order. An array is copied to float64. A tensor is kept as it is, so
        that rendering is differentiable in a tensor that requires grad.
    faces : (F, 3) integers
        Vertex indices, from 0.
    regions : (F, 2) integers, optional
        Row (a, b): the face's normal points from region a to region b; 0 is the outside.
        By default (1, 0) for every face: one closed region.

    Notes
    -----
    *Normal.* Seen from its side b, a face's vertices run counter-clockwise in right-handed
    physical space (x, y, z). A file in x, y, z with the usual outward winding therefore gives
    positive volumes. In Z, Y, X components the axes are left-handed, so the normal is *minus*
    the cross product of the edge vectors; ``normals`` does this.

    Treat ``vertices``, ``faces`` and ``regions`` as read-only; use ``with_vertices`` to move
    vertices.

    Raises
    ------
    InputError
        For wrong shapes, no faces, indices out of range, vertices that are NaN, infinite or 1e12 um
        away, negative region numbers, or the same region on both sides of a face.
    """

    def __init__(self, vertices: Any, faces: Any, regions: Any = None) -> None:
        self.vertices = checked_vertices(vertices)
        self._connectivity = Connectivity(faces, regions, len(self.vertices))

    @property
    def faces(self) -> IntArray:
        """Vertex indices, (F, 3) int64."""
        return self._connectivity.faces

    @property
    def regions(self) -> IntArray:
        """Region pairs, (F, 2) int64: the normal points from the first to the second."""
        return self._connectivity.regions

    def __repr__(self) -> str:
        n_regions = len(self.region_ids())
        return f"Mesh({len(self.vertices)} vertices, {len(self.faces)} faces, {n_regions} regions)"

    # ---- vertices ---------------------------------------------------------------------------

    def vertices_numpy(self) -> FloatArray:
        """Vertices as a float64 array, (V, 3) um Z, Y, X; detached if they are a tensor."""
        return to_numpy(self.vertices).astype(np.float64, copy=False)

    def with_vertices(self, vertices: Any) -> Mesh:
        """The same connectivity (shared, not copied) with other vertices, (V, 3) um Z, Y, X.

        Raises InputError for another number of vertices, NaN or infinite values.
        """
        vertices = checked_vertices(vertices)
        if len(vertices) != self._connectivity.n_vertices:
            raise InputError(
                f"expected {self._connectivity.n_vertices} vertices, got {len(vertices)}"
            )
        mesh = Mesh.__new__(Mesh)
        mesh.vertices = vertices
        mesh._connectivity = self._connectivity
        return mesh

    def translated(self, offset: Sequence[float] | FloatArray) -> Mesh:
        """The mesh moved by ``offset``, (3,) um in Z, Y, X order."""
        return self.with_vertices(self.vertices + _like(_triple(offset, "offset"), self.vertices))

    def bounds(self) -> FloatArray:
        """Lowest and highest vertex coordinates, (2, 3) um Z, Y, X."""
        vertices = self.vertices_numpy()
        return np.stack([vertices.min(axis=0), vertices.max(axis=0)])

    # ---- faces ------------------------------------------------------------------------------

    def _area_vectors(self) -> FloatArray:
        """Normal times twice the area of each face, (F, 3) um^2 Z, Y, X."""
        corners = self.vertices_numpy()[self.faces]
        # Z, Y, X components are left-handed: hence the sign.
        return -np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    def areas(self) -> FloatArray:
        """Area of each face, (F,) um^2."""
        # Half the norm of a cross product: Heron's formula fails on needles.
        return 0.5 * np.linalg.norm(self._area_vectors(), axis=1)

    def normals(self) -> FloatArray:
        """Unit normal of each face, from region a to region b, (F, 3) Z, Y, X; 0 if no area."""
        vectors = self._area_vectors()
        lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
        return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)

    def membranes(self) -> FloatArray:
        """Number of membranes in each face, (F,): the default density of a render.

        1 where one side is the outside; 2 for a wall between two regions, because each of the
        two cells brings its own membrane.
        """
        return np.where((self.regions == OUTSIDE).any(axis=1), 1.0, 2.0)

    # ---- regions ----------------------------------------------------------------------------

    def region_ids(self) -> IntArray:
        """Sorted region numbers, without 0 (the outside)."""
        return self._connectivity.region_ids

    def faces_by_region(self) -> dict[int, IntArray]:
        """Rows of the faces of each region, increasing."""
        return self._connectivity.faces_by_region

    def interfaces(self) -> tuple[IntArray, IntArray]:
        """Region pairs that share faces, (I, 2) sorted, and each face's row in them, (F,).

        The larger region number comes first, whichever way the face is wound.
        """
        return self._connectivity.interfaces

    def signed_volumes(self, about: FloatArray | None = None) -> FloatArray:
        """Volume between each face and a place (3,), by default the mean vertex, (F,) um^3.

        Positive where the face's normal points away from there. The sum over a region's faces
        (negated where the region is side b) is the region's volume.
        """
        vertices = self.vertices_numpy()
        # Relative to the mean vertex no digits are lost far from the origin.
        corners = (vertices - (vertices.mean(axis=0) if about is None else about))[self.faces]
        cross = np.cross(corners[:, 1], corners[:, 2])
        return -np.einsum("fi,fi->f", corners[:, 0], cross) / 6.0

    def volumes(self, about: FloatArray | None = None) -> dict[int, float]:
        """Volume of each region, um^3, by region number.

        Means something only for closed, consistently oriented regions (``is_closed``, ``repair``);
        of open ones, differences do where only the inside of a surface changes, about one place.
        """
        per_face = self.signed_volumes(about)
        regions, ranks = self._connectivity.ranks  # a region number may be anything
        inner, outer = ranks.T
        total = np.bincount(inner, per_face, len(regions))
        total -= np.bincount(outer, per_face, len(regions))
        found = zip(regions.tolist(), total.tolist(), strict=True)
        return {region: volume for region, volume in found if region != OUTSIDE}

    def region_volume(self, region: int) -> float:
        """Volume of one region, um^3. Raises InputError if the mesh has no such region."""
        self._check_region(region)
        return self.volumes()[region]

    def region_surface(self, region: int) -> Mesh:
        """The surface of one region as a mesh of its own, outward, with regions (region, 0).

        Vertices that it does not use are left out; a tensor stays a tensor.
        Raises InputError if the mesh has no such region.
        """
        self._check_region(region)
        inner = self.regions[:, 0] == region
        outer = self.regions[:, 1] == region
        faces = np.where(outer[:, None], self.faces[:, ::-1], self.faces)[inner | outer]
        regions = np.tile(np.array([region, OUTSIDE]), (len(faces), 1))
        return mesh_of_faces(self.vertices, faces, regions)[0]

    def is_closed(self, region: int | None = None) -> bool:
        """True if every region (or the one given) is bounded by a closed surface.

        That is: an even number of the region's faces meet at each edge.
        Raises InputError if the mesh has no such region.
        """
        if region is None:
            return len(self._connectivity.open_regions) == 0
        self._check_region(region)
        return region not in self._connectivity.open_regions

    def _check_region(self, region: int) -> None:
        if region not in self.region_ids():
            raise InputError(f"the mesh has no region {region}")

    # ---- edges ------------------------------------------------------------------------------

    def edges(self) -> IntArray:
        """Unique edges, (E, 2) vertex indices, the smaller one first."""
        return self._connectivity.edges[0]

    def face_edges(self) -> IntArray:
        """Row in ``edges`` of the edge opposite each corner, (F, 3)."""
        return self._connectivity.edges[1]

    def edge_uses(self) -> IntArray:
        """How many faces meet at each edge, (E,): 2 within a wall, 3 and more at junctions."""
        return self._connectivity.edge_uses

    def edge_lengths(self) -> FloatArray:
        """Length of each edge, (E,) um."""
        ends = self.vertices_numpy()[self.edges()]
        return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)

    def median_edge(self) -> float:
        """Length of a typical edge, um."""
        return float(np.median(self.edge_lengths()))

    # ---- other libraries --------------------------------------------------------------------

    def to_trimesh(self) -> Any:
        """The same as a ``trimesh.Trimesh``; see :func:`.trimesh_exchange.to_trimesh`."""
        return to_trimesh(self.vertices_numpy(), self.faces, self.regions)

    @staticmethod
    def from_trimesh(other: Any) -> Mesh:
        """The mesh of a ``trimesh.Trimesh``; see :func:`.trimesh_exchange.from_trimesh`."""
        return Mesh(*from_trimesh(other))

    # ---- several meshes ---------------------------------------------------------------------

    @staticmethod
    def merge(meshes: Iterable[Mesh]) -> Mesh:
        """Put meshes side by side in one mesh, in which no two share a region number.

        Region numbers are kept where no earlier mesh has them, else replaced by new, higher
        ones. If any mesh has tensor vertices, so has the result. Vertices are not joined.
        Raises InputError if there is no mesh.
        """
        parts = list(meshes)
        if not parts:
            raise InputError("there are no meshes to merge")
        next_id = max(int(part.regions.max()) for part in parts) + 1
        used: set[int] = set()
        faces, regions, offset = [], [], 0
        for part in parts:
            known, rank = np.unique(part.regions, return_inverse=True)
            for k, region in enumerate(known.tolist()):
                if region == OUTSIDE:
                    continue
                if region in used:
                    known[k] = next_id
                    next_id += 1
                used.add(int(known[k]))
            faces.append(part.faces + offset)
            regions.append(known[rank.reshape(-1, 2)])
            offset += len(part.vertices)
        vertices = _concatenated([part.vertices for part in parts])
        return Mesh(vertices, np.concatenate(faces), np.concatenate(regions))


def mesh_of_faces(vertices: Any, faces: IntArray, regions: Any = None) -> tuple[Mesh, IntArray]:
    """Return a mesh of some faces with only the vertices that they use, and which these are."""
    used, index = np.unique(faces, return_inverse=True)
    return Mesh(vertices[used], index.reshape(-1, 3), regions), used


def _triple(value: ArrayLike, name: str) -> FloatArray:
    """One finite number, or three, as (3,)."""
    try:
        return np.broadcast_to(np.asarray(value, dtype=np.float64), (3,)).copy()
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be one number or three, in Z, Y, X order") from error


def _like(values: FloatArray, vertices: Any) -> Any:
    """``values`` as whatever ``vertices`` are."""
    return vertices.new_tensor(values) if is_tensor(vertices) else values


def _concatenated(arrays: list[Any]) -> Any:
    if not any(is_tensor(array) for array in arrays):
        return np.concatenate(arrays)
    import torch  # only reached when a tensor was given, so torch is loaded already

    first = next(array for array in arrays if is_tensor(array))
    return torch.cat([torch.as_tensor(a, dtype=first.dtype, device=first.device) for a in arrays])
