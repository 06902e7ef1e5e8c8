"""Which regions stand out from the noise: a dim cell does, one that noise has drawn does not.

How far a wall is above the inside says little without the noise: in a dark image a wall of a few
photons is plain, in a bright haze one of twenty is not. So the rim of a region is measured in
standard deviations of the noise there. That needs noise that is independent from voxel to voxel,
or its strength cannot be told from the image. Whether it is independent, the image does tell: in
the finest checkered pattern, which no lens can pass, neighbouring values then have a known
correlation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ...images.missing import filled
from ..mesh import FloatArray
from .cell_rules import FINDING
from .region_merging import Image, Labels, dark_half, faces_between

_SECOND = np.array([0.5, -1.0, 0.5]) / 1.5**0.5  # so that white noise keeps its variance
_WHITE = -2 / 3  # by definition, the correlation of neighbours that it leaves of white noise


def noise_magnitudes(data: Image, known: NDArray[np.bool_]) -> Image | None:
    """Return positive numbers, one a voxel, whose mean over a neighbourhood is the noise there.

    None if noise is not independent from voxel to voxel. known : where the image is not missing.
    """
    if min(data.shape) < 4:  # no neighbours are left within
        return None
    fine = data.astype(np.float64)
    for axis in range(3):
        fine = ndimage.convolve1d(fine, _SECOND, axis=axis, mode="reflect")
    inner = fine[1:-1, 1:-1, 1:-1]
    told = ndimage.binary_erosion(known, np.ones((3, 3, 3)), border_value=1)[1:-1, 1:-1, 1:-1]
    if not told.any():
        return None
    # Single bright specks, and what membranes leave, would weigh more than all the noise.
    bound = 4 * float(np.median(np.abs(inner[told])))
    if not bound > 0:
        return None
    inner = np.clip(inner, -bound, bound)
    power = float((inner[told] ** 2).mean())
    for axis in range(3):
        lines, both = np.moveaxis(inner, axis, 0), np.moveaxis(told, axis, 0)
        products = (lines[1:] * lines[:-1])[both[1:] & both[:-1]]
        if products.size and products.mean() > (_WHITE + FINDING.white_within) * power:
            return None
    magnitudes = (np.abs(fine) * (np.pi / 2) ** 0.5).astype(np.float32)  # of normal deviates
    return filled(np.where(known, magnitudes, np.float32(np.nan)))


def clear_rims(
    labels: Labels, count: int, smooth: Image, noise: Image, side: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the share of each label's surface that is clear of noise, and its mean height.

    Heights are above the region's own inside, in standard deviations of the noise in it.

    Parameters
    ----------
    labels : (Z, Y, X) from 1, less than count; 0 where the image is missing.
    smooth : the smoothed image.
    noise : the noise that smoothing leaves around each voxel.
    side : um, of a voxel.
    """
    voxels, total = dark_half(labels, smooth, count)
    inside = total / np.maximum(voxels, 1)
    flat = labels.ravel()
    power = np.bincount(flat, noise.ravel().astype(np.float64) ** 2, count)
    spread = np.sqrt(power / np.maximum(np.bincount(flat, minlength=count), 1))
    spread = np.maximum(spread, np.finfo(np.float32).tiny)
    pairs, heights, areas = faces_between(labels, smooth, side)
    owner, area = pairs.ravel(), np.tile(areas, 2)
    above = (np.tile(heights, 2) - inside[owner]) / spread[owner]
    whole = np.bincount(owner, area, count)
    whole = np.where(whole > 0, whole, 1)
    share: FloatArray = np.bincount(owner, area * (above >= FINDING.rim_lowest), count) / whole
    mean: FloatArray = np.bincount(owner, area * above, count) / whole
    return share, mean
