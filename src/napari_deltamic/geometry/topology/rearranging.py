"""Changes of topology: thin places give way, and surfaces that cross become walls.

Both go through a label image: the regions are put into voxels, the labels changed where they have
to, and a new mesh made of them, whose vertices then go back to the old surface wherever nothing
has changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.labels.partition import partition_mesh
from napari_deltamic.geometry.labels.voxels import voxel_labels, voxel_windings
from napari_deltamic.geometry.mesh import FloatArray, Mesh
from napari_deltamic.geometry.remeshing import remesh
from napari_deltamic.geometry.topology.crossings import crosses, crossings
from napari_deltamic.geometry.topology.events import (
    change_events,
    contacts,
    untangled_events,
)
from napari_deltamic.geometry.topology.flips import flipped
from napari_deltamic.geometry.topology.projection import projected
from napari_deltamic.geometry.topology.small_pieces import absorbed
from napari_deltamic.geometry.topology.thin_places import ThinPlace, thin_places

Labels = NDArray[np.int32]

# Voxels and mesh vertices along an edge: the second where the first joins what should stay apart.
_FINENESS = ((3.0, 2.0), (5.0, 4.0))
_MOST_VOXELS = 30_000_000
# Voxels that one call may put into new meshes before it gives up: some seconds. A small cluster
# is tried in every way, a large one in one.
_WORK = 3_000_000
_ROOM = 3.0  # edge lengths around the mesh
# Edge lengths:
_WINDOW = 1.5  # around a thin place in which it gives way
_THICK = 1.0  # what is thinner gives way there,
_WIDER = 1.4  # or what is less than this many times as wide as the place
_NEW, _OLD = 1.5, 2.5  # nearer than the first to a change the surface is new, beyond the second old
_SMALLEST_PIECE = 8.0  # edge lengths cubed: smaller pieces that come off are dropped


@dataclass(frozen=True, eq=False)
class Rearranged:
    """A mesh whose topology has changed.

    Attributes
    ----------
    mesh
        Of the same regions.
    events
        What happened, a sentence each; none where nothing has changed.
    hopeless
        The places that cannot give way: a region would vanish, surfaces would cross, or nothing
        would change. Places that are in neither were not tried one by one.
    """

    mesh: Mesh
    events: tuple[str, ...]
    hopeless: tuple[ThinPlace, ...] = ()


def give_way(mesh: Mesh, places: Sequence[ThinPlace], edge: float) -> Rearranged:
    """The mesh after thin places have given way: what lay on their two sides meets there.

    A gap between two cells becomes a wall, a hole closes, a neck is pinched off, and where a cell
    is thin between two others, these become neighbours. A small wall goes, the cells at the ends
    of a short junction come to touch, and a small piece goes to a neighbour: these change nothing
    but the faces around them.

    Parameters
    ----------
    mesh
        Closed regions that do not cross.
    places
        From :func:`thin_places`, :func:`small_walls`, :func:`short_junctions` and
        :func:`small_pieces`.
    edge
        um: the edge length of the mesh.
    """
    hopeless: list[ThinPlace] = []
    changed: list[ThinPlace] = []
    now = mesh
    for place in places:
        if place.is_thin:
            continue
        made = absorbed(now, place, edge) if place.volume else flipped(now, place, edge)
        now = now if made is None else made
        (hopeless if made is None else changed).append(place)
    events = change_events(mesh, now, changed, [], edge) if changed else ()
    rest = [place for place in places if place.is_thin]
    if not rest:
        return Rearranged(now, events, tuple(hopeless))
    done = _thinned(now, rest, edge)
    return Rearranged(done.mesh, events + done.events, (*hopeless, *done.hopeless))


def _thinned(mesh: Mesh, places: Sequence[ThinPlace], edge: float) -> Rearranged:
    work = _Work()
    done = _opened(mesh, places, edge, work)
    if done is not None:
        return done
    if len(places) < 2:
        return Rearranged(mesh, (), tuple(places))
    events: list[str] = []
    hopeless = []
    for place in places:  # one of them spoils it for the others
        if work.is_done():
            break
        one = _opened(mesh, [place], edge, work)
        if one is None:
            hopeless.append(place)
        else:
            mesh = one.mesh
            events += one.events
    return Rearranged(mesh, tuple(dict.fromkeys(events)), tuple(hopeless))


class _Work:
    """Voxels that went into new meshes so far."""

    def __init__(self) -> None:
        self.voxels = 0

    def is_done(self) -> bool:
        """Whether no more should be tried."""
        return self.voxels > _WORK


def _opened(mesh: Mesh, places: Sequence[ThinPlace], edge: float, work: _Work) -> Rearranged | None:
    """All places at once, if that joins nothing else."""
    meant = {pair for place in places for pair in combinations(place.sides, 2)}
    for voxels, nodes in _FINENESS:
        box = _Voxels(mesh, edge, voxels, nodes)
        size = int(np.prod(box.shape))
        if work.voxels and work.voxels + size > _WORK:
            return None
        work.voxels += size
        labels = box.labels(mesh)
        before = labels.copy()
        for place in places:
            _open(labels, place, box, edge)
        dropped = _without_crumbs(labels, before, box, edge)
        changed = box.places(labels != before)
        if not len(changed) or set(np.unique(labels)) != set(np.unique(before)):
            continue
        made = _extracted(mesh, labels, box, edge, changed)
        # Voxels close gaps that are narrower than they are.
        narrow = {p.sides for p in thin_places(mesh, box.size, edge) if p.is_gap}
        if made is not None and contacts(made) - contacts(mesh) <= meant | narrow:
            events = change_events(mesh, made, places, dropped, edge)
            return Rearranged(made, events) if events else None
    return None


def untangled(mesh: Mesh, edge: float | None = None) -> Rearranged:
    """The mesh without crossings: each point belongs to the region in which it lies deepest.

    Closed surfaces that overlap come to share a wall.

    Parameters
    ----------
    mesh
        Closed regions.
    edge
        um; default: the median edge length.

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
    ends = mesh.vertices_numpy()[mesh.edges()]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    edge = float(np.median(length)) if edge is None else edge
    box = _Voxels(mesh, edge, *_FINENESS[0])
    labels, overlap = box.deepest(mesh)
    lost = np.setdiff1d(mesh.region_ids(), labels)
    if len(lost):
        raise InputError(f"region {lost[0]} lies wholly within others: move it, or take it away")
    changed = np.concatenate(
        [box.places(overlap), mesh.vertices_numpy()[mesh.edges()[found[:, 0]]].reshape(-1, 3)]
    )
    made = _extracted(mesh, labels, box, edge, changed)
    if made is None:
        raise InputError("surfaces cross in a way that cannot be repaired: start from other seeds")
    return Rearranged(made, untangled_events(mesh, made, found))


