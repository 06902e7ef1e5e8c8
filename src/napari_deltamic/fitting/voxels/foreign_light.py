"""Light of objects that no mesh describes: what the PSF spreads from them into voxels that count.

Voxels nearer to a neighbour without a mesh than to the surface are left out
(:mod:`.voxel_ownership`), but its blur reaches further: taken for light of the surface, it draws
the surface towards the neighbour. So the residual of the image where such neighbours lie is
explained by non-negative sources there, and what these add to the voxels that count is subtracted.
Sources are found by the image space reconstruction algorithm (M. Daube-Witherspoon and
G. Muehllehner, IEEE Trans. Med. Imaging 5, 1986), with each factor raised to a power: near the
solution, steps converge with any power below 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects
from skimage.transform import downscale_local_mean

from ...common.widened_mask import widened_mask
from ...geometry.gaussian_blur import blurred
from ...geometry.labels.voxels import widened
from ...geometry.mesh import FloatArray


@dataclass(frozen=True)
class ForeignLightRules:
    """Where foreign light is looked for, and how finely.

    Attributes
    ----------
    reach
        How far sources may lie from the voxels that count along each axis, in widths of the PSF.
        Chosen: beyond that, their blur has ended.
    own
        Share of the brightest voxel of the model: where the model is brighter than this, the light
        is its own, and no source is placed. Measured on cells among others without a seed: 0.3,
        0.5 and no bound are equally good.
    dim
        Share of the brightest voxel of the model: where the model is dimmer than this, voxels that
        count are evidence of foreign light, too. Measured on cells among others without a seed:
        0.2 is no better, and without these voxels surfaces ended 0.003 voxel further off.
    rounds, faintest
        Number of iterations. The first sources are the square of the residual, clipped from below
        at this share of its maximum. Measured on the same cells: from these, 10 rounds are as good
        as 20 from uniform sources, and 30 are no better than 20.
    power
        Exponent of each factor. Measured: from uniform sources, 30 rounds with it were as good as
        100 without.
    step
        Side of a source in widths of the PSF, rounded down to whole voxels, at least one. Chosen:
        the blurs of adjacent sources then leave no gaps.
    cut_off
        Standard deviations at which the blur is truncated. Measured: with 4, nothing changed.
    """

    reach: float = 5.0
    own: float = 0.5
    dim: float = 0.05
    rounds: int = 10
    faintest: float = 0.01
    power: float = 1.8
    step: float = 1.0
    cut_off: float = 3.0


RULES = ForeignLightRules()
_LEAST = 1e-6  # of the brightest, so that nothing is divided by 0


def foreign_light(
    left: NDArray[np.floating],
    own: NDArray[np.floating],
    foreign: np.ndarray,
    counted: np.ndarray,
    widths: FloatArray,
) -> NDArray[np.float32] | None:
    """(Z, Y, X) light of sources on foreign ground, blurred; None if there are none nearby.

    Parameters
    ----------
    left
        (Z, Y, X) the measured image minus model and background.
    own
        (Z, Y, X) the model, without background.
    foreign, counted
        (Z, Y, X) bool: where the sources may lie, and the voxels that count.
    widths
        (3,) of the PSF, voxels.
    """
    light = np.abs(own) / max(float(np.abs(own).max()), 1e-30)
    sources = foreign & _within(counted, RULES.reach * widths)
    sources &= light < RULES.own
    if not sources.any():
        return None
    told = sources | (counted & (light < RULES.dim) & _within(sources, RULES.reach * widths))
    (inner,) = find_objects(sources.view(np.int8))
    box = widened(inner, RULES.cut_off * widths, sources.shape)
    steps = np.maximum(np.floor(RULES.step * widths), 1).astype(int)
    share = _means(told[box], steps)
    given = _means(np.where(told[box], left[box], 0.0), steps)
    found = _sources(given, share, _means(sources[box], steps) > 0, widths / steps)
    for axis, step in enumerate(steps.tolist()):
        found = found.repeat(step, axis)
    inside = tuple(slice(0, n) for n in sources[box].shape)
    spread = np.zeros(left.shape, np.float32)
    spread[box] = _blurred(np.where(sources[box], found[inside], 0.0), widths)
    return spread


def _sources(
    given: NDArray[np.float32], share: NDArray[np.float32], where: np.ndarray, widths: FloatArray
) -> NDArray[np.float32]:
    """Brightness of sources whose blur explains the given values; 0 where there is no evidence.

    share : fraction of each block that is evidence. where : bool, the blocks of the sources.
    """
    at = np.flatnonzero(where)
    asked = np.maximum(_blurred(given, widths).reshape(-1)[at], 0.0)
    found, brightest = np.zeros(given.shape, np.float32), float(given.max())
    if brightest <= 0 or not asked.any():
        return found
    # Squares are sharper than the image, as the sources are.
    now = np.maximum(given.reshape(-1)[at], RULES.faintest * brightest) ** 2 / brightest
    each = found.reshape(-1)
    each[at] = now
    for _ in range(RULES.rounds):
        shown = _blurred(share * _blurred(found, widths), widths).reshape(-1)[at]
        if not shown.any():
            break
        now *= (asked / np.maximum(shown, _LEAST * shown.max())) ** RULES.power
        each[at] = now
    return found


def _blurred(values: NDArray[np.floating], widths: FloatArray) -> NDArray[np.float32]:
    return blurred(values, widths.tolist(), RULES.cut_off)


def _means(values: np.ndarray, steps: NDArray[np.signedinteger]) -> NDArray[np.float32]:
    """Means over blocks of this many voxels along each axis."""
    if (steps == 1).all():
        return values.astype(np.float32)
    found: NDArray[np.float32] = downscale_local_mean(values.astype(np.float32), tuple(steps))
    return found


def _within(mask: np.ndarray, far: FloatArray) -> np.ndarray:
    """Whether voxels lie within this many voxels of a mask along each axis."""
    return widened_mask(mask, np.ceil(far).astype(int))
