"""How solid regions are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull

from ..mesh import FloatArray


def solidity(region: NDArray[np.bool_]) -> float:
    """Return volume over that of the convex hull, from the middles of the faces of voxels."""
    sides = np.vstack([-np.eye(3), np.eye(3)]) / 2
    # Corners of the hull are the first or the last voxels of lines along any axis.
    along = np.moveaxis(region, int(np.argmax(region.shape)), 0)
    lines = np.argwhere(along.any(0))
    inside = along[:, lines[:, 0], lines[:, 1]]
    ends = inside.argmax(0), len(inside) - 1 - inside[::-1].argmax(0)
    outer = np.vstack([np.column_stack([end, lines]) for end in ends])
    hull = ConvexHull((outer[:, None] + sides).reshape(-1, 3))
    return float(region.sum() / hull.volume)


def solidities(labels: NDArray[np.int32], count: int | None = None) -> FloatArray:
    """Return (count,) solidities of labels from 1 (None: of all); 0 for a label without voxels."""
    boxes = enumerate(ndimage.find_objects(labels, count or 0), 1)
    return np.array([0.0 if box is None else solidity(labels[box] == k) for k, box in boxes])


def mean_solidity(labels: NDArray[np.int32]) -> float:
    """Return the solidity of labels (Z, Y, X), averaged by volume."""
    return float(np.average(solidities(labels), weights=np.bincount(labels.ravel())[1:]))
