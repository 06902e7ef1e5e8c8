"""Whether a PSF is tilted: its axes are not those of the image.

A light sheet that enters at an angle leaves a PSF that is long along the axis of the objective, not
along Z, once the stack is deskewed (lattice light sheets, oblique plane microscopes). With a
Gaussian along the axes, cells come out slanted and too large. So a few steps are taken with a
Gaussian of any axes; where that leaves clearly less unexplained, the fit goes on with it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ...common.triple import geometric_mean
from ...optics import GaussianPSF, Optics
from ...optics.narrow import narrower_than_told
from ...scene.effects import Halo
from ..model.fitted import Fitted
from ..model.problem import Problem
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
    fraction, wide
        Share of the light in a halo, and its width over that of the PSF, from where it is tried;
        one of less than half of either is none. Chosen; measured: 0.36 to 0.42 and 1.8 to 2.1 in 14
        light sheets.
    haloed
        Of the squares that a tilted Gaussian leaves after as many steps: a halo that leaves more is
        dropped. Chosen.
    """

    left: float = 0.99
    tilted: float = 0.3
    fraction: float = 0.1
    wide: float = 3.0
    haloed: float = 0.99


RULES = TiltRules()


def tilt_instead(
    problem: Problem, terms: Terms, fitted: Fitted, image: Tensor
) -> tuple[Fitted | None, float, int]:
    """A Gaussian of any axes that explains an image clearly better than the one that was fitted.

    With a halo if that explains clearly more: the PSF of a light sheet has tails, what the sheet
    lights of the objective's cone. Without them, light of membranes makes up for them, or goes
    unseen.

    Returns the fit with it, as far as it went, and the share of what was left that it leaves; None
    and 1 if one is held or explains about as much. Also the evaluations that this took.

    Parameters
    ----------
    problem, terms, fitted
        Of the fit at its end, before its last level is left.
    image
        (Z, Y, X) as it renders that, of any amplitude.
    """
    along = fitted.optics
    if not may_change(terms, fitted) or not isinstance(along, GaussianPSF):
        return None, 1.0, 0
    if narrower_than_told(along.sigma_um, terms.level.grid.voxel_size):
        return None, 1.0, 0  # it stands in for light that the model lacks
    gains_too_little, turned = hopeless(image, 1.0), list[float]()

    def asked(objective: Objective) -> bool:
        turned.append(tilt_of(objective.fitted.optics))
        turns_too_little = len(turned) > 1 and turned[-1] <= RULES.tilted / 2
        return gains_too_little(objective) or turns_too_little

    # What shines is held: else light of membranes might explain more, and the tilt get the credit.
    rival = begun(terms, fitted.seen_through(of_any_axes(along)), Preconditioners())
    rival, taken = stepped(rival, asked)
    left = share_left(rival, image)
    if left >= 1 or tilt_of(rival.fitted.optics) <= RULES.tilted:
        return None, 1.0, taken
    width = geometric_mean(rival.fitted.optics.sigma_um)
    found, more = stepped(rival.anew())  # as far as one with a halo goes
    left, taken = share_left(found, image), taken + more
    if fitted.effects.halo is None:
        halo, more = stepped(_with_halo(problem, terms, rival.fitted, width))
        taken, with_it = taken + more, share_left(halo, image)
        if with_it < RULES.haloed * left and _shows(halo.fitted.effects.halo, width):
            found, left = halo, with_it
    return (None, 1.0, taken) if left >= RULES.left else (found.fitted, left, taken)


def _with_halo(problem: Problem, terms: Terms, tilted: Fitted, width: float) -> Objective:
    """The objective with a halo around a PSF of this width, um."""
    effects = tilted.effects.adding(Halo(fraction=RULES.fraction, width=RULES.wide * width))
    given = tilted.optics, terms.settings, effects, 1.0, tilted.effects.spread
    level, _ = problem.levels(*given)
    return begun(replace(terms, level=level), tilted.with_effects(effects), Preconditioners())


def _shows(halo: Halo | None, width: float) -> bool:
    """Whether there is one around a PSF of this width, um."""
    if halo is None:
        return False
    return halo.fraction > RULES.fraction / 2 and halo.width > RULES.wide * width / 2


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
