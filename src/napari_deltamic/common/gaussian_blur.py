"""Gaussian filter of a stack, as matrix products: four to seven times as fast as SciPy's.

Measured on 60 x 256 x 256 voxels, in one thread, for widths of 0.6 to 6 voxels, truncated at three
widths.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .one_thread import one_thread

# Voxels along an axis that one matrix computes. Measured: 32 and 256 take longer.
_BLOCK = 64


def blurred(
    values: NDArray[np.floating], widths: Sequence[float], cut_off: float
) -> NDArray[np.float32]:
    """(Z, Y, X) values blurred by a Gaussian, 0 beyond the border; in single precision.

    Parameters
    ----------
    values
        (Z, Y, X), finite.
    widths
        Standard deviation along each axis, voxels; 0 leaves an axis as it is.
    cut_off
        Standard deviations at which the Gaussian is truncated.
    """
    image = torch.from_numpy(np.ascontiguousarray(values, np.float32))
    with one_thread(), torch.no_grad():
        for axis, width in enumerate(widths):
            if width > 0:
                image = _along(image, axis, width, int(cut_off * width + 0.5))
    found: NDArray[np.float32] = image.numpy()
    return found


def _along(image: Tensor, axis: int, width: float, far: int) -> Tensor:
    """The image blurred along one axis; far : voxels at which the Gaussian is truncated."""
    voxels, parts = image.shape[axis], []
    weights = np.exp(-((np.arange(far + 1) / width) ** 2) / 2)
    weights = np.append(weights / (2 * weights.sum() - 1), 0.0)
    for start in range(0, voxels, _BLOCK):
        stop = min(start + _BLOCK, voxels)
        first, last = max(0, start - far), min(voxels, stop + far)
        apart = np.abs(np.arange(start, stop)[:, None] - np.arange(first, last))
        mixed = torch.from_numpy(weights[np.minimum(apart, far + 1)].astype(np.float32))
        part = image.narrow(axis, first, last - first)
        if axis == 0:
            made = (mixed @ part.flatten(1)).reshape(stop - start, *image.shape[1:])
        else:
            made = mixed @ part if axis == 1 else part @ mixed.T
        parts.append(made)
    return parts[0] if len(parts) == 1 else torch.cat(parts, axis)
