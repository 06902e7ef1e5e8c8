"""Whether a PSF is tilted: its axes are not those of the image.

A light sheet that enters at an angle leaves a PSF that is long along the axis of the objective, not
along Z, once the stack is deskewed (lattice light sheets, oblique plane microscopes). With a
Gaussian along the axes, cells come out slanted and too large. So a few steps are taken with a
Gaussian of any axes; where that leaves clearly less unexplained, the fit goes on with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...optics import GaussianPSF, Optics
from ...optics.narrow import narrower_than_told
from ..model.fitted import Fitted
from ..objective.fit_objective import Objective, Terms
from ..solvers.preconditioner import Preconditioners
from .light_cone import may_change, share_left
from .psf_tails import hopeless
from .rival_structures import begun, stepped

IS_TILTED = "the image shows a tilted PSF: the fit continues with a Gaussian PSF along other axes"


@dataclass(frozen=True)
class TiltRules:
    """When a tilted Gaussian is followed.

    Attributes
    ----------
    left
        Of the squares that the Gaussian along the axes leaves: what leaves more after a few steps
        is dropped. Chosen; measured: 0.55 to 0.985 in 17 stacks whose PSF leaned by 25 to 45
        degrees, less in brighter ones; 0.978 to 1.000 in 26 of other PSFs (benchmarks.defaults).
    tilted
        Correlation of two axes below which the tilt is none, and the steps gained by something
        else. Chosen; measured: 0.4 and more where it leaned, 0.00 to 0.12 where steps with other
        PSFs gained as much, 0.25 in real vesicles seen through a confocal microscope, and 0.43 in a
        nucleus that ended as near with it. The trial ends when it is first looked at again if half
        of this is not reached: measured there, 0.28 to 0.43 where it leaned.
    """

    left: float = 0.99
    tilted: float = 0.3


RULES = TiltRules()


def tilt_instead(terms: Terms, fitted: Fitted, image: Tensor) -> tuple[Fitted | None, float, int]:
    """A Gaussian of any axes that explains an image clearly better than the one that was fitted.

    Returns the fit with it, as far as it went, and the share of what was left that it leaves; None
    and 1 if one is held or explains about as much. Also the evaluations that this took.

    Parameters
    ----------
    terms, fitted
        Of the fit at its end, before its last level is left.
    image
        (Z, Y, X) as it renders that, of any amplitude.
    """
    along = fitted.optics
    if not may_change(terms, fitted) or not isinstance(along, GaussianPSF):
        return None, 1.0, 0
    if narrower_than_told(along.sigma_um, terms.level.grid.voxel_size):
        return None, 1.0, 0  # it stands in for light that the model lacks
    # What shines is held: else light of membranes might explain more, and the tilt get the credit.
    rival = begun(terms, fitted.seen_through(of_any_axes(along)), Preconditioners())
    gains_too_little, turned = hopeless(image, RULES.left), list[float]()

    def asked(objective: Objective) -> bool:
        turned.append(tilt_of(objective.fitted.optics))
        turns_too_little = len(turned) > 1 and turned[-1] <= RULES.tilted / 2
        return gains_too_little(objective) or turns_too_little

    rival, taken = stepped(rival, asked)
    left = share_left(rival, image)
    if left >= RULES.left or tilt_of(rival.fitted.optics) <= RULES.tilted:
        return None, 1.0, taken
    return rival.fitted, left, taken


def tilt_of(optics: Optics) -> float:
    """The largest correlation of two axes of a Gaussian, 0 to 1."""
    if not isinstance(optics, GaussianPSF):
        return 0.0
    covariance = optics.covariance.detach()
    width = covariance.diagonal().sqrt()
    return float((covariance / width / width[:, None] - torch.eye(3)).abs().max())


def of_any_axes(optics: GaussianPSF) -> GaussianPSF:
    """The same Gaussian, of which a fit may turn the axes."""
    return GaussianPSF(covariance=optics.covariance.detach())
