"""Groups of things that are connected."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .compiled import native
from .mesh import IntArray


def connected(links: IntArray, count: int) -> IntArray:
    """Number the groups of things that links join.

    Parameters
    ----------
    links
        (n, 2) of ``count`` things.

    Returns
    -------
    (count,) group of each, numbered from 0 in the order of their first members.
    """
    library = native()
    if library is not None:
        found: IntArray = library.connected(np.ascontiguousarray(links, np.int64), count)
        return found.reshape(-1)
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(count, count))
    group = connected_components(graph, directed=False)[1]
    _, first, inverse = np.unique(group, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[inverse.reshape(-1)]
