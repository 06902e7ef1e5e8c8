"""Missing voxels, and filling them for methods that need a value everywhere."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def unmasked(image: Any, instead: float = np.nan) -> Any:
    """An array without a mask: values that NumPy's mask hides become NaN, or ``instead``.

    Anything but a masked array is returned as it is.
    """
    if not isinstance(image, np.ma.MaskedArray):
        return image
    if np.isnan(instead) and not np.issubdtype(image.dtype, np.inexact):
        image = image.astype(np.float64)
    return image.filled(instead)


def finite_or_nan(image: NDArray[Any]) -> NDArray[Any]:
    """An image with NaN for whatever is not finite; the image itself if all of it is finite."""
    if not np.issubdtype(image.dtype, np.floating) or np.isfinite(image).all():
        return image
    return np.where(np.isfinite(image), image, np.nan)


def filled(image: NDArray[Any], voxel_size: Sequence[float] | None = None) -> NDArray[Any]:
    """A (Z, Y, X) image with missing voxels (not finite) filled from the nearest known voxel.

    Nearest in um if the voxel size (um, Z, Y, X) is given, else in voxels. The image itself if
    nothing is missing.
    """
    missing = ~np.isfinite(image)
    if not missing.any():
        return image
    from scipy import ndimage  # where it is needed: it takes as long to load as all else here

    nearest = ndimage.distance_transform_edt(
        missing, voxel_size, return_distances=False, return_indices=True
    )
    return image[tuple(nearest)]
