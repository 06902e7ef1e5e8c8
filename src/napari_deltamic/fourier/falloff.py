"""How the power of a shape falls with the wavevector, and the error of leaving out a part."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import ceil, erfc, exp, floor, inf, log, log2, pi, sqrt
from typing import TypeVar

import numpy as np
from torch import Tensor

_Numbers = TypeVar("_Numbers", np.ndarray, Tensor)


@dataclass(frozen=True)
class Falloff:
    """The power, averaged over directions, is ``min(1, (turn / |xi|)^order)`` of its total squared.

    Attributes
    ----------
    order
        2 for a surface, 4 for a solid (G. Porod, Kolloid-Z. 124, 1951), 0 for a point, whose power
        does not fall. Something thin (a speck, a thread, a flake) lies between a point and a
        surface, and the point's law is an upper bound for it.
    turn
        In 1 / width of the PSF: below it the shape looks like a point.
    """

    order: int = 0
    turn: float = inf

    def of(self, squared: _Numbers) -> _Numbers:
        """Return the power at wavevectors of these squared lengths, in 1 / width^2."""
        if not self.order:
            return squared**0
        return (squared / self.turn**2).clip(1.0, None) ** (-self.order / 2)

    def of_a_wall(self) -> Falloff:
        """Return the falloff along a flat wall's normal: none for surfaces, order 2 for solids."""
        return Falloff(max(self.order - 2, 0), self.turn)


POINT_LIKE = Falloff()


def of_surface(area: float, volume: float) -> Falloff:
    """Return the falloff of a surface, ``2 pi / (area xi^2)``; lengths are in widths of the PSF."""
    if 2 * volume <= 1.5 * area:
        return POINT_LIKE
    # Rounded to the safe side, so that the tables of one mesh serve similar ones.
    return Falloff(2, sqrt(2 * pi / 2.0 ** (floor(2 * log2(max(area, 1e-6))) / 2)))


def of_solid(area: float, volume: float) -> Falloff:
    """Return the falloff of a solid, ``2 pi area / xi^4`` far out; lengths are in PSF widths.

    It turns where the sum over all wavevectors is that of the volume (Parseval), at ``4 area / (3
    pi volume)``; thinner than the PSF, a solid is seen as the surface is.
    """
    turn = 4 * area / (3 * pi * max(volume, 1e-300))
    if turn >= 1:
        return of_surface(area, volume)
    return Falloff(4, 2.0 ** (ceil(2 * log2(max(turn, 1e-6))) / 2))


def band_error(threshold: float, falloff: Falloff) -> float:
    """Return the relative L2 error of leaving out |OTF| < threshold, for a Gaussian OTF."""
    reach = sqrt(2 * log(1 / threshold))
    if not falloff.order:
        return sqrt(erfc(reach) + 2 / sqrt(pi) * reach * exp(-(reach**2)))
    return sqrt(_beyond(reach, falloff) / _beyond(0.0, falloff))


def _beyond(first: float, falloff: Falloff) -> float:
    """Integrate ``exp(-k^2) k^2`` times the power from ``first`` on."""
    from scipy.integrate import quad

    def power(k: float) -> float:
        return exp(-(k**2)) * k**2

    turn, last = falloff.turn, max(first, falloff.turn)
    near = quad(power, first, turn, epsabs=0, epsrel=1e-6)[0] if first < turn else 0.0
    if falloff.order == 2:
        return float(near) + turn**2 * sqrt(pi) / 2 * erfc(last)
    return float(near) + turn**4 * (exp(-(last**2)) / last - sqrt(pi) * erfc(last))


@cache
def threshold_for(error: float, falloff: Falloff) -> float:
    """Return the threshold whose :func:`band_error` is ``error``; at most one half."""
    from scipy.optimize import brentq

    def excess(log_threshold: float) -> float:
        return log(band_error(exp(log_threshold), falloff)) - log(error)

    last = log(0.5)  # chosen: a band that is smaller still saves nothing
    return float(exp(last if excess(last) <= 0 else brentq(excess, -150.0, last, xtol=1e-4)))
