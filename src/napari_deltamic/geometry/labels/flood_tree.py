"""How the dark parts of an image join as it is flooded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from skimage.morphology import max_tree

from ..compiled import native

Ranks = NDArray[np.uint16]


def flood_tree(ranked: Ranks) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Compute the component tree of the sub-level sets of an image; neighbours share a face.

    Compiled: for 3.2 million voxels of an embryo, scikit-image's took 58 s and this 2 s, on the
    same busy machine. Without the extension, scikit-image's is used.

    Returns
    -------
    Parents: for each voxel, flat, the voxel that represents its component at its level, or, if it
    represents that itself, the component at the next level. And the order of voxels in which
    parents come first, from the root on.
    """
    library = native()
    if library is None:
        parents, order = max_tree(np.iinfo(np.uint16).max - ranked, connectivity=1)
        return parents.ravel().astype(np.int64), order.astype(np.int64)
    parent, order = library.flooded(np.ascontiguousarray(ranked, np.uint16))
    return parent.ravel(), order.ravel()
