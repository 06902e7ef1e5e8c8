"""Widefield stacks without most of the light that is out of focus.

In a widefield stack, each slice holds all of the light: what is out of focus is blurred, not less.
So no dark ground lies above and below cells, and what closes around a point there is their light
cone. Such light is smooth within slices, and subtracting a wide blur of each slice removes most of
it ("unsharp masking").
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, gaussian_filter1d, mean
from skimage.segmentation import find_boundaries

from ...common.kept import Kept
from ..mesh import FloatArray
from .basins import content_of

Image = TypeVar("Image", bound=NDArray[np.floating[Any]])


@dataclass(frozen=True)
class FocusRules:
    """When a stack is a widefield one, and what is out of focus there. Lengths are in voxels.

    Attributes
    ----------
    lasts
        Light of the dimmest slice over that of the brightest, less contrast of fine detail in the
        least sharp slice over that in the sharpest: at least. Measured: 0.39 to 0.66 in 33 of 39
        simulated widefield stacks, 0.07 to 0.35 in six; up to 0.32 in 73 of 75 other random scenes,
        0.5 and 0.58 in two with a haze.
    detail
        Standard deviations of the Gaussians between which detail lies. Chosen: of noise, and of
        cells of 8 voxels across.
    blur
        Standard deviation, within slices, of the Gaussian that is subtracted. Measured on 91 points
        in cells of 4 to 13 voxels in radius, with an intersection over union of more than 0.5 with
        the cell: 71 with 3 (9 without), 67 with 2, 67 with 4, and 54 with 6.
    slices
        Fewer are left as they are. Chosen.
    rim
        Least mean at the border of a cell with walls in what is in focus, in standard deviations of
        that. Measured in simulated groups: 2.5 and more in 27 cells, up to 1.1 in seven gaps.
    """

    lasts: float = 0.35
    detail: tuple[float, float] = (1.5, 6.0)
    blur: float = 3.0
    slices: int = 5
    rim: float = 1.7


RULES = FocusRules()
_GROUND = 1.0  # percentile that counts as dark; chosen
_ANSWERS: Kept[bool] = Kept(4)  # for the last images, since every click asks again


def in_focus(data: Image, size: FloatArray) -> Image:
    """A widefield stack without most of what is out of focus; any other stack as it is.

    Parameters
    ----------
    data : (Z, Y, X).
    size : (3,) um, sides of a voxel.
    """
    if not _ANSWERS.get(content_of(data, size), lambda: is_widefield(data, size)):
        return data
    within = RULES.blur * size[1:].min() / size[1:]
    sharper: Image = data - gaussian_filter(data, (0.0, *within))
    return sharper


def is_widefield(data: NDArray[np.floating[Any]], size: FloatArray) -> bool:
    """Whether slices without detail hold nearly as much light as those with much.

    In stacks that section optically, they hold less light, too.
    """
    if len(data) < RULES.slices:
        return False
    fine, coarse = RULES.detail
    smooth = gaussian_filter(data, fine * size.min() / size)
    ground = np.percentile(smooth, _GROUND)
    light = gaussian_filter1d(data.mean((1, 2)), 1.0) - ground
    within = coarse * size[1:].min() / size[1:]
    detail = smooth - gaussian_filter(smooth, (0.0, *within))
    sharp = gaussian_filter1d(np.sqrt((detail**2).mean((1, 2))), 1.0)
    if light.max() <= 0 or sharp.max() <= 0:
        return False
    return bool(light.min() / light.max() - sharp.min() / sharp.max() > RULES.lasts)


def have_rims(labels: NDArray[np.int32], sharper: Image, size: FloatArray) -> NDArray[np.bool_]:
    """(n,) bool: which regions walls in focus surround; the others are gaps between light cones.

    labels : (Z, Y, X), 1 to n. sharper : (Z, Y, X), see :func:`in_focus`.
    """
    smooth = gaussian_filter(sharper, size.min() / size)
    rims = np.where(find_boundaries(labels, mode="inner"), labels, 0)
    heights = np.asarray(mean(smooth, rims, np.arange(1, int(labels.max()) + 1)))
    return heights >= RULES.rim * float(smooth.std())
