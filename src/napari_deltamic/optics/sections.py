"""Sections through the middle of a PSF, for display."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, pi

import numpy as np
import torch
from numpy.typing import NDArray

from . import Optics
from .parametric_psf import Axes

_WINDOW = 7.0  # side of what is shown, in largest widths
_ROOM = 1.6  # side of what is computed, in windows: the borders of a Fourier transform meet
_FINE = 2.5  # samples per width
_FEWEST, _MOST = 32, 128  # samples along an axis


@dataclass(frozen=True, eq=False)
class Sections:
    """The PSF in two square planes of equal side through its middle.

    xz, xy : (n, m) float64, largest value 1; rows along Z or Y, columns along X.
    side : of the squares, um.
    """

    xz: NDArray[np.float64]
    xy: NDArray[np.float64]
    side: float


def psf_sections(optics: Optics) -> Sections:
    """Compute the sections of a PSF from its OTF.

    Returns
    -------
    Squares of seven times the largest width of the PSF, sampled several times a width.
    """
    sigma = np.asarray(optics.sigma_um)
    side = _WINDOW * float(sigma.max())
    whole = _ROOM * side
    counts = [int(np.clip(2 * ceil(_FINE * whole / s / 2), _FEWEST, _MOST)) for s in sigma]
    with torch.no_grad():
        # On a copy: a PSF keeps its last OTF, which a running fit may still need.
        otf = optics.detach().otf(_axes(counts, whole)).to(torch.complex128)
        psf = torch.fft.fftshift(torch.fft.ifftn(otf).real).numpy()
    z, y, _ = (n // 2 for n in counts)
    keep = [_middle(n) for n in counts]
    xz, xy = psf[keep[0], y, keep[2]], psf[z, keep[1], keep[2]]
    peak = max(float(xz.max()), float(xy.max()), np.finfo(float).tiny)
    return Sections(xz / peak, xy / peak, side)


def _axes(counts: list[int], length: float) -> Axes:
    """Return the wavevectors of a box, rad/um, in the shapes that an OTF takes."""
    z, y, x = (2 * pi * torch.fft.fftfreq(n, length / n, dtype=torch.float64) for n in counts)
    return z.reshape(-1, 1, 1), y.reshape(1, -1, 1), x.reshape(1, 1, -1)


def _middle(n: int) -> slice:
    """Return the part of an axis that is shown, centred on n // 2."""
    half = int(n / _ROOM / 2)
    return slice(n // 2 - half, n // 2 + half + 1)
