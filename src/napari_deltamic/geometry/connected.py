"""Groups of things that are connected."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from .compiled import native
from .mesh import IntArray, Mesh


def connected(links: IntArray, count: int) -> IntArray:
    """Number the groups of items that links join.

    Parameters
    ----------
    links
        (n, 2) pairs of item numbers below ``count``.

    Returns
    -------
    (count,) group of each item, numbered from 0 in the order of the groups' first members.
    """
    library = native()
    if library is not None:
        found: IntArray = library.connected(np.ascontiguousarray(links, np.int64), count)
        return found.reshape(-1)
    graph = sp.coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(count, count))
    group = connected_components(graph, directed=False)[1]
    _, first, inverse = np.unique(group, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[inverse.reshape(-1)]


def sharing(marks: IntArray, count: int) -> IntArray:
    """Return (n,) group of each row of marks (n, k) below ``count``; groups share no mark."""
    n, k = marks.shape
    links = np.column_stack([np.repeat(np.arange(n), k), n + marks.ravel()])
    return connected(links, n + count)[:n]


def pieces(mesh: Mesh) -> IntArray:
    """Return (V,) the number of the connected piece of the surface that each vertex belongs to."""
    return connected(mesh.edges(), len(mesh.vertices))


def adjacency(mesh: Mesh, edges: IntArray | None = None) -> sp.csr_matrix:
    """Return (V, V), 1 where one of the edges (n, 2), by default all edges, joins two vertices."""
    ends, n = mesh.edges() if edges is None else edges, len(mesh.vertices)
    both = np.concatenate([ends, ends[:, ::-1]])
    return sp.coo_matrix((np.ones(len(both)), tuple(both.T)), (n, n)).tocsr()
