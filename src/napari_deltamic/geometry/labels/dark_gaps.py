"""Finds gaps between cells that labels lack, where the image is darker than in both cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..contacts import faces_of_voxels
from ..mesh import IntArray
from ..pairs import unique_pairs

# Of the brightness of the cells beside it, above that of the ground: what is brighter is a line
# that a segmentation has left, a membrane, or where cells touch. Measured in lines: 0.71 to 0.78
# where cells lie two voxels or one slice apart (as one mesh their insides end 0.59 voxel off, apart
# 0.12), 0.76 to 0.87 where they lie 1.2 voxels apart, less than the PSF resolves (as one mesh 0.25
# voxel off, apart 0.73). Where labels touch: 0.17 to 0.80 where the cells do not, 0.88 to 1.13
# where they do, more where they have membranes.
_DARK = 0.8
_ERRORS = 2.0  # standard errors by which it is darker, so that noise makes no gaps; chosen
_NEAR = 4  # voxels from a gap, in which a cell beside it is looked at; chosen
_FEWEST = 9  # voxels of a gap; chosen: fewer are a corner between cells that touch
_FAR = 2  # voxels from labels, from which on ground is not lit by them; chosen


def with_dark_gaps(numbers: IntArray, closed: IntArray, image: NDArray[np.floating]) -> IntArray:
    """Put ground back between labels whose gaps were closed, where the image shows it.

    Closed lines are opened again; where two labels touch, the voxels on both sides become ground.

    Parameters
    ----------
    numbers, closed
        (Z, Y, X) labels from 1, 0 is outside; before and after gaps were closed.
    image
        (Z, Y, X), finite.
    """
    gap = (numbers == 0) & (closed > 0)
    found, ground = closed.copy(), _ground(closed, image)
    for pairs, where in (_between(closed, gap, True), _between(closed, gap, False)):
        for (a, b), at in zip(pairs, where, strict=True):
            if len(at) >= _FEWEST and _is_dark((a, b), at, numbers, image, ground):
                found.reshape(-1)[at] = 0
    return found


def _between(
    closed: IntArray, gap: NDArray[np.bool_], in_gaps: bool
) -> tuple[list[list[int]], list[IntArray]]:
    """Return pairs of labels that meet, and the flat indices of the voxels where they do.

    in_gaps : whether across gaps that were closed; else labels that touch without a gap.
    """
    index = np.arange(closed.size).reshape(closed.shape)
    met, at = [np.zeros((0, 2), closed.dtype)], [np.zeros(0, index.dtype)]
    for names, lines, places in faces_of_voxels(closed, gap, index):
        for line, here in zip(lines, places, strict=True):
            chosen = line if in_gaps else ~(lines[0] | lines[1])
            met.append(np.sort(np.stack(names, 1)[chosen], axis=1))
            at.append(here[chosen])
    pairs, number = unique_pairs(np.concatenate(met))
    order = np.argsort(number, kind="stable")
    ends = np.cumsum(np.bincount(number, minlength=len(pairs)))
    where = [np.unique(one) for one in np.split(np.concatenate(at)[order], ends)[:-1]]
    return pairs.tolist(), where


def _ground(labels: IntArray, image: NDArray[np.floating]) -> float:
    """Return how bright the image is outside of cells; its darkest voxels if all is inside."""
    away = ~ndimage.binary_dilation(labels > 0, iterations=_FAR)
    return float(np.median(image[away])) if away.any() else float(image.min())


def _is_dark(
    pair: tuple[int, int],
    at: IntArray,
    numbers: IntArray,
    image: NDArray[np.floating],
    ground: float,
) -> bool:
    """Whether a gap is darker than the middles of the cells on both sides."""
    place = np.array(np.unravel_index(at, numbers.shape))
    first = np.maximum(place.min(1) - _NEAR, 0)
    box = tuple(slice(low, high) for low, high in zip(first, place.max(1) + _NEAR + 1, strict=True))
    near = np.zeros(numbers[box].shape, bool)
    near[tuple(place - first[:, None])] = True
    near = ndimage.binary_dilation(near, iterations=_NEAR)
    beside = [image[box][near & (numbers[box] == k)] for k in pair]
    if not all(len(values) for values in beside):
        return False
    inside = float(np.mean([np.median(values) for values in beside]))
    seen = image.reshape(-1)[at]
    most = seen.mean() + _ERRORS * seen.std() / np.sqrt(len(seen))
    return bool(inside > ground and most - ground < _DARK * (inside - ground))
