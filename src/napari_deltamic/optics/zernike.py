"""Zernike polynomials on the unit disc, in Noll's order and normalisation."""

from __future__ import annotations

from math import comb, sqrt

import torch
from torch import Tensor

from ..errors import InputError

NAMES = {
    5: "oblique astigmatism",
    6: "vertical astigmatism",
    7: "vertical coma",
    8: "horizontal coma",
    9: "vertical trefoil",
    10: "oblique trefoil",
    11: "spherical",
    12: "vertical secondary astigmatism",
    13: "oblique secondary astigmatism",
    14: "vertical quadrafoil",
    15: "oblique quadrafoil",
    22: "secondary spherical",
}
# Why the polynomials with these Noll indices are no parameters.
REFUSED = {
    1: "it changes no image",
    2: "a tilt of the pupil is a translation of the image: move the mesh",
    3: "a tilt of the pupil is a translation of the image: move the mesh",
    4: "defocus is a translation of the image along Z: move the mesh",
}
_HIGHEST = 66


def check_noll(index: int) -> None:
    """Raise InputError if a polynomial is no parameter of a PSF."""
    if index in REFUSED:
        raise InputError(f"Zernike {index} cannot be a parameter: {REFUSED[index]}")
    if not 5 <= index <= _HIGHEST:
        raise InputError(f"Zernike {index} is not known: Noll's order runs from 5 to {_HIGHEST}")


def noll(index: int) -> tuple[int, int]:
    """Return radial order n and angular order m of a Noll index (m < 0: a sine)."""
    n = 0
    first = 1
    while index >= first + n + 1:
        first += n + 1
        n += 1
    k = index - first
    m = 2 * ((k + 1) // 2) if n % 2 == 0 else 2 * (k // 2) + 1
    return n, m if index % 2 == 0 else -m


def zernike(index: int, y: Tensor, x: Tensor) -> Tensor:
    """Return the polynomial, of mean square 1 over the disc, at points of the unit disc.

    R. J. Noll, "Zernike polynomials and atmospheric turbulence", J. Opt. Soc. Am. 66, 1976; the
    angle is measured from the X axis towards Y.
    """
    n, m = noll(index)
    rho, angle = torch.sqrt(x * x + y * y), torch.atan2(y, x)
    k = abs(m)
    radial = torch.zeros_like(rho)
    for j in range((n - k) // 2 + 1):
        factor = (-1) ** j * comb(n - j, j) * comb(n - 2 * j, (n - k) // 2 - j)
        radial = radial + factor * rho ** (n - 2 * j)
    if m == 0:
        return sqrt(n + 1) * radial
    wave = torch.cos(k * angle) if m > 0 else torch.sin(k * angle)
    return sqrt(2 * (n + 1)) * radial * wave
