"""Voxels that nobody measured: what fusing, turning and shearing put around an image.

They all have one value, often 0, and next to them begins an image that never comes near it. A dark
background that was cut off at 0 has that value too, but between it and the light lies every value
in between, and single voxels of it lie among others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class PaddingRules:
    """What counts as padding.

    Attributes
    ----------
    gap
        Of what the image beside it is above it in the median: so far above it 95 % of that must be.
        Measured: 0.92 to 0.99 beside a camera's offset of 100, at most 0.2 where a background was
        cut off at 0 (deconvolved, subtracted or stretched images, labels); five photons give 0.4.
    same
        Share of the voxels beside it that may have its value. Measured: 0, and 0.07 to 0.08 in dim
        images that a median filter has left flat.
    steps
        Between values of the image: what is nearer is rounding. Chosen, not measured.
    fewest
        Voxels beside it: of fewer, a share of 95 % is no more than a guess.
    """

    gap: float = 0.35
    same: float = 0.01
    steps: float = 3.0
    fewest: int = 50


RULES = PaddingRules()
_BLOCK = np.ones((3, 3, 3), bool)
_SOME = 8  # voxels; chosen, it decides nothing
_CORNERS = 2  # voxels by which blocks fall short of a slanted edge: by definition of three


def without_padding(image: NDArray[Any]) -> tuple[NDArray[Any], str]:
    """An image with NaN where it is padded, and a sentence on that; itself and "" where it is not.

    Parameters
    ----------
    image
        (Z, Y, X) real numbers; NaN where missing already.
    """
    found = padding(image)
    if found is None:
        return image, ""
    value = image[found].min()
    kind = image.dtype if np.issubdtype(image.dtype, np.floating) else np.float32
    told = f"{found.mean():.0%} of its voxels are padding of value {value:g}: taken as missing"
    return np.where(found, np.nan, image).astype(kind), told


def padding(image: NDArray[Any]) -> Mask | None:
    """(Z, Y, X) voxels at the border, and whole slices, that all have the least value of an image.

    None where nothing of the image looks like padding.
    """
    if image.ndim != 3 or not np.issubdtype(image.dtype, np.number):
        return None
    floats = np.issubdtype(image.dtype, np.floating)
    if not image.size or (floats and not np.isfinite(image).any()):
        return None
    value = image[np.isfinite(image)].min() if floats else image.min()
    slices = _flat_slices(image, value)
    if not (any(s.any() for s in slices) or _solid_at_border(image, value)):
        return None
    equal = image == value
    region = _from_border(equal)
    for axis, flat in enumerate(slices):
        np.moveaxis(region, axis, 0)[flat] = True
    region = ndimage.binary_dilation(region, _BLOCK, _CORNERS, mask=equal)
    beside = ndimage.binary_dilation(region, _BLOCK) & ~region & np.isfinite(image)
    return region if _stands_apart(image, value, beside) else None


def _flat_slices(image: NDArray[Any], value: Any) -> list[Mask]:
    """Along each axis: slices of nothing but the value."""
    found = []
    for axis in range(3):
        along = np.moveaxis(image, axis, 0)
        flat = (along[:, ::_SOME, ::_SOME] == value).all((1, 2))  # most are ruled out by a few
        for k in np.flatnonzero(flat):
            flat[k] = (along[k] == value).all()
        found.append(flat)
    return found


def _solid_at_border(image: NDArray[Any], value: Any) -> bool:
    """Whether a block of three by three voxels at the border has the value: most images have none,
    and need not be looked at whole."""
    for axis in range(3):
        for side in (0, -1):
            face = np.take(image, side, axis) == value
            if ndimage.binary_erosion(face, _BLOCK[0], border_value=1).any():
                return True
    return False


def _from_border(equal: Mask) -> Mask:
    """Blocks of voxels that reach the border, which counts as more of them."""
    core = ndimage.binary_erosion(equal, _BLOCK, border_value=1)
    solid = ndimage.binary_dilation(core, _BLOCK) & equal
    parts = ndimage.label(solid)[0]
    reached = np.zeros(int(parts.max()) + 1, bool)
    for axis in range(3):
        for side in (0, -1):
            reached[np.take(parts, side, axis)] = True
    reached[0] = False
    region: Mask = reached[parts]
    return region


def _stands_apart(image: NDArray[Any], value: Any, beside: Mask) -> bool:
    """Whether voxels beside those of a value are clearly above it."""
    above = image[beside].astype(np.float64) - float(value)
    if len(above) < RULES.fewest or (above == 0).mean() > RULES.same:
        return False
    few, half = np.quantile(above, [0.05, 0.5])
    steps = np.diff(np.unique(above))
    noisy = len(steps) > 0  # a mask or labels have one value each
    return noisy and few > RULES.gap * half and few >= RULES.steps * float(steps.min())
