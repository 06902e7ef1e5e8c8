"""Estimates the size of an image's cells by trying sizes from large to small on a coarse copy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...common.triple import geometric_mean
from ..mesh import FloatArray
from .cell_rules import FINDING
from .checked_image import checked_image
from .clear_rims import noise_magnitudes
from .find_cells import Seen, regions_of_size


@dataclass(frozen=True)
class SizeFound:
    """The cells that a size finds on a coarse copy of an image.

    Attributes
    ----------
    size
        um: diameter of the typical cell.
    cells
        Approximate number of cells.
    score
        How much of what is found really has this size.
    """

    size: float
    cells: int
    score: float


def likeliest(
    tried: Sequence[SizeFound], shape: Sequence[int], voxel_size: Sequence[float] | FloatArray
) -> float:
    """Return the first of the sizes tried (um), or a quarter of the image if there are none."""
    return tried[0].size if tried else float(np.max(np.multiply(shape, voxel_size))) / 4


def suggest_sizes(image: ArrayLike, voxel_size: Sequence[float]) -> list[SizeFound]:
    """Return sizes that the cells of an image may have, the likeliest first.

    Several are tried on a coarse copy. The best are those that find most cells of just that size;
    of two similar ones, only the better is kept.

    Raises
    ------
    InputError
        As `find_cells`.
    """
    kept: list[SizeFound] = []
    for one in _tries(image, voxel_size):
        if one.score > 0 and all(abs(np.log(one.size / x.size)) > FINDING.alike for x in kept):
            kept.append(one)
    return kept


def _tries(image: ArrayLike, voxel_size: Sequence[float]) -> list[SizeFound]:
    """Return all sizes with which cells are found, the best first."""
    data, known, voxel = checked_image(image, voxel_size)
    extent = np.array(data.shape) * voxel
    told = known.mean() * np.prod(extent)
    step = np.floor(np.cbrt(told / FINDING.tried_voxels) / voxel).astype(int)
    step = np.clip(step, 1, data.shape)
    seen = Seen(data, known, noise_magnitudes(data, known), voxel).coarsened(step)
    size, tries = FINDING.first_tried * float(extent.max()), list[SizeFound]()
    while size >= FINDING.smallest_tried * geometric_mean(seen.voxel):
        _, found = regions_of_size(seen, size, 0.0)
        sure = found.of(found.surely)
        if len(sure.names):
            typical = float(np.median(sure.diameter))
            # Pieces of cells and of the outside are less enclosed than cells.
            enclosed = float((sure.enclosed**4 * sure.diameter**3).sum())
            score = enclosed * np.exp(-2 * np.log(typical / size) ** 2)
            tries.append(SizeFound(typical, len(sure.names), score))
        size /= FINDING.step
    return sorted(tries, key=lambda tried: -tried.score)
