"""How far the slices of a stack lie from where a model of all of them has each.

A stage that wobbles shifts slices against each other, a lamp that flickers makes them unevenly
bright. A smooth surface cannot follow all of that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.mesh import FloatArray

# By definition, of a normal deviate: the standard deviation over the median of its size, and the
# variance of its difference from the mean of two others.
_OVER_MEDIAN, _FROM_NEIGHBOURS = 1 / 0.6745, 1.5
# By definition, too: relative error of a variance from that median, times the root of their number;
# it is 0.37 times as efficient as the mean square.
_OF_A_MEDIAN = (2 / 0.37) ** 0.5


@dataclass(frozen=True)
class SlicesApartRules:
    """Which slices are asked.

    Attributes
    ----------
    least
        Of the squared gradient of the model in a slice, over that of the mean slice: in others
        there is nothing to see a shift of. Chosen.
    fewest
        Slices, of which a median tells something. Chosen.
    sure
        Standard errors by which slices must differ by more than noise. Chosen, as elsewhere.
    """

    least: float = 0.05
    fewest: int = 6
    sure: float = 3.0


RULES = SlicesApartRules()


@dataclass(frozen=True)
class SlicesApart:
    """Standard deviations between neighbouring slices.

    Attributes
    ----------
    shift
        Voxels, along Y and X.
    brightness
        Relative to their own.
    """

    shift: float = 0.0
    brightness: float = 0.0


def slices_apart(seen: FloatArray, shown: FloatArray) -> SlicesApart:
    """How far slices are apart; 0 where too few show anything.

    By least squares in each slice, of its derivatives along Y and X, its light, and a constant;
    what neighbouring slices have in common is drift, and does not count, nor does what noise makes.

    seen, shown : (Z, Y, X) images: as measured, NaN where nothing is known, and as modelled. What
        lies in voxels that a fit leaves out counts as noise: those it does not would be too few
        beside a cell in a haze, whose slices then seemed to differ by 17 %.
    """
    each = [_of_slice(*planes) for planes in zip(seen, shown, strict=True)]
    strength = np.array([one.strength for one in each])
    clear = [one for one in each if one.strength > RULES.least * strength.mean()]
    if len(clear) < RULES.fewest:
        return SlicesApart()
    alone = _from_neighbours(np.stack([one.found for one in clear]), -1 / 2)
    by_noise = _from_neighbours(np.stack([one.variance for one in clear]), 1 / 4)
    shift, brightness = (
        _beyond_noise(alone[:, part], by_noise[:, part]) for part in (slice(2), slice(2, 3))
    )
    return SlicesApart(shift, brightness)


@dataclass(frozen=True, eq=False)
class _Slice:
    """Of one slice: how clearly shifts of it are seen, shifts and brightness, their variances."""

    strength: float
    found: FloatArray
    variance: FloatArray


def _of_slice(seen: FloatArray, shown: FloatArray) -> _Slice:
    """By least squares; (Y, X) each."""
    light, known = np.asarray(shown, float), np.isfinite(seen)
    slopes = np.gradient(light) if min(light.shape) > 1 else [np.zeros_like(light)] * 2
    columns = np.stack([part[known] for part in (*slopes, light, np.ones_like(light))])
    left = (seen - light)[known]
    inverse = np.linalg.pinv(columns @ columns.T, hermitian=True)
    found = inverse @ (columns @ left)
    noise = float(np.mean((left - found @ columns) ** 2)) if left.size else 0.0
    return _Slice(float((columns[:2] ** 2).sum()), found[:3], noise * inverse.diagonal()[:3])


def _from_neighbours(each: FloatArray, times: float) -> FloatArray:
    """Of all slices but the first and the last: it, and so many times the sum of both others."""
    return np.asarray(each[1:-1] + times * (each[:-2] + each[2:]))


def _beyond_noise(alone: FloatArray, by_noise: FloatArray) -> float:
    """Standard deviation of a slice, from differences and the variances that noise gives these.

    0 where noise alone may give as much.
    """
    variance, noise = (np.median(np.abs(alone)) * _OVER_MEDIAN) ** 2, np.median(by_noise)
    if variance < (1 + RULES.sure * _OF_A_MEDIAN / np.sqrt(alone.size)) * noise:
        return 0.0
    return float(np.sqrt((variance - noise) / _FROM_NEIGHBOURS))