# ------------------------------------------------------------------------------------ voxels


class _Voxels:
    """The voxels in which regions are compared.

    Attributes
    ----------
    size
        um, of a voxel.
    spacing
        um, of the vertices of a mesh that is made of them.
    origin, shape
        First voxel (um, Z Y X) and number of them.
    """

    def __init__(self, mesh: Mesh, edge: float, voxels: float, nodes: float) -> None:
        low, high = mesh.bounds()
        low, high = low - _ROOM * edge, high + _ROOM * edge
        self.size = max(edge / voxels, float((np.prod(high - low) / _MOST_VOXELS) ** (1 / 3)))
        self.spacing = max(edge / nodes, self.size)
        self.origin = low
        self.shape = tuple(np.ceil((high - low) / self.size).astype(int) + 1)

    def labels(self, mesh: Mesh) -> Labels:
        """Region of each voxel."""
        return voxel_labels(mesh, self.shape, (self.size,) * 3, self.origin)

    def deepest(self, mesh: Mesh) -> tuple[Labels, NDArray[np.bool_]]:
        """Region of each voxel, the deepest where several overlap, and where they do."""
        labels = np.zeros(self.shape, np.int32)
        depth = np.zeros(self.shape)
        overlap = np.zeros(self.shape, bool)
        for region in mesh.region_ids():
            turns = voxel_windings(mesh, int(region), self.shape, (self.size,) * 3, self.origin)
            inside = turns > 0
            overlap |= (inside & (labels > 0)) | (turns > 1) | (turns < 0)
            for cut in ndimage.find_objects(inside.astype(np.uint8)):
                own = ndimage.distance_transform_edt(np.pad(inside[cut], 1))[1:-1, 1:-1, 1:-1]
                deeper = own > depth[cut]
                labels[cut][deeper], depth[cut][deeper] = region, own[deeper]
        return labels, overlap

    def places(self, mask: NDArray[np.bool_]) -> FloatArray:
        """(n, 3) um: centres of some voxels."""
        return self.origin + self.size * np.argwhere(mask)

    def window(self, points: FloatArray, reach: float) -> tuple[slice, ...]:
        """The voxels within a box around points."""
        low = np.floor((points.min(0) - reach - self.origin) / self.size).astype(int).clip(0)
        high = np.ceil((points.max(0) + reach - self.origin) / self.size).astype(int) + 1
        return tuple(
            slice(int(a), int(min(b, n))) for a, b, n in zip(low, high, self.shape, strict=True)
        )


