"""The efficient score of an effect: how far the image calls for it beyond what shape explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri_exp

from .evidence_rules import JUDGING
from .linearised import Linearised

_RANK = 1e-6  # share of information that counts as none. Measured: 1e-9 and 1e-3 change no score


@dataclass(frozen=True)
class Score:
    """What the image says about one effect.

    Attributes
    ----------
    z
        Standard deviations: for one number with its sign, for several the equally unlikely value.
        Relative to all variation of the residual, near and far.
    near
        The same relative to its variation from one small block to the next.
    estimate
        (P,) estimated change of the effect's numbers, in the units of the columns.
    shape
        (K,) error of the shape modes if the effect is left out.
    hidden
        Whether shape and the rest could explain all of the effect.
    """

    z: float
    near: float
    estimate: np.ndarray
    shape: np.ndarray
    hidden: bool = False


def score(at: Linearised, columns: np.ndarray, blocks: Sequence[np.ndarray]) -> Score:
    """The score of an effect that is not in the scene.

    ``z = g'W(y - I) / sqrt(g'Wg)``, where g are the columns minus all that the fitted numbers
    explain of them (C. R. Rao's efficient score). If residuals of neighbouring voxels are
    correlated, because the model does not explain everything, g'Wg is too small a variance: that of
    sums over blocks takes its place (the sandwich of P. Huber and H. White). As the range of the
    correlation is not known, several block sizes are tried and the largest variance counts.

    Parameters
    ----------
    at
        Derivatives and residual of the scene without the effect.
    columns
        (N, P) derivatives of the expected image by the effect's numbers.
    blocks
        For each block size, from small to large: (N,) number of each voxel's block, from 0.
    """
    g = columns * at.root[:, None]
    size = np.linalg.norm(g, axis=0)
    free = at.left(g)
    left = np.linalg.norm(free, axis=0)
    told = left > JUDGING.hidden * np.maximum(size, 1e-300)
    nothing = np.zeros(columns.shape[1])
    if not told.any() or not size.any():
        return Score(0.0, 0.0, nothing, np.zeros(at.modes), hidden=True)
    estimate = nothing.copy()
    free, unit = free[:, told] / left[told], left[told]
    residual = at.rest
    information = free.T @ free
    sums = free.T @ residual
    found = np.linalg.lstsq(information, sums, rcond=_RANK)[0]
    estimate[told] = found / unit
    surprise = float(sums @ found)
    excess = [_excess(free, residual - free @ found, information, own) for own in blocks]
    z, near = (equivalent_z(surprise / e, int(told.sum())) for e in (max(excess), excess[0]))
    if columns.shape[1] == 1:
        z, near = (float(np.copysign(v, found[0])) for v in (z, near))
    return Score(z, near, estimate, at.solve(g @ estimate)[: at.modes])


def _excess(
    free: np.ndarray, residual: np.ndarray, information: np.ndarray, blocks: np.ndarray
) -> float:
    """How many times larger the variance of the score is than the weights imply; at least 1."""
    sums = np.stack([np.bincount(blocks, free[:, k] * residual) for k in range(free.shape[1])], 1)
    ratio = np.linalg.lstsq(information, sums.T @ sums, rcond=_RANK)[0]
    return max(1.0, float(np.trace(ratio)) / free.shape[1])


def equivalent_z(surprise: float, numbers: int) -> float:
    """The |z| of one number that is as unlikely as this chi-squared of several."""
    if surprise <= 0:
        return 0.0
    if numbers == 1:
        return min(float(np.sqrt(surprise)), JUDGING.largest_z)
    from scipy.stats import chi2  # loads for a fifth of a second, and few fits ask for it

    log_tail = float(chi2.logsf(surprise, numbers))
    if not np.isfinite(log_tail) or log_tail < -4000:
        return min(float(np.sqrt(surprise)), JUDGING.largest_z)
    return min(max(float(-ndtri_exp(log_tail - np.log(2))), 0.0), JUDGING.largest_z)


def block_sizes(
    index: np.ndarray, shape: tuple[int, int, int], width: np.ndarray
) -> list[np.ndarray]:
    """Blocks of increasing size, as long as there are enough of them; width : PSF (3,), voxels.

    Returns (N,) block numbers for each size.
    """
    found: list[np.ndarray] = []
    for size in JUDGING.blocks:
        blocks = blocks_of(index, shape, np.maximum(np.rint(size * width), 3))
        if found and blocks.max() + 1 < JUDGING.fewest_blocks:
            break
        found.append(blocks)
    return found


def blocks_of(index: np.ndarray, shape: tuple[int, int, int], side: np.ndarray) -> np.ndarray:
    """(N,) numbers of the blocks in which flat indices lie; side : (3,) voxels per block."""
    at = np.stack(np.unravel_index(index, shape)) // np.maximum(side.astype(int), 1)[:, None]
    whole = np.ravel_multi_index(tuple(at), tuple(at.max(1) + 1))
    found: np.ndarray = np.unique(whole, return_inverse=True)[1].reshape(-1)
    return found
