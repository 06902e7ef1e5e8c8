"""How far single slices of a stack deviate from a model of the whole stack.

A wobbling stage shifts slices against each other, a flickering lamp makes them unevenly bright. A
smooth surface cannot follow all of that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.mesh import FloatArray

# By definition, of a normal deviate: the standard deviation over the median of its size, which is
# 0.6745 of it, as in ``common.normal``; and the variance of its difference from the mean of two
# others.
_OVER_MEDIAN, _FROM_NEIGHBOURS = 1 / 0.6745, 1.5
# By definition, too: relative error of a variance from that median, times the root of their number;
# it is 0.37 times as efficient as the mean square.
_OF_A_MEDIAN = (2 / 0.37) ** 0.5


@dataclass(frozen=True)
class SlicesApartRules:
    """Which slices count.

    Attributes
    ----------
    least
        Least squared gradient of the model in a slice, over that of the mean slice: with less,
        nothing shows a shift. Chosen.
    fewest
        Fewest slices whose median is meaningful. Chosen.
    sure
        Standard errors by which slices must differ by more than noise. Chosen, as elsewhere.
    """

    least: float = 0.05
    fewest: int = 6
    sure: float = 3.0


RULES = SlicesApartRules()


@dataclass(frozen=True)
class SlicesApart:
    """Standard deviations of single slices.

    Attributes
    ----------
    shift
        Shift along Y and X, voxels.
    brightness
        Relative deviation of brightness.
    """

    shift: float = 0.0
    brightness: float = 0.0


def slices_apart(seen: FloatArray, shown: FloatArray) -> SlicesApart:
    """How far slices deviate from the model; 0 if too few show anything.

    In each slice, the residual is fitted by its derivatives along Y and X, its light, and a
    constant. What neighbouring slices have in common is drift and does not count, nor does what
    noise explains.

    seen, shown : (Z, Y, X) measured image, NaN where missing, and modelled image. Voxels that the
        fit leaves out are included: without them, slices of a cell in a haze had too few voxels and
        seemed to differ by 17 %.
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
    """How clearly one slice shows shifts; its shifts and brightness (3,), and their variances."""

    strength: float
    found: FloatArray
    variance: FloatArray


def _of_slice(seen: FloatArray, shown: FloatArray) -> _Slice:
    """Shifts and brightness of a slice by least squares; seen, shown : (Y, X)."""
    light, known = np.asarray(shown, float), np.isfinite(seen)
    slopes = np.gradient(light) if min(light.shape) > 1 else [np.zeros_like(light)] * 2
    columns = np.stack([part[known] for part in (*slopes, light, np.ones_like(light))])
    left = (seen - light)[known]
    inverse = np.linalg.pinv(columns @ columns.T, hermitian=True)
    found = inverse @ (columns @ left)
    noise = float(np.mean((left - found @ columns) ** 2)) if left.size else 0.0
    return _Slice(float((columns[:2] ** 2).sum()), found[:3], noise * inverse.diagonal()[:3])


def _from_neighbours(each: FloatArray, times: float) -> FloatArray:
    """Each slice but the first and last, plus ``times`` the sum of both its neighbours."""
    return np.asarray(each[1:-1] + times * (each[:-2] + each[2:]))


def _beyond_noise(alone: FloatArray, by_noise: FloatArray) -> float:
    """Standard deviation of a slice beyond noise, from differences and their variances by noise.

    0 if noise alone may explain them.
    """
    variance, noise = (np.median(np.abs(alone)) * _OVER_MEDIAN) ** 2, np.median(by_noise)
    if variance < (1 + RULES.sure * _OF_A_MEDIAN / np.sqrt(alone.size)) * noise:
        return 0.0
    return float(np.sqrt((variance - noise) / _FROM_NEIGHBOURS))
