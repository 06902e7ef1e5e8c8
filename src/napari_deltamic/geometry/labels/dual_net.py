"""Surfaces between the labels of a grid of nodes (surface nets), and how fine the grid may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ..mesh import FloatArray, IntArray


@dataclass(frozen=True)
class NetRules:
    """Numbers that decide how a surface is drawn around labels.

    Measured on twelve blobs and a ball of 9 voxels with edges of 3: half or twice of ``voxels`` or
    ``spacings`` moves the surface by less than 0.04 voxels; ``kept`` of 0.8 and 0.97, ``crossing``
    ten times off, and half or twice of the last three by less than 0.001, and the smallest angles
    change by less than a degree. No blob had a handle for ``smoother`` to take away.

    Attributes
    ----------
    most_nodes
        A typing error in an edge length must not fill the memory: this many take about a GB.
    voxels, spacings
        Standard deviation of the Gaussian that smooths a distance field, in voxels and in spacings
        of the nodes, whichever is more: the surface would follow the steps of the voxels otherwise,
        or what the nodes cannot show.
    spacing
        Of the nodes, in edges: gives a mean edge of 0.998 of what was asked for.
    smoother
        Times the smoothing, one after the other, until the surface has no handle: a thin bridge or
        a pit of noise makes one.
    kept
        Parts too thin for the mesh are taken away unless less than this share of the cell would be
        left: it is a thin cell then.
    crossing
        Spacings from a node to a crossing beside it where the sign of the node was changed by
        repair, since the field says nothing of it.
    rounds
        Of evening out the quads: more would hardly change anything.
    steepness, step
        Least square of the slope of the distance field (1 where it is exact) and the longest move
        in spacings when a vertex goes back onto the surface, or it would be thrown far away where
        the field is flat.
    """

    most_nodes: int = 30_000_000
    voxels: float = 0.7
    spacings: float = 0.4
    spacing: float = 1.1
    smoother: tuple[float, ...] = (1.0, 1.5, 2.0)
    kept: float = 0.9
    crossing: float = 1e-3
    rounds: int = 12
    steepness: float = 0.25
    step: float = 0.4


NETS = NetRules()

TRIANGLES = [0, 1, 2, 0, 2, 3]  # corners: the definition of the two triangles of a quad


def field_smoothing(size: FloatArray, spacing: float, thin: bool = False) -> FloatArray:
    """Return (3,) um: how much the distance field of voxels is smoothed before nodes sample it.

    thin : smooth along each axis only as much as its own voxel side needs, or slices far apart
        would remove arms that lie within them.
    """
    voxels = size if thin else np.full(3, size.max())
    smoothing: FloatArray = np.maximum(NETS.voxels * voxels, NETS.spacings * spacing)
    return smoothing


def check_nodes(shape: FloatArray, edge: float) -> None:
    """Raise InputError for a grid that would not fit into memory."""
    nodes = float(np.prod(shape))
    if nodes > NETS.most_nodes:
        raise InputError(f"edges of {edge:g} um are too short: they ask for {nodes:.0f} grid nodes")


def dual_net(labels: IntArray, lead: FloatArray) -> tuple[FloatArray, IntArray, IntArray]:
    """Make the faces between nodes of different labels.

    A vertex for each cell of eight nodes that has several labels: the mean of the crossings on its
    edges. A quad for each edge whose ends differ, its normal towards the smaller label.

    Parameters
    ----------
    labels
        (Z, Y, X) of the nodes.
    lead
        (Z, Y, X) how far each node is on the side of its label; it divides the edge between two
        nodes in proportion to find the crossing.

    Returns
    -------
    Vertices in units of the grid, quads, and the two labels of each quad, the larger first. All
    are empty where every node has the same label.
    """
    shape = np.array(labels.shape)
    stride = np.array([shape[1] * shape[2], shape[2], 1])
    rings, crossings, pairs = [], [], []
    for axis in range(3):
        moved = np.moveaxis(labels, axis, 0)
        node = np.argwhere(np.moveaxis(moved[:-1] != moved[1:], 0, axis))
        other = node + np.eye(3, dtype=int)[axis]
        a, b = labels[tuple(node.T)], labels[tuple(other.T)]
        low, high = lead[tuple(node.T)], lead[tuple(other.T)]
        place = node.astype(np.float64)
        place[:, axis] += low / (low + high)
        u, w = stride[(axis + 1) % 3], stride[(axis + 2) % 3]
        ring = (node @ stride)[:, None] + np.array([0, -u, -u - w, -w])
        # Z, Y, X is left-handed, so this order is counter-clockwise from below.
        ring[a > b] = ring[a > b][:, ::-1]
        rings.append(ring)
        crossings.append(place)
        pairs.append(np.stack([np.maximum(a, b), np.minimum(a, b)], axis=1))
    cells, index = np.unique(np.concatenate(rings), return_inverse=True)
    quads = index.reshape(-1, 4).astype(np.int64)
    repeated = np.repeat(np.concatenate(crossings), 4, axis=0)
    total = [np.bincount(quads.ravel(), repeated[:, i], len(cells)) for i in range(3)]
    vertices = np.stack(total, axis=1) / np.bincount(quads.ravel())[:, None]
    return vertices, quads, np.concatenate(pairs)
