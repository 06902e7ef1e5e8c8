"""Which regions stand out from the noise: a dim cell does, a cell that noise has drawn does not.

How far a wall is above the inside says little without the noise: in a dark image a wall of a few
photons is plain, in a bright haze one of twenty is not. So the rim of a region is measured in
standard deviations of the noise there. That needs noise that is independent from voxel to voxel,
or its strength cannot be told from the image; whether it is so, the image does tell: of what no
lens can pass, the finest checkered pattern, neighbouring values have a known correlation.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from napari_deltamic.geometry.labels.cell_rules import FINDING
from napari_deltamic.geometry.labels.region_merging import (
    Image,
    Labels,
    dark_half,
    faces_between,
)
from napari_deltamic.geometry.mesh import FloatArray

_SECOND = np.array([0.5, -1.0, 0.5]) / 1.5**0.5  # so that white noise keeps its variance
_WHITE = -2 / 3  # by definition, the correlation of neighbours that it leaves of white noise


def noise_magnitudes(data: Image) -> Image | None:
    """Of each voxel a positive number whose mean over a neighbourhood is the noise there.

    None where the noise is not that of single voxels.
    """
    if min(data.shape) < 4:  # no neighbours are left within
        return None
    fine = data.astype(np.float64)
    for axis in range(3):
        fine = ndimage.convolve1d(fine, _SECOND, axis=axis, mode="reflect")
    inner = fine[1:-1, 1:-1, 1:-1]
    # Single bright specks, and what membranes leave, would weigh more than all the noise.
    bound = 4 * float(np.median(np.abs(inner)))
    if not bound > 0:
        return None
    inner = np.clip(inner, -bound, bound)
    power = float((inner**2).mean())
    for axis in range(3):
        lines = np.moveaxis(inner, axis, 0)
        if float((lines[1:] * lines[:-1]).mean()) > (_WHITE + FINDING.white_within) * power:
            return None
    magnitudes: Image = (np.abs(fine) * (np.pi / 2) ** 0.5).astype(np.float32)  # normal deviates
    return magnitudes


def clear_rims(
    labels: Labels, count: int, smooth: Image, noise: Image, side: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Of each label: the share of its surface that is clear of noise, and the mean height of all.

    Heights are above the region's own inside, in standard deviations of the noise in it.

    Parameters
    ----------
    labels : (Z, Y, X) from 1, less than count.
    smooth : the smoothed image.
    noise : what is left there of the noise, around each voxel.
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
