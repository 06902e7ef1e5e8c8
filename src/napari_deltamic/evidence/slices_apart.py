"""How far the slices of a stack lie from where a model of all of them has each.

A stage that wobbles shifts slices against each other, a lamp that flickers makes them unevenly
bright. A smooth surface cannot follow all of that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.mesh import FloatArray

# By definition, of a normal deviate: the standard deviation over the median of its size, and that
# of its difference from the mean of two others.
_OVER_MEDIAN, _FROM_NEIGHBOURS = 1 / 0.6745, 1.5**0.5


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
    """

    least: float = 0.05
    fewest: int = 6


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


def slices_apart(seen: FloatArray, shown: FloatArray, counted: np.ndarray) -> SlicesApart:
    """How far slices are apart; 0 where too few show anything.

    By least squares in each slice, of its derivatives along Y and X, its light, and a constant;
    what neighbouring slices have in common is drift, and does not count.

    seen, shown : (Z, Y, X) images: as measured and as modelled. counted : (Z, Y, X) bool.
    """
    counted = counted & np.isfinite(seen)
    slopes = np.stack(np.gradient(np.asarray(shown, float), axis=(1, 2)))
    strength = ((slopes**2).sum(0) * counted).sum((1, 2))
    clear = np.flatnonzero(strength > RULES.least * strength.mean())
    found = []
    for z in clear:
        here = counted[z]
        light = shown[z][here]
        columns = np.stack([*slopes[:, z][:, here], light, np.ones_like(light)], axis=1)
        found.append(np.linalg.lstsq(columns, (seen - shown)[z][here], rcond=None)[0][:3])
    if len(found) < RULES.fewest:
        return SlicesApart()
    each = np.stack(found)
    alone = each[1:-1] - (each[:-2] + each[2:]) / 2
    scale = _OVER_MEDIAN / _FROM_NEIGHBOURS
    shift, brightness = (np.median(np.abs(part)) * scale for part in (alone[:, :2], alone[:, 2]))
    return SlicesApart(float(shift), float(brightness))
