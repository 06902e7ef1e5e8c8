"""Surfaces between the labels of a grid of nodes (surface nets), and how fine the grid may be."""

from __future__ import annotations

import numpy as np

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.mesh import FloatArray, IntArray

# A typing error in an edge length should not fill the memory: this many nodes take about a GB.
_MOST_NODES = 30_000_000
# Standard deviation of the Gaussian that smooths a distance field, so that the surface follows
# neither the steps of the voxels nor what nodes cannot show. Measured on a ball and a pair of balls
# of 9 voxels: half or twice of either moves the mesh by less than 0.04 voxels.
_VOXELS, _SPACINGS = 0.7, 0.4

# The corners of the two triangles of a quad.
TRIANGLES = [0, 1, 2, 0, 2, 3]


def field_smoothing(size: FloatArray, spacing: float) -> float:
    """um: how much the distance field of voxels is smoothed before nodes sample it."""
    return max(_VOXELS * float(size.max()), _SPACINGS * spacing)


def check_nodes(shape: FloatArray, edge: float) -> None:
    """InputError for a grid that would not fit into memory."""
    nodes = float(np.prod(shape))
    if nodes > _MOST_NODES:
        raise InputError(f"edges of {edge:g} um are too short: they ask for {nodes:.0f} grid nodes")


def dual_net(labels: IntArray, lead: FloatArray) -> tuple[FloatArray, IntArray, IntArray]:
    """The faces between nodes of different labels.

    A vertex for each cell of eight nodes that has several labels: the mean of the crossings on its
    edges. A quad for each edge whose ends differ, its normal towards the smaller label.

    Parameters
    ----------
    labels
        (Z, Y, X) of the nodes.
    lead
        (Z, Y, X) how far each node is on the side of its label; a crossing lies between two nodes
        in proportion.

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
