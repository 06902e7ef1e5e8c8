"""How much a residual says: the variance of what a fit leaves, and how far it is correlated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...common.normal import MEDIAN_SQUARE
from ...geometry.mesh import FloatArray


@dataclass(frozen=True)
class TemperingRules:
    """The blocks over which residuals are added up.

    Attributes
    ----------
    block
        Sides, in widths of the blurred PSF: more than the two over which what is left is
        correlated. Measured: half and twice change no fit of one cell.
    fewest
        Voxels that a block must hold: a sum of fewer would be one voxel's.
    """

    block: float = 4.0
    fewest: int = 4


RULES = TemperingRules()


def block_sums(
    values: FloatArray, index: np.ndarray, shape: tuple[int, int, int], widths: Sequence[float]
) -> FloatArray:
    """(B,) sums of values (N,) over each block of an image; see :func:`tempered_variance`."""
    block, count = _blocks(index, shape, widths)
    return np.asarray(np.bincount(block, values, count), np.float64)


def _blocks(
    index: np.ndarray, shape: tuple[int, int, int], widths: Sequence[float]
) -> tuple[np.ndarray, int]:
    """(N,) the block of each voxel, and how many blocks there are."""
    side = np.maximum(1, np.ceil(RULES.block * np.asarray(widths))).astype(np.int64)
    z, y, x = (np.arange(n) // s for n, s in zip(shape, side.tolist(), strict=True))
    counts = -(-np.asarray(shape) // side)
    table = (z[:, None, None] * counts[1] + y[:, None]) * counts[2] + x
    return table.reshape(-1)[index], int(np.prod(counts))


def block_centres(shape: tuple[int, int, int], widths: Sequence[float]) -> FloatArray:
    """(B, 3) voxels: the middle of each block, in the order of :func:`block_sums`."""
    side = np.maximum(1, np.ceil(RULES.block * np.asarray(widths)))
    counts = -(-np.asarray(shape) // side).astype(np.int64)
    return np.asarray((np.indices(tuple(counts)).reshape(3, -1).T + 0.5) * side - 0.5)


def tempered_variance(
    residual: FloatArray,
    index: np.ndarray,
    shape: tuple[int, int, int],
    widths: Sequence[float],
    least: float,
) -> float:
    """Variance of one voxel's residual, times the voxels that one independent voxel stands for.

    On real stacks what a fit leaves is many times the noise, and alike in neighbouring voxels: a
    likelihood that takes them for independent is overconfident, and every prior vanishes. The sum
    of n residuals over a block wider than their correlation has n times this variance. The median
    over the blocks, so that foreign bright things do not decide.

    Parameters
    ----------
    residual
        (N,) measured minus rendered, times the root of the weight.
    index
        (N,) flat indices of the voxels in an image of this shape.
    shape
        (Z, Y, X).
    widths
        Voxels, Z Y X: of the blurred PSF.
    least
        What it is at least.
    """
    block, count = _blocks(index, shape, widths)
    held = np.bincount(block, minlength=count)
    full = held >= RULES.fewest
    squares = np.bincount(block, residual, count)[full] ** 2 / held[full]
    alone = float(np.mean(residual**2))
    together = float(np.median(squares)) / MEDIAN_SQUARE if full.any() else alone
    return max(alone, together, least)