def _open(labels: Labels, place: ThinPlace, box: _Voxels, edge: float) -> None:
    """Give the thin part of a region to what lies beside it."""
    thick = max(_THICK * edge, _WIDER * place.width)
    margin = _WINDOW * edge + 2 * thick
    window = box.window(place.points, margin)
    cut = labels[window]
    corner = box.origin + box.size * np.array([s.start for s in window])
    own = np.isin(cut, place.regions)
    at = corner + box.size * np.argwhere(own)
    if not len(at):
        return
    near = np.zeros(cut.shape, bool)
    near[own] = cKDTree(place.points).query(at)[0] <= _WINDOW * edge
    radius = thick / 2 / box.size
    padded = np.pad(own, 1, mode="edge")
    core = ndimage.distance_transform_edt(padded)[1:-1, 1:-1, 1:-1] > radius
    kept = ndimage.distance_transform_edt(~core) <= radius if core.any() else core
    gone = near & own & ~kept
    index = ndimage.distance_transform_edt(own, return_distances=False, return_indices=True)
    heir = cut[tuple(index)]
    gone &= np.isin(heir, place.sides)
    cut[gone] = heir[gone]


def _without_crumbs(
    labels: Labels, before: Labels, box: _Voxels, edge: float
) -> list[tuple[int, float]]:
    """Drop small pieces that came off; region and volume (um^3) of each."""
    dropped = []
    smallest = _SMALLEST_PIECE * (edge / box.size) ** 3
    for region in np.unique(before[labels != before]):
        pieces, count = ndimage.label(labels == region)
        if count < 2:
            continue
        sizes = np.bincount(pieces.ravel())[1:]
        was = ndimage.label(before == region)[1]
        if count <= was:
            continue
        for k in np.argsort(sizes)[: count - was]:
            if sizes[k] < smallest:
                piece = pieces == k + 1
                _fill(labels, piece)
                dropped.append((int(region), float(sizes[k] * box.size**3)))
    return dropped


def _fill(labels: Labels, piece: NDArray[np.bool_]) -> None:
    index = ndimage.distance_transform_edt(piece, return_distances=False, return_indices=True)
    labels[piece] = labels[tuple(index)][piece]


# ----------------------------------------------------------------------------- the new mesh


def _extracted(
    old: Mesh, labels: Labels, box: _Voxels, edge: float, changed: FloatArray
) -> Mesh | None:
    """A mesh of labels that is the old one where nothing has changed; None if it is no good."""
    try:
        rough = partition_mesh(
            labels.astype(np.int64), np.full(3, box.size), box.origin, box.spacing
        )
    except InputError:
        return None
    fresh = remesh(rough, edge).mesh
    far = cKDTree(changed)
    for share in (1.0, 0.0):
        weight = share * ((far.query(fresh.vertices_numpy())[0] / edge - _NEW) / (_OLD - _NEW))
        mesh = projected(fresh, old, weight.clip(0, 1), edge)
        mesh = remesh(mesh, edge, passes=2, apart=True).mesh
        if _sound(mesh, old):
            return mesh
    return None


def _sound(mesh: Mesh, old: Mesh) -> bool:
    return (
        np.array_equal(mesh.region_ids(), old.region_ids())
        and mesh.is_closed()
        and min(mesh.volumes().values()) > 0
        and not crosses(mesh)
    )
