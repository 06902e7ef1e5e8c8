"""How even the wall around a region is: a cell has it all around, a gap does not.

Dark ground between cells has walls only where cells are, and these are brighter the nearer the
cells; on other sides it is open, where a watershed has cut it. The share of its surface that counts
as wall then says little, so the height of the wall in each direction is used.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..mesh import FloatArray
from .region_merging import Image, Labels, dark_half
from .voxels import widened

_DIRECTIONS = 32  # chosen: few enough that the mean over each is clear of noise
_HIGH = 0.75  # of all directions, the quantile that counts as the height of a wall; chosen


def even_walls(
    labels: Labels, names: NDArray[np.int64], smooth: Image, side: FloatArray
) -> FloatArray:
    """Return the mean over all directions of the height of each region's wall, from 0 to 1.

    Heights are relative to the one that three quarters of the directions do not exceed. Borders of
    the image and of its missing parts do not count; it is 1 for a region with no other surface.

    Parameters
    ----------
    labels : (Z, Y, X) from 1; 0 where the image is missing.
    names : (N,) of the regions.
    smooth : (Z, Y, X) the smoothed image, bright walls.
    side : um, of a voxel.
    """
    voxels, total = dark_half(labels, smooth, int(labels.max()) + 1)
    inside, boxes = total / np.maximum(voxels, 1), ndimage.find_objects(labels)
    even = np.ones(len(names))
    for place, name in enumerate(names.tolist()):
        wider = widened(boxes[name - 1], 1, labels.shape)
        heights = _heights(labels[wider], name, smooth[wider], side) - inside[name]
        if len(heights):
            high = max(float(np.quantile(heights, _HIGH)), float(np.finfo(np.float32).tiny))
            even[place] = np.clip(heights / high, 0, 1).mean()
    return even


def _heights(labels: Labels, name: int, smooth: Image, side: FloatArray) -> FloatArray:
    """Return the mean brightness of a region's surface in each direction in which it has any."""
    own, places, bright, areas = labels == name, [], [], []
    for axis in range(3):
        here, there = (np.arange(own.shape[axis] - 1) + k for k in (0, 1))
        differ = (own.take(here, axis) != own.take(there, axis)) & (
            (labels.take(here, axis) > 0) & (labels.take(there, axis) > 0)
        )
        places.append(np.argwhere(differ) + np.eye(3)[axis] / 2)  # by definition: between both
        bright.append(np.maximum(smooth.take(here, axis), smooth.take(there, axis))[differ])
        areas.append(np.full(len(places[-1]), np.prod(side) / side[axis]))
    away = (np.concatenate(places) - np.argwhere(own).mean(0)) * side
    towards = (away @ _sphere(_DIRECTIONS).T).argmax(1)
    area = np.concatenate(areas)
    whole = np.bincount(towards, area, _DIRECTIONS)
    light = np.bincount(towards, area * np.concatenate(bright), _DIRECTIONS)
    heights: FloatArray = light[whole > 0] / whole[whole > 0]
    return heights


def _sphere(count: int) -> FloatArray:
    """Return (count, 3) evenly spread directions, along a spiral of the golden angle."""
    place = np.arange(count)
    height, turn = 1 - (2 * place + 1) / count, np.pi * (1 + 5**0.5) * place
    around = np.sqrt(1 - height**2)
    return np.stack([height, around * np.cos(turn), around * np.sin(turn)], axis=1)
