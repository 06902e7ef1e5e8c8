"""Checks and prepares an image in which cells are sought."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from ...common.triple import geometric_mean
from ...errors import InputError
from ...images.missing import filled, unmasked
from ..mesh import FloatArray
from ..three_numbers import three_numbers
from .cell_rules import FINDING
from .region_merging import Image

Mask = NDArray[np.bool_]
_GAP = np.ones((3, 3, 3), bool)  # chosen: narrower ones are bridged


def checked_image(image: ArrayLike, voxel_size: Sequence[float]) -> tuple[Image, Mask, FloatArray]:
    """Return the image with gaps filled and scaled to 0..1, where it is known, and the voxel size.

    Gaps of a voxel or a slice count as known: a cell goes on beyond them.
    """
    array = np.asarray(unmasked(image))
    if array.ndim != 3 or not array.size:
        raise InputError(f"a 3D image is needed to find cells, not one of shape {array.shape}")
    if (
        array.dtype == np.bool_
        or not np.issubdtype(array.dtype, np.number)
        or np.iscomplexobj(array)
    ):
        mask = ": use a mask as labels instead" if array.dtype == np.bool_ else ""
        raise InputError(
            f"an image of real numbers is needed to find cells, not {array.dtype}{mask}"
        )
    voxel = three_numbers(voxel_size, "voxel size")
    missing = ~np.isfinite(array)
    if missing.all():
        raise InputError("the image has no value anywhere")
    known = ~ndimage.binary_opening(missing, _GAP) if missing.any() else ~missing
    array = filled(array, tuple(voxel))  # flooding needs every voxel
    low, high = float(array.min()), float(array.max())
    if low == high:
        raise InputError("the image has the same value everywhere")
    # Single precision would lose a faint image on a high pedestal.
    data = ((array - array.dtype.type(low)) / (high - low)).astype(np.float32)
    return data, known, voxel


def positive_size(size: float) -> float:
    """Return a size (um). InputError unless it is a positive number."""
    try:
        diameter = float(size)
    except (TypeError, ValueError):
        raise InputError(f"the size of a cell must be a number (um), not {size!r}") from None
    if not (np.isfinite(diameter) and diameter > 0):
        raise InputError(f"the size of a cell must be positive (um), not {diameter:g}")
    return diameter


def checked_size(size: float, shape: tuple[int, ...], voxel: FloatArray) -> float:
    """Return a size (um). InputError unless positive, and fit for the image and its voxels."""
    diameter = positive_size(size)
    longest = float((np.array(shape) * voxel).max())
    if diameter > longest:
        raise InputError(
            f"a cell of {diameter:g} um is larger than the image, whose longest side is"
            f" {longest:g} um"
        )
    least = FINDING.least_voxels * geometric_mean(voxel)
    if diameter < least:
        raise InputError(
            f"a cell of {diameter:g} um is too small for these voxels: at least {least:.3g} um"
        )
    return diameter
