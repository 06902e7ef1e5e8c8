"""Makes meshes of label images: closed surfaces, with shared walls where labels touch."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from ...common.ball import ball_radius
from ...common.doing import doing
from ...common.words import counted
from ...errors import DoubtWarning, InputError, RepairWarning, listed
from ..connected import connected
from ..contacts import label_contacts
from ..mesh import FloatArray, IntArray, Mesh
from ..refused import told
from ..remeshing import can_remesh, remesh
from ..three_numbers import three_numbers
from ..topology.smoothing_out import smoothed_out
from .dark_gaps import with_dark_gaps
from .label_repair import repair_labels, share_out_gaps
from .partition import TooCoarse, partition_mesh, with_volumes
from .surface_nets import closed_surface
from .thin_parts import cut_off
from .voxels import box_around, largest_part, ranked
from .whole_cells import whole_cells

EDGE_IN_VOXELS = 3.0
# Where planes are far apart, or cells large, edges of three voxels would make more faces than a fit
# takes in minutes: the default is then longer. Of many cells each has the second number, as a
# sphere with edges of a sixth of its radius has; chosen: cells 35 voxels wide take 700.
MOST_FACES, MOST_FACES_EACH = 60_000, 1000
# Of its voxels: a label whose mesh holds less is too small for the edges. Chosen; usual ones hold
# all but 1e-5 of them.
_RIGHT = 0.5
# Of the default edge, where a label is lost that is not a crumb; measured: of 20 balls 5 voxels
# across 18 are lost with edges of 3 voxels, of those 6 across 2, and none with edges of 2.
_FINER = 2 / 3
# Of the radius of the median label: where labels are small, edges are as short, but not less than
# that share. Measured on two crowds of some 40 nuclei, 8 to 14 voxels across: 0.10 and 0.175 voxel
# off, and 0.15 and 0.19 with edges of three voxels.
_OF_RADIUS = 0.45
# Edges are shortened on, by the same factor, while thin parts are cut off: to one side of a voxel,
# as labels show nothing finer. Chosen: a finer mesh must bring back a quarter of what is cut.
_FINEST, _BACK = 1.0, 0.25
_LEAST_CONTACT = 9  # voxel faces between two labels that make a wall


def mesh_from_labels(
    labels: ArrayLike,
    voxel_size: Sequence[float],
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    edge_length: float | None = None,
    *,
    gap: float | None = None,
    shared_walls: bool = True,
    image: ArrayLike | None = None,
) -> Mesh:
    """Make a smooth mesh of all labels of an image, with regions (label, neighbour or 0).

    The largest connected part of each label is kept and its holes are filled; each such repair
    gives a RepairWarning (see `repair_labels`), as do labels that are left out as too small for the
    edge length, or lack parts that are too thin for it. Labels that touch share their walls: such a
    face exists once, between the two. Volumes are those of the labels.

    Parameters
    ----------
    labels : (Z, Y, X) whole numbers, 0 = outside; or a list of such arrays or masks that overlap.
    voxel_size, origin : um, Z, Y, X; origin is the centre of the first voxel.
    edge_length : um, mean length of the edges. Default: 3 times the smallest voxel side, or what
        makes about 60,000 faces of all labels, 1000 of each where they are more than 60, if that is
        longer; down to twice where most labels are less than 13 voxels across, and shorter for
        labels with thin parts, such as arms, that it would cut off.
    gap : um; ground between labels that is narrower is divided among them. Default: as wide as the
        lines of one voxel that some segmentations leave between cells.
    shared_walls : False gives each label a surface of its own; touching ones lie on each other.
        Walls cannot be shared without the compiled extension.
    image : (Z, Y, X), finite: labels that only mark the cells that it shows, such as those of their
        nuclei, become whole cells; a RepairWarning names them. Where it is darker between
        labels than in them, no gap is closed, and labels that touch are parted.

    Raises
    ------
    InputError
        No label, no whole numbers, not 3D, or every label too small for the edge length; an image
        of another shape, or with gaps.
    """
    found = surfaces_of_labels(labels, voxel_size, origin, edge_length, gap, shared_walls, image)
    if found.too_small:
        texts = [f"label {k} is too small for edges of {found.edge:g} um" for k in found.too_small]
        warnings.warn(told(texts, found.count, "label"), RepairWarning, stacklevel=2)
    if found.cut:
        warnings.warn(_cut_short(found.cut), RepairWarning, stacklevel=2)
    return Mesh.merge(found.meshes)


@dataclass(frozen=True)
class LabelSurfaces:
    """The surfaces of a label image: one mesh for each cluster of labels.

    too_small : labels without a surface. count : number of all labels. edge : edge length, um.
    cut : labels that lack thin parts, each with the share of its volume that is missing.
    """

    meshes: list[Mesh]
    too_small: list[int]
    count: int
    edge: float
    cut: dict[int, float]


def surfaces_of_labels(
    labels: ArrayLike,
    voxel_size: Sequence[float],
    origin: Sequence[float],
    edge_length: float | None = None,
    gap: float | None = None,
    shared_walls: bool = True,
    image: ArrayLike | None = None,
) -> LabelSurfaces:
    """Do the work of `mesh_from_labels`, which describes the arguments."""
    size, start = (
        three_numbers(voxel_size, "voxel size"),
        three_numbers(origin, "origin", positive=False),
    )
    repaired = repair_labels(labels, size)
    for repair in repaired.repairs:
        warnings.warn(repair, RepairWarning, stacklevel=3)
    for question in repaired.asked:
        warnings.warn(question, DoubtWarning, stacklevel=3)
    whole, marks = repaired.labels, list[int]()
    doing()
    if image is not None:
        seen = np.asarray(image)
        if seen.shape != whole.shape or not np.isfinite(seen).all():
            raise InputError(
                f"the image must be finite and of the shape of the labels, {whole.shape}"
            )
        doing("looking how far the cells reach")
        whole, marks = whole_cells(seen, whole, size)
    if marks:
        warnings.warn(_enlarged(marks), RepairWarning, stacklevel=3)
    array = whole.astype(np.int64)
    names = np.unique(array)
    names = names[names > 0]
    doing(f"making meshes of {counted(len(names), 'cell')}")
    if edge_length is None:
        area, usual = _area(array, size), _edge_in_voxels(array, size)
        edge, finest = (edge_within(size, area, len(names), n) for n in (usual, _FINEST))
    else:
        edge = finest = float(edge_length)
    if not edge > 0:
        raise InputError(f"edge length must be positive, not {edge:g}")
    numbers = np.searchsorted(names, array) + 1
    numbers[array <= 0] = 0
    clusters = [np.array([k]) for k in range(1, len(names) + 1)]
    if shared_walls and len(names) > 1 and can_remesh():
        numbers = _without_gaps(numbers, size, gap, image)
        clusters = _touching(numbers, len(names))
    boxes = ndimage.find_objects(numbers, len(names))
    where = _Place(size, start, edge, finest, names, boxes)
    made = [_made(numbers, c, where, edge_length is None) for c in clusters]
    meshes = [mesh for mesh, _ in made if mesh is not None]
    shares = {
        k: volume / float(np.count_nonzero(array == k) * size.prod())
        for _, cut in made
        for k, volume in cut.items()
    }
    present = {k for mesh in meshes for k in mesh.region_ids().tolist()}
    too_small = [k for k in names.tolist() if k not in present]
    return LabelSurfaces(meshes, too_small, len(names), edge, shares)


def _enlarged(names: list[int]) -> str:
    verb, starts = ("lies", "the whole cell") if len(names) == 1 else ("lie", "whole cells")
    text = f"{listed('label', names)} {verb} well inside what the image shows"
    return f"{text}: the fit starts from {starts}"


def _cut_short(shares: dict[int, float]) -> str:
    share = f"{max(shares.values()):.0%}"
    most = f"{share} of it" if len(shares) == 1 else f"up to {share} of one"
    return f"{listed('label', list(shares))}: parts too thin for a mesh were cut off, {most}"


def _edge_in_voxels(labels: IntArray, size: FloatArray) -> float:
    """Return the edge length in smallest voxel sides; shorter if most labels are small."""
    counts = np.bincount(ranked(labels)[1].ravel())[1:]
    if not len(counts):
        return EDGE_IN_VOXELS
    radius = ball_radius(np.median(counts) * size.prod()) / size.min()
    return float(np.clip(_OF_RADIUS * radius, _FINER * EDGE_IN_VOXELS, EDGE_IN_VOXELS))


def _area(labels: IntArray, size: FloatArray) -> float:
    """Return the approximate area of all surfaces, um^2."""
    area = 0.0
    for axis in range(3):
        moved = np.moveaxis(labels, axis, 0)
        borders = np.count_nonzero(moved[1:] != moved[:-1])
        area += borders * float(np.prod(size) / size[axis])
    return area / 1.5  # by so much more is the area of voxel faces than that of a smooth surface


def edge_within(size: FloatArray, area: float, cells: int, voxels: float = EDGE_IN_VOXELS) -> float:
    """Return the edge length (um) for an area (um^2) and a number of cells: fine, not too fine."""
    most = max(MOST_FACES, MOST_FACES_EACH * cells)
    fewest = np.sqrt(area / (np.sqrt(3) / 4 * most))
    return max(voxels * float(size.min()), float(fewest))


@dataclass(frozen=True)
class _Place:
    """Where labels lie: voxel size, origin, edge length (um); name and box of each number.

    finest : um, edges are never shorter.
    raised : see :func:`~.partition.partition_mesh`.
    thin, own_edge : numbers of labels with thin parts, and the edge length of these, um.
    """

    size: FloatArray
    origin: FloatArray
    edge: float
    finest: float
    names: IntArray
    boxes: list[tuple[slice, ...]]
    raised: bool = False
    thin: tuple[int, ...] = ()
    own_edge: float = np.inf

    @property
    def shortest(self) -> float:
        """Shortest edge length (um) of any label."""
        return min(self.edge, self.own_edge)

    def edges(self, mesh: Mesh) -> FloatArray:
        """Return the edge length (um) at each vertex of a mesh whose regions are numbers."""
        length = np.full(len(mesh.vertices), self.edge)
        length[mesh.faces[np.isin(mesh.regions, self.thin).any(axis=1)]] = self.shortest
        return length


def _made(
    numbers: IntArray, cluster: IntArray, at: _Place, may_be_finer: bool
) -> tuple[Mesh | None, dict[int, float]]:
    """Mesh labels that touch; also return what it lacks (see :func:`~.thin_parts.cut_off`).

    If a label is lost, edges are shortened, if allowed, and fields raised; if parts of labels are
    cut off, edges of these labels are shortened.
    """
    make = _single if len(cluster) == 1 else _cluster
    mesh = make(numbers, cluster, at)
    lost, here = _lost(numbers, cluster, at, mesh), at
    edges = (at.edge, _FINER * at.edge) if may_be_finer else (at.edge,)
    for raised in (False, True) if len(cluster) > 1 else (False,):
        for edge in edges:
            if lost and (raised or edge != at.edge):
                other = make(numbers, cluster, replace(at, edge=edge, raised=raised))
                if (left := _lost(numbers, cluster, at, other)) < lost:
                    mesh, lost, here = other, left, replace(at, edge=edge, raised=raised)
    if mesh is None:
        return None, {}
    cut = _cut(numbers, mesh, here)
    thin = tuple((1 + np.searchsorted(at.names, list(cut))).tolist())
    while cut and here.shortest > at.finest:
        here = replace(here, thin=thin, own_edge=max(_FINER * here.shortest, at.finest))
        try:
            other = make(numbers, cluster, here)
        except InputError:  # a grid as fine as that would not fit into memory
            break
        if other is None or _lost(numbers, cluster, at, other) > lost:
            break
        left_over = _cut(numbers, other, here)
        if sum(left_over.values()) <= (1 - _BACK) * sum(cut.values()):
            mesh, cut = other, left_over
    return mesh, cut


def _cut(numbers: IntArray, mesh: Mesh, at: _Place) -> dict[int, float]:
    return cut_off(numbers, at.boxes, mesh, at.names, at.size, at.origin, at.edge)


def _lost(numbers: IntArray, cluster: IntArray, at: _Place, mesh: Mesh | None) -> int:
    """Count labels that a mesh (nearly) lacks, except crumbs smaller than a cube of one edge."""
    found = {} if mesh is None else mesh.volumes()
    lost = 0
    for number in cluster.tolist():
        wanted = np.count_nonzero(numbers[at.boxes[number - 1]] == number) * at.size.prod()
        held = found.get(int(at.names[number - 1]), 0.0)
        lost += wanted >= at.edge**3 and held < _RIGHT * wanted
    return lost


def _single(numbers: IntArray, cluster: IntArray, at: _Place) -> Mesh | None:
    """Mesh a label that touches no other; None if it is too small."""
    number = int(cluster[0])
    box, name = at.boxes[number - 1], int(at.names[number - 1])
    corner = at.origin + at.size * [s.start for s in box]
    cut = _whole(np.where(numbers[box] == number, numbers[box], 0), cluster)
    surface = closed_surface(cut == number, at.size, corner, at.shortest, bool(at.thin))
    if surface is None:
        return None
    vertices, faces = surface
    mesh = Mesh(vertices, faces, np.tile(np.array([[name, 0]], np.int64), (len(faces), 1)))
    wanted = float((cut == number).sum() * np.prod(at.size))
    found = with_volumes(mesh, {name: wanted})
    return found if found.volumes()[name] > _RIGHT * wanted else None


def _cluster(numbers: IntArray, cluster: IntArray, at: _Place) -> Mesh | None:
    """Mesh labels that touch, without those that are too small."""
    box = box_around(*(at.boxes[k - 1] for k in cluster))
    cut = np.where(np.isin(numbers[box], cluster), numbers[box], 0)
    cut = _whole(cut, cluster)
    try:
        corner = at.origin + at.size * [s.start for s in box]
        edge, thin = at.shortest, bool(at.thin)
        mesh = partition_mesh(cut, at.size, corner, edge, at.raised, thin)
    except TooCoarse:
        return None
    counts = np.bincount(cut.ravel(), minlength=int(cluster.max()) + 1)
    volumes = {int(k): float(counts[k] * np.prod(at.size)) for k in mesh.region_ids()}
    doing()
    mesh = with_volumes(remesh(mesh, at.edges(mesh)).mesh, volumes)
    doing()
    mesh = with_volumes(remesh(mesh, at.edges(mesh), passes=2).mesh, volumes)
    mesh = smoothed_out(mesh, at.shortest)
    own_names = np.concatenate([[0], at.names])
    return Mesh(mesh.vertices, mesh.faces, own_names[mesh.regions])


def _whole(numbers: IntArray, cluster: IntArray) -> IntArray:
    """Keep the largest part of each label, and fill its holes where no other label lies in them."""
    kept, boxes = np.zeros_like(numbers), ndimage.find_objects(numbers, int(cluster.max()))
    for number in cluster.tolist():
        doing()
        box = boxes[number - 1]
        mask = largest_part(numbers[box] == number)
        mask = mask | (ndimage.binary_fill_holes(mask) & (numbers[box] == 0))
        kept[box][mask] = number
    return kept


def _without_gaps(
    numbers: IntArray, size: FloatArray, gap: float | None, image: ArrayLike | None
) -> IntArray:
    if gap is not None:
        return share_out_gaps(numbers, size, gap / 2) if gap > 0 else numbers
    # A line of one voxel is reached from the voxels beside it.
    closed = share_out_gaps(numbers, np.ones(3), 1.0)
    doing()
    return closed if image is None else with_dark_gaps(numbers, closed, np.asarray(image))


def _touching(numbers: IntArray, count: int) -> list[IntArray]:
    """Group labels that touch; each group is a sorted array."""
    met, faces = label_contacts(numbers)
    group = connected(met[faces >= _LEAST_CONTACT] - 1, count)
    return [np.flatnonzero(group == g) + 1 for g in np.unique(group)]
