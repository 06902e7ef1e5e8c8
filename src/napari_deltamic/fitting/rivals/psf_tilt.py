"""Whether a PSF is tilted: its axes are not those of the image.

A light sheet that enters at an angle leaves a PSF that is long along the axis of the objective, not
along Z, once the stack is deskewed (lattice light sheets, oblique plane microscopes). With a
Gaussian along the axes, cells come out slanted and too large. So a few steps are taken with a
Gaussian of any axes; where that leaves clearly less unexplained, the fit goes on with it, and with
a halo for the tails of such a PSF, if that explains clearly more.
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
from .light_cone import share_left
from .psf_tails import hopeless
from .rival_structures import begun, stepped

IS_TILTED = "the image shows a tilted PSF: the fit continues with a tilted Gaussian PSF"
HAS_HALO = (
    "the image shows a tilted PSF with tails: the fit continues with a tilted Gaussian PSF and a "
    "halo"
)


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
        Share of the light in a halo, and its width over that of the PSF, from where it is tried.
        Chosen; measured in the end: 0.36 to 0.43 and 2.4 to 3.7 in 11 light sheets.
    faint, narrow
        One of less light, or narrower, is none. Chosen.
    haloed
        Of the squares that a tilted Gaussian leaves after as many steps: a halo that leaves more is
        dropped. Chosen.
    """

    left: float = 0.99
    tilted: float = 0.3
    fraction: float = 0.1
    wide: float = 3.0
    faint: float = 0.05
    narrow: float = 1.2
    haloed: float = 0.99


RULES = TiltRules()


def tilt_instead(
    problem: Problem, terms: Terms, fitted: Fitted, image: Tensor
) -> tuple[Fitted | None, float, int]:
    """A Gaussian of any axes that explains an image clearly better than the one that was fitted.

    With a halo if that explains clearly more: the PSF of a light sheet has tails, what the sheet
    lights of the objective's cone. Without them, light of membranes makes up for them, or goes
    unseen. Around a Gaussian that was tilted from the start, only a halo is looked for.

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
    if not isinstance(along, GaussianPSF) or not terms.settings.fit_psf or terms.second is not None:
        return None, 1.0, 0
    if narrower_than_told(along.sigma_um, terms.level.grid.voxel_size):
        return None, 1.0, 0  # it stands in for light that the model lacks
    upright = along.diagonal
    if not upright and fitted.effects.role(Halo) is not None:
        return None, 1.0, 0
    # What shines is held: else light of membranes might explain more, and the tilt get the credit.
    rival = _posed(terms, fitted.seen_through(of_any_axes(along)) if upright else fitted)
    tilted, taken = _turned(rival, image) if upright else (rival, 0)
    if tilted is None:
        return None, 1.0, taken
    found, left, more = _followed(problem, terms, tilted, image)
    taken += more
    new = upright or found.effects.role(Halo) is not None
    return (found, left, taken) if new and left < RULES.left else (None, 1.0, taken)


def _turned(rival: Objective, image: Tensor) -> tuple[Objective | None, int]:
    """A few steps on with any axes, if these turn; evaluations taken."""
    gains_too_little, turned = hopeless(image, 1.0), list[float]()

    def asked(objective: Objective) -> bool:
        turned.append(tilt_of(objective.fitted.optics))
        turns_too_little = len(turned) > 1 and turned[-1] <= RULES.tilted / 2
        return gains_too_little(objective) or turns_too_little

    rival, taken = stepped(rival, asked)
    turns = tilt_of(rival.fitted.optics) > RULES.tilted and share_left(rival, image) < 1
    return (rival if turns else None), taken


def _followed(
    problem: Problem, terms: Terms, tilted: Objective, image: Tensor
) -> tuple[Fitted, float, int]:
    """A few steps on, with a halo if that leaves clearly less; what is left; evaluations."""
    before = tilted.fitted
    plain, taken = _legs(tilted.anew())  # as far as one with a halo goes
    left = share_left(plain, image)
    if before.effects.role(Halo) is not None:
        return plain.fitted, left, taken
    halo, more = _legs(_with_halo(problem, terms, before))
    with_it = share_left(halo, image)
    if with_it < RULES.haloed * left and _has_halo(halo.fitted):
        return halo.fitted, with_it, taken + more
    return plain.fitted, left, taken + more


def _legs(objective: Objective) -> tuple[Objective, int]:
    """Some steps on, and as many again; evaluations.

    A halo may need them: in a simulated cell it held 0.80 of the light after the first ones, and
    left 1.01 times as much as no halo; after further ones 0.36, and 0.94 times as much.
    """
    first, taken = stepped(objective)
    there, more = stepped(first.anew())
    return there, taken + more


def _with_halo(problem: Problem, terms: Terms, tilted: Fitted) -> Objective:
    """The objective of a fit with a halo as well."""
    width = geometric_mean(tilted.optics.sigma_um)
    effects = tilted.effects.adding(Halo(fraction=RULES.fraction, width=RULES.wide * width))
    given = tilted.optics, terms.settings, effects, 1.0, tilted.effects.spread
    level, _ = problem.levels(*given)
    return _posed(replace(terms, level=level), tilted.with_effects(effects))


def _posed(terms: Terms, fitted: Fitted) -> Objective:
    """The objective of a rival, where it begins."""
    return begun(terms, fitted, Preconditioners())


def _has_halo(fitted: Fitted) -> bool:
    """Whether there is one, and around the PSF."""
    halo, width = fitted.effects.role(Halo), geometric_mean(fitted.optics.sigma_um)
    if halo is None:
        return False
    return halo.fraction > RULES.faint and halo.width > RULES.narrow * width


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
