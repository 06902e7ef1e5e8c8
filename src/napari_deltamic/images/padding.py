"""Voxels that nobody measured: what fusing, turning and shearing put around an image.

They all have one value, often 0, and next to them, or a voxel or two further where the image was
interpolated, begins an image that never comes near it. A dark background that was cut off at 0 has
that value too, but between it and the light lies every value in between, and single voxels of it
lie among others.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
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
        Of what the image beside it differs from it by in the median: so much at least 95 % of that
        must differ. Measured: 0.92 to 0.99 beside a camera's offset of 100, at most 0.2 where a
        background was cut off at 0 (deconvolved, subtracted or stretched images, labels); five
        photons give 0.4.
    level
        That median, of the one two voxels further, or the other way round: beside padding the image
        is what it is everywhere, beside a background of 0 it is still rising. Chosen, not measured.
    same
        Share of the voxels beside it that may have its value. Measured: 0, and 0.07 to 0.08 in dim
        images that a median filter has left flat.
    steps
        Between values of the image: what is nearer is rounding. Chosen, not measured.
    fewest
        Voxels beside it: of fewer, a share of 95 % is no more than a guess.
    smeared
        Voxels beside it, at most, that interpolation has mixed with it: cubic splines reach as far.
    """

    gap: float = 0.35
    level: float = 0.8
    same: float = 0.01
    steps: float = 3.0
    fewest: int = 50
    smeared: int = 2


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
    kind = image.dtype if np.issubdtype(image.dtype, np.floating) else np.float32
    told = f"{found.mean():.0%} of its voxels are padding, all of one value: taken as missing"
    return np.where(found, np.nan, image).astype(kind), told


def padding(image: NDArray[Any]) -> Mask | None:
    """(Z, Y, X) voxels at the border that all have one value, and whole slices that do.

    None where nothing of the image looks like padding.
    """
    if image.ndim != 3 or min(image.shape) < 3 or not np.issubdtype(image.dtype, np.number):
        return None
    values = {*_values_of_border(image), *_values_of_slices(image)}
    masks = [mask for mask in (_around(image, value) for value in values) if mask is not None]
    return np.logical_or.reduce(masks) if masks else None


def _faces(image: NDArray[Any]) -> list[NDArray[Any]]:
    """The six sides of an image."""
    return [np.take(image, side, axis) for axis in range(3) for side in (0, -1)]


def _values_of_border(image: NDArray[Any]) -> list[Any]:
    """The least and the most frequent one, where a block of three by three voxels at the border has
    it: in most images none does."""
    sides = [side[np.isfinite(side)] for side in _faces(image)]
    values, counts = np.unique(np.concatenate(sides), return_counts=True)
    if not len(values):
        return []
    return [v for v in {values[0], values[counts.argmax()]} if _solid(image, v)]


def _solid(image: NDArray[Any], value: Any) -> bool:
    sides = (side == value for side in _faces(image))
    return any(ndimage.binary_erosion(side, _BLOCK[0], border_value=1).any() for side in sides)


def _values_of_slices(image: NDArray[Any]) -> list[Any]:
    """Values of slices along Z that have a single one."""
    few = image[:, ::_SOME, ::_SOME]  # they rule most out
    flat = (few == few[:, :1, :1]).all((1, 2))
    found = [k for k in np.flatnonzero(flat) if (image[k] == image[k, 0, 0]).all()]
    return [image[k, 0, 0] for k in found]


def _around(image: NDArray[Any], value: Any) -> Mask | None:
    """Padding of a value, with what it has smeared; None where there is none."""
    equal = image == value
    region = _from_border(equal)
    region[equal.all((1, 2))] = True
    region = ndimage.binary_dilation(region, _BLOCK, _CORNERS, mask=equal)
    grown = [region]
    for _ in range(RULES.smeared + 3):
        grown.append(ndimage.binary_dilation(grown[-1], _BLOCK))
    away = np.abs(image.astype(np.float64) - float(value))
    rings = [away[b & ~a & np.isfinite(away)] for a, b in pairwise(grown)]
    for smeared in range(RULES.smeared + 1):
        if _stands_apart(rings[smeared], rings[smeared + 2]):
            return grown[smeared]
    return None


def _from_border(equal: Mask) -> Mask:
    """Blocks of voxels that reach the border, which counts as more of them."""
    core = ndimage.binary_erosion(equal, _BLOCK, border_value=1)
    solid = ndimage.binary_dilation(core, _BLOCK) & equal
    parts = ndimage.label(solid)[0]
    reached = np.zeros(int(parts.max()) + 1, bool)
    for face in _faces(parts):
        reached[face] = True
    reached[0] = False
    region: Mask = reached[parts]
    return region


def _stands_apart(beside: NDArray[np.float64], further: NDArray[np.float64]) -> bool:
    """Whether voxels beside padding differ from it as clearly as those further away."""
    if min(len(beside), len(further)) < RULES.fewest or (beside == 0).mean() > RULES.same:
        return False
    few, half = np.quantile(beside, [0.05, 0.5])
    steps = np.diff(np.unique(beside))  # none in a mask, or in labels
    clear = few > RULES.gap * half and few >= RULES.steps * float(steps.min(initial=np.inf))
    usual = float(np.median(further))
    return bool(clear and RULES.level * usual < half < usual / RULES.level)
