"""Whether an image shows the light cone of an objective, which a Gaussian PSF lacks.

Out of focus, light spreads over a cone (all of it in a widefield microscope, what a pinhole passes
in a confocal one). With a Gaussian PSF, a fit makes up for it with surfaces and light inside, and
cells come out too high. So the image is also rendered through an objective's PSF of the same
widths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import sqrt

from ..errors import InputError
from ..fitting.pose import Posed
from ..fitting.responses import Responses
from ..fitting.state import FitState
from ..optics import GaussianPSF, ScalarPSF
from .fainter_membranes import shown

# Of a widefield PSF, by definition: standard deviation across, in wavelengths over NA (B. Zhang et
# al., Appl. Opt. 46, 2007), and full width at half maximum along, in wavelengths over
# n - sqrt(n^2 - NA^2) (S. Wilhelm et al., "Confocal Laser Scanning Microscopy", Zeiss, 2003).
_ACROSS, _ALONG = 0.22, 0.88
_HALVES = 2.3548  # by definition: that width of a Gaussian, over its standard deviation
_INDEX = 1.33  # of water; chosen: wavelength and NA stand in for any other
_WIDEST = 0.97  # NA over index; chosen: no objective gathers more


def shows_cone(
    posed: Posed, responses: Responses, state: FitState, first: Sequence[float], sure: float
) -> bool:
    """Whether an objective's PSF gains more than some nats over the Gaussian that a fit ended with.

    The surface follows. Skipped where the PSF is held or is no Gaussian, or where no objective
    could have such widths.

    Parameters
    ----------
    first
        um, Z Y X: widths that the fit began with, tried as well as those at its end.
    sure
        Nats.
    """
    if not isinstance(state.optics, GaussianPSF) or not len(posed.at.optics):
        return False
    now = shown(posed, state)
    for sigma in (first, state.optics.sigma_um):
        try:
            other = shown(posed, replace(state, optics=objective_of(sigma)))
        except InputError:
            continue
        gain, _ = responses.instead(state.amplitude * (other - now))
        if gain > sure:
            return True
    return False


def objective_of(sigma: Sequence[float]) -> ScalarPSF:
    """A widefield PSF about as wide; sigma : um, Z Y X. InputError where no light makes one."""
    across = sqrt(sigma[1] * sigma[2])
    # With NA = n sin(a), the ratio of both widths grows as (1 + cos(a)) / sin(a) = 1 / tan(a / 2).
    tangent = _ALONG / _HALVES / _ACROSS * across / sigma[0]
    sine = min(2 * tangent / (1 + tangent**2), _WIDEST) if tangent < 1 else _WIDEST
    return ScalarPSF(sine * _INDEX, across * sine * _INDEX / _ACROSS, _INDEX, fitted=())
