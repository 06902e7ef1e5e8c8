"""Whether a PSF has a sharp core and long tails along Z.

Aberrations, a light sheet that is thick in places or a pinhole that is wide leave tails that are
neither those of a Gaussian nor of an ideal objective. A Gaussian is then too long for what is in
focus and too short for what is not. So, where no objective explains an image better, a few steps
are taken with two Gaussians that are equally wide across; where that leaves clearly less
unexplained, the fit goes on with them.

Where a haze makes a Gaussian long, it may become narrower across than voxels can tell, to be as
sharp as the borders are. Two Gaussians then begin as wide across as it was at the start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from torch import Tensor

from ...optics import GaussianMixturePSF
from ...optics.narrow import narrower_than_told
from ..model.fitted import Fitted
from ..objective.fit_objective import Objective, Terms
from ..solvers.preconditioner import Preconditioners
from .light_cone import may_change, share_left
from .rival_structures import begun, stepped

Widths = tuple[float, float, float]
HAS_TAILS = "the image shows a PSF with long tails along Z: the fit continues with two Gaussians"


@dataclass(frozen=True)
class TailRules:
    """Where two Gaussians begin, and when they are followed.

    Attributes
    ----------
    core, tails
        Lengths along Z over that of the Gaussian that was fitted; of equal masses. Chosen between
        it and those that fits of real nuclei and a real droplet ended with: 0.32 and 0.53 of it,
        and 2.2 and 1.8.
    left
        Of the squares that the Gaussian leaves: what leaves more after a few steps is dropped.
        Chosen; measured: 0.99 to 1.01 in seven simulated stacks (benchmarks.defaults). In real
        ones: 0.946 in vesicles, which hardly changed, 0.92 in nuclei, whose heights and volumes
        came to those of labels drawn by hand, 0.56 in a droplet.
    """

    core: float = 0.5
    tails: float = 1.5
    left: float = 0.95


RULES = TailRules()


def tails_instead(terms: Terms, fitted: Fitted, image: Tensor) -> tuple[Fitted | None, int]:
    """Two Gaussians that explain an image clearly better than the one that was fitted.

    Returns the fit with them, as far as it went; None if one is held or explains about as much.
    Also the evaluations that this took.

    Parameters
    ----------
    terms, fitted
        Of the fit at its end, before its last level is left.
    image
        (Z, Y, X) as it renders that, of any amplitude.
    """
    if not may_change(terms, fitted):
        return None, 0
    about = _about(fitted, terms.level.grid.voxel_size)
    if about is None:
        return None, 0
    tailed = core_and_tails(about)
    # What shines is held: else light of membranes might explain more, and the tails get the credit.
    rival = begun(terms, fitted.seen_through(tailed), Preconditioners())
    rival, taken = stepped(rival, hopeless(image, RULES.left))
    return (rival.fitted if share_left(rival, image) < RULES.left else None), taken


def hopeless(image: Tensor, enough: float) -> Callable[[Objective], bool]:
    """Whether a rival, looked at in turn, would leave too much if it gained as much again.

    image : (Z, Y, X) as the fit renders that, of any amplitude; enough : share left that it is held
    against.
    """
    looked = list[float]()

    def asked(objective: Objective) -> bool:
        looked.append(share_left(objective, image))
        return len(looked) > 1 and 2 * looked[-1] - looked[-2] >= enough

    return asked


def _about(fitted: Fitted, voxel_size: Widths) -> Widths | None:
    """um, Z Y X: the Gaussian's widths; across, those of the start where they became too narrow.

    None where the image tells less than that.
    """
    z, y, x = fitted.optics.sigma_um
    if narrower_than_told((y, x), voxel_size[1:]):
        _, y, x = fitted.first_optics.sigma_um
    return None if narrower_than_told((z, y, x), voxel_size) else (z, y, x)


def core_and_tails(sigma: Sequence[float]) -> GaussianMixturePSF:
    """Two Gaussians, one shorter and one longer than another; sigma : um, Z Y X, of that one."""
    z, y, x = sigma
    return GaussianMixturePSF([(RULES.core * z, y, x), (RULES.tails * z, y, x)], (1.0, 1.0))
