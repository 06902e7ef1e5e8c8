"""Whether an image shows the light cone of an objective, which a Gaussian PSF lacks.

Out of focus, light spreads over a cone (all of it in a widefield microscope, what a pinhole passes
in a confocal one). With a Gaussian PSF, a fit makes up for it with surfaces and light inside, and
cells come out too high, or are lost. So at its end a few steps are taken with the PSF of an
objective about as wide; where that leaves less unexplained, the fit begins anew with it, or, of a
confocal one, whose cone is faint, goes on with it, unless it is far from symmetric: spherical
aberration, as a mismatch of refractive indices causes, draws the cone to one side. It is fitted
where these steps find some.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from torch import Tensor

from ...optics import ConfocalPSF, GaussianPSF, Optics, ScalarPSF, microscope
from ...optics.narrow import narrower_than_told
from ...runs.scene_settings import SIGMA_IN_VOXELS
from ..model.amplitudes import may_shine
from ..model.fitted import Fitted
from ..objective.fit_objective import Objective, Terms
from ..solvers.preconditioner import Preconditioners
from .rival_structures import begun, stepped

# Of a widefield PSF, by definition: standard deviation across, in wavelengths over NA (B. Zhang et
# al., Appl. Opt. 46, 2007), and full width at half maximum along, in wavelengths over
# n - sqrt(n^2 - NA^2) (S. Wilhelm et al., "Confocal Laser Scanning Microscopy", Zeiss, 2003).
_ACROSS, _ALONG = 0.22, 0.88
_HALVES = 2.3548  # by definition: that width of a Gaussian, over its standard deviation
_INDEX = 1.33  # of water; chosen: wavelength and NA stand in for any other
# NA over index; chosen: few objectives gather more, and a fit may go on from there.
_WIDEST = 0.92
_OF_LIGHT = (0.2, 2.0)  # um; wavelengths that microscopes use, near enough for a start
_FITTED = ("na", "wavelength")
ThroughObjective = ScalarPSF | ConfocalPSF
ANEW = "the image shows a widefield light cone: the fit restarts with a widefield PSF"
ABERRATED = "the image shows an aberrated light cone: the fit restarts with a confocal PSF"
GOES_ON = "the image shows a confocal light cone: the fit continues with a confocal PSF"


@dataclass(frozen=True)
class LightConeRules:
    """When an objective's PSF is tried, and when the trial is given up.

    Attributes
    ----------
    told
        How far off the spectrum's first widths may be: it tells them to 10 or 20 %.
    aberrated, much
        rad of spherical aberration after a few steps. What has more than the first is fitted with
        it, a confocal PSF with more than the second begins anew. Chosen; measured: up to 0.03 in
        seven widefield and confocal stacks of no aberration; of 0.4 to 0.8 rad, 0.4 to 0.6 in seven
        stacks of cells with membranes or nuclei, 0.14 in an eighth.
    far
        Of the squares that the Gaussian leaves: a widefield PSF that leaves more before the first
        step is not followed. Measured: 0.1 to 1.03 times as many in 20 widefield stacks (50 to
        10,000 photons, some of nuclei or in a haze), 2.7 to 17 in eight confocal ones, 5.7 with a
        Gaussian PSF as long, 6.3 in vesicles.
    hopeless
        Of the squares beyond noise that the Gaussian leaves: an objective that leaves more is
        dropped. Measured before the first step, with a widefield PSF: 0.1 to 11 times as many in
        widefield stacks (6 to 10,000 photons, some with light inside or around), 13 to 55 in
        confocal ones of 30 photons and more without a haze, more with Gaussian PSFs as long. With a
        confocal one: 0.9 to 1.6 times in four confocal stacks.
    longer
        Times as long as the spectrum told: a Gaussian that insides alone have made so long stands
        in for a cone. Measured in 190 random scenes: 1.97 to 3.9 in four such fits, 0.6 to 2.7
        voxels off, all but one of widefield stacks; at most 1.6 in others of insides alone.
    legs
        How often one is followed as far again, while it leaves too much, and would not if it
        gained as much again. Measured on eight nuclei under 0.76 rad of spherical aberration: a
        confocal PSF had found 0.17 rad after the first leg, and left 1.004 times as much.
    """

    told: float = 1.2
    aberrated: float = 0.1
    much: float = 0.3
    far: float = 2.0
    hopeless: float = 30.0
    longer: float = 1.8
    legs: int = 2


RULES = LightConeRules()


def objective_instead(
    terms: Terms, fitted: Fitted, image: Tensor, enough: float = 1.0
) -> tuple[ThroughObjective | None, int]:
    """The PSF of an objective that explains an image better than the Gaussian that was fitted.

    It is widefield or confocal, and as wide as the Gaussian was at the start (or, if that was the
    default width, as it has become). The one that leaves less of the same voxels unexplained at the
    end of the fit is followed for a few steps from there. If that is the confocal one, and the
    widefield one is not far off, it is followed as well, and has to leave less than that: a
    widefield stack of small cells, 0.98 voxel off with a Gaussian, needs it. (Of 18 simulated
    stacks of six kinds, following both wherever they are would have changed none.) If the widefield
    one leads and does not help, the confocal one is followed: in a confocal stack of a cell under
    spherical aberration, which was fitted badly, the widefield one led and left 1.4 times as much
    as the Gaussian after the steps, and the confocal one 0.8 times.

    What is left is compared over the voxels of the last objective posed. (In 14 stacks, posing it
    anew after the last step changed that by 0.004 at most.) A widefield PSF that is far off where
    it begins is not followed, even if the confocal one is further off.

    Tried where the Gaussian was, or has become, as long as the roundest PSF of an objective: in a
    haze it ends rounder, elsewhere a cone makes it longer. Not tried where the Gaussian became
    narrower than voxels can resolve: it stands in for light that the model lacks, and so would any
    other PSF.

    Nor is one followed that begins so narrow, as a confocal one does beside a Gaussian of less than
    0.73 voxel across or 0.79 along Z, or what explains less than that. (One beside a Gaussian of
    more than 2 um is always too narrow: light has no such wavelength.) One that has become so
    narrow after its steps is dropped, and with it one that explains less.

    Returns that PSF as it was before the steps, and of what they found its spherical aberration
    (see :class:`LightConeRules`); None if the Gaussian is held or explains as much. Also the
    evaluations that this took.

    Parameters
    ----------
    terms, fitted
        Of the fit at its end, before its last level is left.
    image
        (Z, Y, X) as it renders that, of any amplitude.
    enough
        Share of what the Gaussian leaves, of which it must leave less.
    """
    first, voxel_size = fitted.first_optics, terms.level.grid.voxel_size
    if not may_change(terms, fitted) or narrower_than_told(fitted.optics.sigma_um, voxel_size):
        return None, 0
    roundest = _tangent_of_half(_WIDEST)
    known = not _is_default(first.sigma_um, voxel_size)
    about = first.sigma_um if known else fitted.optics.sigma_um
    long_at_first = known and _roundness(about) <= RULES.told * roundest
    if not long_at_first and _roundness(fitted.optics.sigma_um) > roundest:
        return None, 0
    # One is let go before the other is posed, to save memory.
    of_widefield = share_left(_posed(widefield_of(about), terms, fitted), image)
    leads = share_left(_posed(confocal_of(about), terms, fitted), image) < of_widefield
    found: ThroughObjective | None = None
    taken, narrow = 0, 1.0
    for made in (confocal_of, widefield_of) if leads else (widefield_of, confocal_of):
        if made is widefield_of and of_widefield > RULES.far:
            continue
        if made is confocal_of and found is not None:  # the widefield one
            continue
        begin = made(about, 0.0)
        if narrower_than_told(begin.sigma_um, voxel_size):
            break
        rival, more = _followed(_posed(begin, terms, fitted), image, enough)
        left, taken = share_left(rival, image), taken + more
        # A fit that went on with one too narrow would come back. Measured on real nuclei: 0.38
        # voxel wide after these steps, and given up after 40 iterations.
        if narrower_than_told(rival.fitted.optics.sigma_um, voxel_size):
            narrow = min(left, narrow)
        elif left < enough:
            found, enough = made(about, _where_to_begin(rival.fitted.optics)), left
        del rival
    # One that explains less than what is too narrow would stand in for that.
    return found if enough <= narrow else None, taken


def widefield_anew(terms: Terms, fitted: Fitted) -> ScalarPSF | None:
    """A widefield PSF with which a fit may begin anew, though it explains no more where that ended.

    Where insides alone have made the Gaussian much longer than the spectrum told, they may stand in
    for membranes in a light cone, further in; from there, a few steps lead to neither. A fit of
    five cells in a widefield stack was 2.2 voxels off, and the one that begins anew is 0.3 off.
    None where that is not so, or where someone said what is labelled.
    """
    first, size = fitted.first_optics, terms.level.grid.voxel_size
    if terms.settings.structure != "auto" or fitted.structure != "interior":
        return None
    if not may_change(terms, fitted) or _is_default(first.sigma_um, size):
        return None
    ratio = np.asarray(fitted.optics.sigma_um) / np.asarray(first.sigma_um)
    long = ratio[0] >= RULES.longer and ratio[1:].min() >= 1
    return widefield_of(first.sigma_um) if long else None


def _where_to_begin(optics: Optics) -> float | None:
    """rad of spherical aberration that is fitted from there; None where the steps found none."""
    aberration = spherical_of(optics)
    if abs(aberration) <= RULES.aberrated:
        return None
    goes_on = isinstance(optics, ConfocalPSF) and abs(aberration) <= RULES.much
    return 0.0 if goes_on else aberration


def may_change(terms: Terms, fitted: Fitted) -> bool:
    """Whether a fit has fitted a Gaussian PSF, in place of which there may be another kind."""
    if not (is_plain(fitted.optics) and is_plain(fitted.first_optics)):
        return False
    return terms.settings.fit_psf and terms.second is None


def _posed(optics: ThroughObjective, terms: Terms, fitted: Fitted) -> Objective:
    """The objective where a fit is, seen through a PSF; all that may shine does again."""
    rival = fitted.seen_through(optics)
    rival = rival.with_structure(may_shine(terms.settings.structure, fitted.mesh, optics))
    return begun(terms, rival, Preconditioners())


def share_left(objective: Objective, image: Tensor) -> float:
    """What an objective leaves over what the fit has left."""
    return objective.left / objective.posed.left_by(image)[0]


def _followed(rival: Objective, image: Tensor, enough: float) -> tuple[Objective, int]:
    """The objective after a few steps, and evaluations taken.

    enough : share left, of which less is wanted.
    """
    looked: list[float] = []

    def hopeless(objective: Objective) -> bool:
        left, noise = objective.posed.left_by(image)
        looked.append(objective.left / left)
        if len(looked) == 1:
            return objective.left - noise > RULES.hopeless * max(left - noise, 0.0)
        return 2 * looked[-1] - looked[-2] >= enough  # would not do if it gained as much again

    rival, taken = stepped(rival, hopeless)
    for _ in range(RULES.legs):
        left = share_left(rival, image)
        if left < enough or 2 * left - looked[-1] >= enough:
            break
        rival = rival.anew()  # the one before is let go, to save memory
        rival, more = stepped(rival, hopeless)
        taken += more
    return rival, taken


def spherical_of(optics: Optics) -> float:
    """rad of spherical aberration of the PSF of an objective; 0 of any other."""
    if not isinstance(optics, ThroughObjective):
        return 0.0
    return float(optics.values["spherical"].detach())


def widefield_of(sigma: Sequence[float], spherical: float | None = None) -> ScalarPSF:
    """A widefield PSF about as wide, whose aperture and wavelength are fitted; sigma : um, Z Y X.

    As wide as light makes one. spherical : rad, where that begins to be fitted; None for none.
    """
    na, wavelength = _as_wide(sigma)
    return ScalarPSF(na, wavelength, _INDEX, spherical=spherical or 0.0, fitted=_fitted(spherical))


def confocal_of(sigma: Sequence[float], spherical: float | None = None) -> ConfocalPSF:
    """A confocal PSF about as wide, whose aperture and wavelengths are fitted; sigma : um, Z Y X.

    spherical : rad, where that begins to be fitted; None for none.

    Begun with those of a widefield PSF of that width: what a pinhole takes off it, the fit finds.
    """
    na, wavelength = _as_wide(sigma)
    made = microscope(
        "confocal",
        na=na,
        wavelength=wavelength,
        immersion=_INDEX,
        model="scalar",
        spherical=spherical or 0.0,
        fitted=(*_fitted(spherical), "excitation"),
    )
    assert isinstance(made, ConfocalPSF)
    return made


def _fitted(spherical: float | None) -> tuple[str, ...]:
    """Names of the parameters of an objective that are fitted."""
    return _FITTED if spherical is None else (*_FITTED, "spherical")


def _as_wide(sigma: Sequence[float]) -> tuple[float, float]:
    """NA and wavelength (um) of a widefield PSF."""
    tangent = min(_roundness(sigma), _tangent_of_half(_WIDEST))
    sine = 2 * tangent / (1 + tangent**2)
    wavelength = sqrt(sigma[1] * sigma[2]) * sine * _INDEX / _ACROSS
    return sine * _INDEX, float(np.clip(wavelength, *_OF_LIGHT))


def is_plain(optics: Optics) -> bool:
    """Whether it is a Gaussian along the axes, which a fit may replace."""
    return isinstance(optics, GaussianPSF) and optics.diagonal


def _is_default(sigma: Sequence[float], voxel_size: Sequence[float]) -> bool:
    """Whether widths are those that a fit begins with where neither user nor image tell them."""
    return bool(np.allclose(sigma, SIGMA_IN_VOXELS * np.asarray(voxel_size)))


def _roundness(sigma: Sequence[float]) -> float:
    """Tangent of half the angle of the cone of an objective with such a PSF.

    With NA = n sin(a), width across over width along grows as sin(a) / (1 + cos(a)) = tan(a / 2).
    """
    return _ALONG / _HALVES / _ACROSS * sqrt(sigma[1] * sigma[2]) / sigma[0]


def _tangent_of_half(sine: float) -> float:
    """The tangent of half the angle of this sine."""
    return sine / (1 + sqrt(1 - sine**2))
