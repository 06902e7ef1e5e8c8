"""Turns crossing surfaces into walls: their regions are drawn into voxels and meshed anew."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ...errors import InputError
from ..connected import connected
from ..labels.partition import partition_mesh
from ..labels.voxels import depths, region_windings
from ..mesh import FloatArray, IntArray, Mesh
from ..remeshing import remesh
from .change_sizes import SIZES
from .crossings import crossings
from .events import untangled_events
from .projection import projected
from .rearranging import Rearranged
from .submesh import Census, Change, Cutter, Submesh, fits, put_back

_HOPELESS = "surfaces cross in a way that cannot be repaired: start from other seeds"


def untangled(mesh: Mesh) -> Rearranged:
    """Remove crossings from a mesh: each point goes to the region in which it lies deepest.

    Closed surfaces that overlap come to share a wall. Clusters of cells in which nothing crosses
    stay as they are.

    Parameters
    ----------
    mesh
        Closed regions.

    Raises
    ------
    InputError
        If a region lies wholly within others, or the mesh is not closed.
    """
    found = crossings(mesh)
    if not len(found):
        return Rearranged(mesh, ())
    if not mesh.is_closed():
        raise InputError("surfaces that cross can only be repaired where they are closed")
    edge = mesh.median_edge()
    cutter = Cutter(mesh)
    parts = [cutter.part(rows) for rows in _crossing_clusters(mesh, found)]
    done = put_back(mesh, [(part, _untangled(part, edge)) for part in parts])
    before, after = Census.of(mesh), Census.of(done.mesh)
    if after.regions != before.regions or min(after.volumes.values()) <= 0:
        raise InputError(_HOPELESS)
    return Rearranged(done.mesh, untangled_events(before, after, len(found)), (), done.origin)


def _crossing_clusters(mesh: Mesh, found: IntArray) -> list[IntArray]:
    """Return the faces of each cluster of connected or crossing surfaces in which any cross."""
    vertices = mesh.edges()[found[:, 0]][:, 0]
    links = np.concatenate([mesh.edges(), np.column_stack([vertices, mesh.faces[found[:, 1], 0]])])
    cluster = connected(links, len(mesh.vertices))
    # A cell may have several pieces.
    own = cluster[mesh.faces[:, 0]]
    return [np.flatnonzero(own == k) for k in np.unique(cluster[vertices])]


def _untangled(part: Submesh, edge: float) -> Change:
    """Remove the crossings of one cluster."""
    mesh = part.mesh
    box = _Box(mesh, edge)
    labels, overlap = box.deepest(mesh)
    lost = np.setdiff1d(mesh.region_ids(), labels)
    if len(lost):
        raise InputError(f"region {lost[0]} lies wholly within others: move it, or take it away")
    found = crossings(mesh)
    ends = mesh.vertices_numpy()[mesh.edges()[found[:, 0]]].reshape(-1, 3)
    near = cKDTree(np.concatenate([box.centers(overlap), ends]))
    spacing = max(edge / SIZES.nodes, box.size)
    try:
        rough = partition_mesh(labels.astype(np.int64), np.full(3, box.size), box.low, spacing)
    except InputError as error:
        raise InputError(_HOPELESS) from error
    fresh = remesh(rough, edge).mesh
    away = near.query(fresh.vertices_numpy())[0] / edge
    for share in (1.0, 0.0):
        weight = share * ((away - SIZES.new) / (SIZES.old - SIZES.new)).clip(0, 1)
        made = remesh(projected(fresh, mesh, weight, edge), edge, passes=2, apart=True).mesh
        change = Change(made, np.full(len(made.vertices), -1))
        if fits(part, change):
            return change
    raise InputError(_HOPELESS)


class _Box:
    """Voxels around a mesh; low : centre of the first one, um. size : their side, um."""

    def __init__(self, mesh: Mesh, edge: float) -> None:
        low, high = mesh.bounds()
        low, high = low - SIZES.room * edge, high + SIZES.room * edge
        self.low = low
        self.size = max(
            edge / SIZES.voxels, float((np.prod(high - low) / SIZES.most_voxels) ** (1 / 3))
        )
        self.shape = tuple((np.ceil((high - low) / self.size).astype(int) + 1).tolist())

    def deepest(self, mesh: Mesh) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
        """Return the region of each voxel, the deepest if several overlap, and where they do."""
        labels = np.zeros(self.shape, np.int32)
        depth = np.zeros(self.shape)
        overlap = np.zeros(self.shape, bool)
        for region, cut, turns in region_windings(
            mesh, mesh.region_ids().tolist(), self.shape, (self.size,) * 3, self.low
        ):
            inside = turns > 0
            overlap[cut] |= (inside & (labels[cut] > 0)) | (turns > 1) | (turns < 0)
            own = depths(inside)
            deeper = own > depth[cut]
            labels[cut][deeper], depth[cut][deeper] = region, own[deeper]
        return labels, overlap

    def centers(self, mask: NDArray[np.bool_]) -> FloatArray:
        """Return the centres of some voxels, (n, 3) um."""
        found: FloatArray = self.low + self.size * np.argwhere(mask)
        return found
