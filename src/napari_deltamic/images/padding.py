"""Padding: voxels never measured, which fusing, rotating and deskewing put around an image.

They all have one value, often 0. Next to them, or a voxel or two further where the image was
interpolated, begins an image whose values never come near it. A dark background cut off at 0 also
has one value, but there every value between it and the bright parts occurs as well, and single
voxels of it lie among others.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..common.widened_mask import widened_mask

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class PaddingRules:
    """What counts as padding.

    Attributes
    ----------
    gap
        Share of the median difference between padding and the image beside it by which at least
        95 % of the voxels beside it must differ. Measured: 0.92 to 0.99 beside a camera's offset of
        100, at most 0.2 where a background was cut off at 0 (deconvolved, subtracted or stretched
        images, labels); five photons give 0.4.
    level
        Least ratio of that median to the one two voxels further out, or the other way round: beside
        padding the image is as bright as elsewhere, beside a background of 0 it is still rising.
        Chosen, not measured.
    same
        Share of the voxels beside it that may have its value. Measured: 0, and 0.07 to 0.08 in dim
        images that a median filter has left flat.
    steps
        Least difference, in steps between values of the image: less is rounding. Chosen, not
        measured.
    fewest
        Voxels needed beside it: with fewer, a share of 95 % is no more than a guess.
    smeared
        Most voxels beside it that interpolation has mixed with it: cubic splines reach this far.
    """

    gap: float = 0.35
    level: float = 0.8
    same: float = 0.01
    steps: float = 3.0
    fewest: int = 50
    smeared: int = 2


RULES = PaddingRules()
_BLOCK = np.ones((3, 3, 3), bool)
_SOME = 8  # voxels between those looked at first; chosen, it decides nothing
_CORNERS = 2  # voxels by which blocks 3 wide fall short of a slanted edge: by definition


def without_padding(image: NDArray[Any]) -> tuple[NDArray[Any], str]:
    """The image with NaN where it is padded, and a sentence on that; the image and "" if it is not.

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
    """(Z, Y, X) mask of padding: voxels at the border that share one value, or whole slices.

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
    """The least and the most frequent value of the border, if three by three voxels there have it:
    in most images none does."""
    sides = [side[np.isfinite(side)] for side in _faces(image)]
    values, counts = np.unique(np.concatenate(sides), return_counts=True)
    if not len(values):
        return []
    return [v for v in {values[0], values[counts.argmax()]} if _solid(image, v)]


def _solid(image: NDArray[Any], value: Any) -> bool:
    sides = (side == value for side in _faces(image))
    return any(ndimage.binary_erosion(side, _BLOCK[0], border_value=1).any() for side in sides)


def _values_of_slices(image: NDArray[Any]) -> list[Any]:
    """Values of those slices along Z that have only one value."""
    few = image[:, ::_SOME, ::_SOME]  # a few voxels rule most slices out
    flat = (few == few[:, :1, :1]).all((1, 2))
    found = [k for k in np.flatnonzero(flat) if (image[k] == image[k, 0, 0]).all()]
    return [image[k, 0, 0] for k in found]


def _around(image: NDArray[Any], value: Any) -> Mask | None:
    """Mask of padding of this value, with voxels smeared by it; None where there is none."""
    equal = image == value
    region = _from_border(equal)
    region[equal.all((1, 2))] = True
    region = ndimage.binary_dilation(region, _BLOCK, _CORNERS, mask=equal)
    grown = [region]
    for _ in range(RULES.smeared + 3):
        grown.append(widened_mask(grown[-1], (1, 1, 1)))
    away = np.abs(image.astype(np.float64) - float(value))
    rings = [away[b & ~a & np.isfinite(away)] for a, b in pairwise(grown)]
    for smeared in range(RULES.smeared + 1):
        if _stands_apart(rings[smeared], rings[smeared + 2]):
            return grown[smeared]
    return None


def _from_border(equal: Mask) -> Mask:
    """Mask of connected blocks of 3^3 voxels that reach the border; beyond it counts as equal."""
    core = ~widened_mask(~equal, (1, 1, 1))
    solid = widened_mask(core, (1, 1, 1)) & equal
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
