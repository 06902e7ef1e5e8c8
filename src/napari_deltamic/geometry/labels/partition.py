"""Makes one mesh of touching labels, with shared walls (surface nets)."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage

from ...common.doing import doing
from ...errors import InputError
from ..connected import connected
from ..distance_transform import distance_transform
from ..mesh import OUTSIDE, FloatArray, IntArray, Mesh
from ..vectors import lengths
from .dual_net import TRIANGLES, check_nodes, dual_net, field_smoothing
from .voxels import ranked

# Of repairs: crowded labels hardly larger than an edge took up to 38 rounds, usual ones one.
_ROUNDS = 100
# Of the nodes of cells: where more are given up, three or four nodes across a cell are too few.
# Measured on four crowds of cells 9 to 11 voxels wide: with nodes three voxels apart, an eighth to
# nearly all were given up, and some cells grew to thirty times their volume; with 1.5 to 2 voxels
# at most 4.4 %, and no label has more than 1.2 times or less than 0.7 times its nodes.
_MENDED = 0.06
_CLOSER = 1.5  # chosen: how much closer the next grid is
_CLOSEST = 1.0  # sides of a voxel; chosen: labels show nothing finer
# Of blowing up; measured on nine cells: after four, volumes change by less than 1e-5 of themselves.
_SWELLINGS = 8
# Edges that a vertex may go at a time, as far as triangles keep their sides: a label of hardly more
# than an edge, inside out, had sent its vertices off by twenty images. Usual steps are a tenth.
_FARTHEST = 0.5
# um: a crossing keeps so far from a node where two labels are level, or vertices would coincide.
_LEAST_LEAD = 1e-9
# Edges: largest lead. By definition: boxes of labels reach three edges beyond them, so that a label
# that does not compete for a node is no nearer.
_ALONE = 3.0
_SQUARE = np.array([(0, 0, 0), (0, 0, 1), (0, 1, 1), (0, 1, 0)])  # around, across the first axis


class TooCoarse(InputError):
    """The edges are too long for any label."""


def partition_mesh(
    labels: IntArray,
    size: FloatArray,
    origin: FloatArray,
    edge: float,
    raised: bool = False,
    thin: bool = False,
) -> Mesh:
    """Mesh all labels (> 0) of an image; faces between two labels exist once.

    The distance field of every label is smoothed and sampled at the nodes of a grid of the wanted
    spacing; a node belongs to the label whose field is highest there. Faces lie between nodes of
    different labels, so that each region is closed. Never more than three walls meet in an edge.

    Parameters
    ----------
    labels : (Z, Y, X) integers, 0 = outside.
    size, origin : (3,) um; the origin is the centre of the first voxel.
    edge : um, edge length wanted; the triangles are those of a grid, so remesh them.
    raised : raise each field until it is above 0 in as many voxels as its label has: smoothing
        takes all of a label that is two slices high, but draws walls between others best without.
    thin : see :func:`~.dual_net.field_smoothing`.

    Raises
    ------
    InputError
        If no label is large enough for the edge length, or the grid would not fit into memory.
    """
    spacing, nodes = _mended(labels, size, edge, raised, thin)
    vertices, quads, regions = dual_net(nodes.best, nodes.lead(spacing))
    if not len(quads):
        raise TooCoarse("no label is large enough for the edge length")
    vertices, quads = _unpinched(vertices * spacing + nodes.corner + origin, quads)
    faces = quads[:, TRIANGLES].reshape(-1, 3)
    return Mesh(vertices, faces, np.repeat(regions, 2, axis=0))


def with_volumes(mesh: Mesh, volumes: dict[int, float]) -> Mesh:
    """Blow up or shrink a mesh until its regions have given volumes, um^3.

    Each region gets a pressure; walls move along their normals by the difference of both. This
    restores what a coarse mesh cuts off at convex places.
    """
    names = mesh.region_ids()
    sides = np.searchsorted(names, mesh.regions) + 1
    sides[mesh.regions == OUTSIDE] = 0
    wanted = np.array([volumes[int(k)] for k in names])
    farthest = _FARTHEST * mesh.median_edge()
    for _ in range(_SWELLINGS):
        doing()
        present = mesh.volumes()
        lacking = wanted - [present[int(k)] for k in names]
        areas, normals = mesh.areas(), mesh.normals()
        stiffness = np.zeros((len(names) + 1,) * 2)
        for one, other in ((0, 1), (1, 0)):
            np.add.at(stiffness, (sides[:, one], sides[:, one]), areas)
            np.add.at(stiffness, (sides[:, one], sides[:, other]), -areas)
        pressure = np.append(0.0, np.linalg.lstsq(stiffness[1:, 1:], lacking, rcond=None)[0])
        speed = (pressure[sides[:, 0]] - pressure[sides[:, 1]]) * areas
        weight = np.bincount(mesh.faces.ravel(), np.repeat(areas, 3), len(mesh.vertices))
        moved = np.zeros((len(mesh.vertices), 3))
        np.add.at(moved, mesh.faces.ravel(), np.repeat(speed[:, None] * normals, 3, axis=0))
        moved /= np.maximum(weight, 1e-300)[:, None]
        moved *= np.minimum(1.0, farthest / np.maximum(lengths(moved), 1e-300))[:, None]
        mesh = mesh.with_vertices(mesh.vertices_numpy() + moved)
    return mesh


class _Nodes:
    """A grid of nodes, each with the label that is highest there and the one after it.

    corner : (3,) um, first node, from the centre of the first voxel.
    best, second : labels; first, next : their fields, um.
    """

    def __init__(self, corner: FloatArray, shape: IntArray) -> None:
        self.corner = corner
        self.best = np.zeros(shape, np.int64)
        self.second = np.zeros(shape, np.int64)
        self.first = np.full(shape, -np.inf)
        self.next = np.full(shape, -np.inf)

    def enter(self, name: int, where: tuple[slice, ...], values: FloatArray) -> None:
        """Let the field of a label compete at some nodes."""
        best, second, first, after = (
            a[where] for a in (self.best, self.second, self.first, self.next)
        )
        wins = values > first
        follows = ~wins & (values > after)
        second[...] = np.where(wins, best, np.where(follows, name, second))
        after[...] = np.where(wins, first, np.where(follows, values, after))
        best[...] = np.where(wins, name, best)
        first[...] = np.where(wins, values, first)

    def lead(self, edge: float) -> FloatArray:
        """Return how far each node is on the side of its label, um; bounded where none competes."""
        return np.clip(self.first - self.next, _LEAST_LEAD, _ALONE * edge)


def _compete(labels: IntArray, size: FloatArray, edge: float, raised: bool, thin: bool) -> _Nodes:
    sigma = field_smoothing(size, edge, thin)
    room = 3 * sigma + 2 * edge
    shape = np.ceil((np.array(labels.shape) * size + 2 * room) / edge) + 1
    check_nodes(shape, edge)
    nodes = _Nodes(-room, shape.astype(int))
    names, numbers = ranked(labels)
    around = np.ceil((3 * sigma + 3 * edge) / size).astype(int) + 1
    whole = tuple(slice(0, n) for n in labels.shape)
    boxes = [whole, *ndimage.find_objects(numbers)]

    def field(number: int) -> tuple[tuple[slice, ...], FloatArray]:
        start = np.array([s.start for s in boxes[number]]) - around
        mask = _cut(numbers, start, [s.stop for s in boxes[number]] + around) == number
        away = distance_transform(mask, size, threads=1)
        away -= distance_transform(~mask, size, threads=1)
        away = ndimage.gaussian_filter(away, sigma / size, mode="nearest")
        if raised and number:
            n = int(np.count_nonzero(mask))
            # Twice, as the field of the outside is the negative of this one, and stays.
            away += 2 * max(0.0, -float(np.partition(away, -n, axis=None)[-n]))
        where, places = _nodes_within(nodes, start, np.array(away.shape), size, edge)
        return where, ndimage.map_coordinates(away, places, order=1, mode="nearest")

    # Side by side, entered in their order. SciPy lets other threads run meanwhile.
    with ThreadPoolExecutor(torch.get_num_threads()) as pool:
        for number, (where, values) in enumerate(pool.map(field, range(len(boxes)))):
            doing()
            nodes.enter(int(names[number]), where, values)
    return nodes


def _cut(numbers: NDArray[np.integer], start: IntArray, stop: IntArray) -> NDArray[np.integer]:
    """Return a box of label numbers, 0 beyond the image."""
    low, high = np.clip(start, 0, None), np.minimum(stop, numbers.shape)
    box = numbers[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    return np.pad(box, np.stack([low - start, stop - high], axis=1))


def _nodes_within(
    nodes: _Nodes, start: IntArray, shape: IntArray, size: FloatArray, edge: float
) -> tuple[tuple[slice, ...], tuple[FloatArray, ...]]:
    """Return the nodes within a box of voxels, and their places in it."""
    low = np.ceil((start * size - nodes.corner) / edge).astype(int).clip(0)
    high = np.floor(((start + shape - 1) * size - nodes.corner) / edge).astype(int) + 1
    high = np.minimum(high, nodes.best.shape)
    axes = [
        (np.arange(a, b) * edge + c) / d - s
        for a, b, c, d, s in zip(low, high, nodes.corner, size, start, strict=True)
    ]
    where = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    return where, np.meshgrid(*axes, indexing="ij")


def _mended(
    labels: IntArray, size: FloatArray, edge: float, raised: bool, thin: bool
) -> tuple[float, _Nodes]:
    """Return the spacing (um) and nodes for which at most three walls meet in an edge."""
    spacing = edge
    while True:
        nodes = _compete(labels, size, spacing, raised, thin)
        own = np.count_nonzero(nodes.best)
        changed = _mend(nodes)
        if changed <= _MENDED * own or spacing <= _CLOSEST * float(size.min()):
            return spacing, nodes
        spacing /= _CLOSER


def _mend(nodes: _Nodes) -> int:
    """Relabel nodes until at most three walls meet in an edge; return how many.

    In a square of nodes of which all neighbours differ, four regions meet in an edge, or one
    touches itself there.
    """
    before = nodes.best.copy()
    given = np.zeros(nodes.best.shape, np.int64)
    arrays: tuple[NDArray[Any], ...] = (nodes.best, nodes.second, nodes.first, nodes.next, given)
    for _ in range(_ROUNDS):
        doing()
        axes = range(3)
        if not sum(_mend_squares(*(np.moveaxis(a, axis, 0) for a in arrays)) for axis in axes):
            break
    return int(np.count_nonzero(nodes.best != before))


def _mend_squares(
    best: NDArray[Any],
    second: NDArray[Any],
    first: NDArray[Any],
    after: NDArray[Any],
    given: NDArray[Any],
) -> int:
    p, q = best[:, :-1, :-1], best[:, :-1, 1:]
    r, s = best[:, 1:, 1:], best[:, 1:, :-1]
    bad = np.argwhere((p != q) & (q != r) & (r != s) & (s != p))
    for square in bad:
        corners = [tuple(square + step) for step in _SQUARE]
        names = [int(best[c]) for c in corners]
        if any(names[k] == names[k - 1] for k in range(4)):
            continue  # mended together with a neighbour
        # The smallest lead is given up, but no node twice: repairs could undo each other for ever.
        k = min(range(4), key=lambda k: (given[corners[k]], first[corners[k]] - after[corners[k]]))
        node, neighbours = corners[k], (names[k - 1], names[(k + 1) % 4])
        to = int(second[node]) if second[node] in neighbours else max(neighbours)
        best[node], second[node] = to, best[node]
        after[node] = first[node]  # no lead: the wall passes close to this node
        given[node] += 1
    return len(bad)


def _unpinched(vertices: FloatArray, quads: IntArray) -> tuple[FloatArray, IntArray]:
    """Split vertices in which surfaces touch only there, so that each has its own."""
    corners = quads.ravel()
    number, n = np.arange(len(corners)), len(vertices)
    ends = [np.roll(quads, shift, axis=1).ravel() for shift in (-1, 1)]
    # Two corners at a vertex belong together if their quads share an edge there.
    keys = np.concatenate([corners * n + end for end in ends])
    owners = np.concatenate([number, number])
    order = np.argsort(keys, kind="stable")
    same = keys[order][1:] == keys[order][:-1]
    left, right = owners[order][:-1][same], owners[order][1:][same]
    fan = connected(np.column_stack([left, right]), len(corners))
    fans, place = np.unique(fan, return_index=True)
    return vertices[corners[place]], np.searchsorted(fans, fan).reshape(-1, 4)
