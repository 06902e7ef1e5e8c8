"""Voxels that a camera cut: all that is known of them is that they were brighter.

A cut voxel counts by the probability that noise around the model exceeds where it was cut (the
censored regression of J. Tobin, Econometrica 26, 1958). Its logarithm is replaced by the parabola
with the same slope and curvature where the model is now, that is, by another value and another
weight; beyond its top, where a brighter model would cost, it costs nothing. Leaving cut voxels out
instead would keep, of equally bright ones, those that noise had made darker.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import erfcx
from torch import Tensor

from ...geometry.mesh import FloatArray
from .likelihood import solve_scale


@dataclass(frozen=True)
class SaturationRules:
    """When bright voxels are taken to be cut.

    Attributes
    ----------
    share
        Of all voxels at the largest value; chosen, not measured: fewer hardly move a surface.
    sure
        Standard errors by which more voxels have the largest value than the next one; by
        definition. Where nothing is cut, bright values are the rarer the brighter they are.
    over
        Times as many, too; chosen: the upper tail of counted photons, cut off, is 1.5 to 2.
    """

    share: float = 0.0005
    sure: float = 5.0
    over: float = 1.2


RULES = SaturationRules()
_ROUNDS = 10  # at most, until a model exceeds the same voxels as before; chosen: most take two
_FAR = 1e4  # standard deviations: beyond, a cut voxel is one that was measured, but for rounding


def saturation(values: NDArray) -> float | None:
    """The value at which bright voxels of (N,) were cut, whatever their share; None for none."""
    if not len(values):
        return None
    top = values.max()
    number = int(np.count_nonzero(values == top))
    below = values[values < top]
    following = int(np.count_nonzero(below == below.max())) if len(below) else 0
    sure = number - following > RULES.sure * np.sqrt(number + following)
    return float(top) if following and sure and number > RULES.over * following else None


def cut_at(values: NDArray) -> float | None:
    """The same where enough voxels are cut to matter to a fit."""
    if not len(values) or np.count_nonzero(values == values.max()) < RULES.share * len(values):
        return None
    return saturation(values)


def share_cut(image: NDArray) -> float:
    """How many of the bright voxels of an image (Z, Y, X) are cut; bright: beyond halfway."""
    values = image[np.isfinite(image)]
    cut = cut_at(values)
    if cut is None:
        return 0.0
    bright = values > (float(np.median(values)) + cut) / 2
    return float((values >= cut).sum() / max(bright.sum(), 1))


def filled_in(image: NDArray, expected: NDArray) -> NDArray:
    """An image with what a model expects of cut voxels, where that is brighter; (Z, Y, X) both."""
    cut = cut_at(image[np.isfinite(image)])
    if cut is None:
        return image
    return np.where(image >= cut, np.maximum(image, expected), image)


def censored(expected: FloatArray, spread: FloatArray, cut: float) -> tuple[FloatArray, FloatArray]:
    """Values (N,) to compare a model with at cut voxels, and factors (N,) on their weights.

    Parameters
    ----------
    expected
        (N,) what the model shows there now.
    spread
        (N,) standard deviations of the noise.
    cut
        Where they were cut.
    """
    below = (cut - expected) / spread
    near = np.clip(below, -30.0, _FAR)  # e^-450 is 0 in all that follows
    hazard = np.sqrt(2 / np.pi) / erfcx(near / np.sqrt(2))
    rest = hazard - near
    value = np.where(below < _FAR, expected + spread / rest, cut)
    return value, np.minimum(hazard * rest, 1.0)


def weights_below(shown: Tensor, measured: Tensor, weights: Tensor, full: Tensor) -> Tensor:
    """Weights without those of cut voxels that a model exceeds; all (N,).

    Amplitude and background of the model are solved for with these weights. full : the cut voxels.
    """
    shown, kept = shown.detach(), weights
    over = torch.zeros_like(full)
    for _ in range(_ROUNDS):
        a, b, _ = solve_scale(shown, measured, kept)
        before, over = over, full & (a * shown + b > measured)
        if bool((over == before).all()):
            break
        kept = torch.where(over, 0.0, weights)
    return kept
