"""Labels drawn in only some slices of a stack: fills the empty slices between them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..distance_transform import distance_transform
from ..mesh import FloatArray

Labels = NDArray[np.int32]


def filled_between(labels: Labels, size: FloatArray) -> tuple[Labels, int]:
    """Fill empty slices that lie between labelled ones; also return how many were filled.

    A label that is present on both sides is interpolated by the distances to its outlines there
    (S. P. Raya and J. K. Udupa, 1990).

    labels : (Z, Y, X). size : um of a voxel, Z, Y, X.
    """
    drawn = np.flatnonzero(labels.any(axis=(1, 2)))
    result, filled = labels, 0
    for below, above in pairwise(drawn.tolist()):
        if above == below + 1:
            continue
        between = _between(labels[below], labels[above], above - below - 1, size[1:])
        if between.any():
            result = labels.copy() if result is labels else result
            result[below + 1 : above] = between
            filled += above - below - 1
    return result, filled


def _between(one: Labels, other: Labels, count: int, size: FloatArray) -> Labels:
    """Interpolate (count, Y, X) slices between two."""
    found = np.zeros((count, *one.shape), np.int32)
    deepest = np.zeros(found.shape)
    share = np.arange(1, count + 1)[:, None, None] / (count + 1)
    for name in np.intersect1d(one[one > 0], other[other > 0]).tolist():
        inside = (one == name) | (other == name)
        rows, columns = (np.flatnonzero(inside.any(axis)) for axis in (1, 0))
        box = tuple(slice(k[0], k[-1] + 1) for k in (rows, columns))
        start, end = (_depth(side[box] == name, size) for side in (one, other))
        depth = (1 - share) * start + share * end
        part, best = found[(slice(None), *box)], deepest[(slice(None), *box)]
        own = depth > best
        part[own], best[own] = name, depth[own]
    return found


def _depth(mask: NDArray[np.bool_], size: FloatArray) -> FloatArray:
    """Return distances to the outline, um: positive inside; beyond the image is outside."""
    wider = np.pad(mask, 1)
    inside, outside = (distance_transform(m, size) for m in (wider, ~wider))
    return np.asarray(inside - outside)[1:-1, 1:-1]
