"""How far each voxel of a mask is from the nearest voxel outside it.

By compiled loops, in as many threads as torch has; where they are missing, by SciPy. Measured on
60 x 256 x 256 voxels: in one thread 5 times as fast as SciPy, which has one only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from .compiled import native

VoxelSize = float | Sequence[float] | NDArray[np.floating]


def distance_transform(
    mask: NDArray[np.bool_], voxel_size: VoxelSize = 1.0, threads: int | None = None
) -> NDArray[np.float64]:
    """Distance of each voxel of a mask to the nearest voxel outside it; 0 outside.

    Parameters
    ----------
    mask
        Bool, of one to three axes. If nothing lies outside, all distances are the diagonal of the
        image.
    voxel_size
        Along each axis, or along all of them.
    threads
        By default as many as torch has.
    """
    return _distances(mask, voxel_size, None, threads)


def nearest_outside(
    mask: NDArray[np.bool_], voxel_size: VoxelSize = 1.0
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Those distances, and where the nearest voxel outside is, as an index of the flat image.

    If nothing lies outside, that index is 0.
    """
    nearest = np.zeros(mask.shape, np.int64)
    return _distances(mask, voxel_size, nearest, None), nearest


def _distances(
    mask: NDArray[np.bool_],
    voxel_size: VoxelSize,
    nearest: NDArray[np.int64] | None,
    threads: int | None,
) -> NDArray[np.float64]:
    """Distances; and, where they are asked for, the nearest voxels outside, in their array."""
    size = np.broadcast_to(np.asarray(voxel_size, float), mask.ndim)
    if mask.all():
        return np.full(mask.shape, float(np.linalg.norm(size * mask.shape)))
    loops = native()
    if loops is None:
        return _by_scipy(mask, size, nearest)
    given = np.ascontiguousarray(mask, bool).view(np.uint8)
    distances = np.empty(mask.shape)
    more = 3 - mask.ndim  # axes of one voxel each
    shape = (1,) * more + mask.shape
    loops.distance_transform(
        given.reshape(shape),
        (1.0,) * more + tuple(size.tolist()),
        distances.reshape(shape),
        None if nearest is None else nearest.reshape(shape),
        threads or torch.get_num_threads(),
    )
    return distances


def _by_scipy(
    mask: NDArray[np.bool_], size: NDArray[np.floating], nearest: NDArray[np.int64] | None
) -> NDArray[np.float64]:
    from scipy.ndimage import distance_transform_edt  # only here: it takes long to load

    distances: NDArray[np.float64]
    if nearest is None:
        distances = distance_transform_edt(mask, size)
        return distances
    distances, at = distance_transform_edt(mask, size, return_indices=True)
    nearest[...] = np.ravel_multi_index(tuple(at), mask.shape)
    return distances
