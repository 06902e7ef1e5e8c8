"""Checks of a whole fit: each looks at one fact, and returns a reason or None.

NaN is never a reason.
"""

from __future__ import annotations

from collections.abc import Callable

from ..errors import listed
from .facts import Facts
from .reason import Reason, fair_if, unexplained
from .sanity import SINGLE
from .verdict_rules import RULES

FitCheck = Callable[[Facts], Reason | None]


def _unfinished(fit: Facts) -> Reason | None:
    if fit.by_hand:
        return Reason("unfinished", "poor", "it was changed by hand: continue the fit")
    if fit.finished:
        return None
    text = "the fit has not converged: continue it, or start from better seeds"
    return Reason("unfinished", "poor", text)


def _nothing(fit: Facts) -> Reason | None:
    if fit.explained is not None:
        return None
    text = "nothing around the surfaces is brighter or darker than noise"
    return Reason("nothing", "poor", text)


def _explained(fit: Facts) -> Reason | None:
    return unexplained(fit.explained, RULES.good, RULES.fair, "the surfaces")


def _widths(fit: Facts) -> Reason | None:
    """Whether the blur that the image shows differs from that of the PSF."""
    across = fit.widths.get("across", 1.0)
    if across > RULES.widths[1]:
        text = f"the image is {across:.2g} times as blurred as the PSF implies: a thick layer, "
        text += "light inside, or too narrow a PSF (--structure auto, --fit-psf)"
        return Reason("widths", "fair", text)
    least = {"across": RULES.widths[0], "along Z": RULES.along}
    sharper = {axis: 1 / width for axis, width in fit.widths.items() if width < least[axis]}
    if not sharper:
        return None
    planes = {"across": "in XY", "along Z": "in Z"}
    told = " and ".join(f"{times:.2g} times as sharp {planes[a]}" for a, times in sharper.items())
    text = f"the image is {told} as the PSF allows: is this a thick bright layer? If not, give the "
    grade = fair_if(max(sharper.values()) <= 1 / RULES.far_off)
    return Reason("widths", grade, text + "PSF's width")


def _cone(fit: Facts) -> Reason | None:
    if not fit.error.cone:
        return None
    text = "the image shows the light cone of an objective, which a Gaussian PSF lacks: describe it"
    return Reason("cone", "fair", f"{text} (--modality, --na, --wavelength)")


def _narrow(fit: Facts) -> Reason | None:
    if not fit.narrow:
        return None
    text = "the fitted PSF is too narrow for the voxels: it stands in for something else, such as"
    return Reason("narrow", "fair", f"{text} texture or haze")


def _saturated(fit: Facts) -> Reason | None:
    if not fit.cut > RULES.cut:
        return None
    text = f"{fit.cut:.0%} of the bright voxels are saturated: their brightness is a guess"
    grade = fair_if(fit.cut <= RULES.cut_most)
    return Reason("saturated", grade, f"{text} (use a shorter exposure)")


def _missing(fit: Facts) -> Reason | None:
    """The cells that are there may be good; all that was asked for is not."""
    if not fit.missing:
        return None
    have = "has" if len(fit.missing) == 1 else "have"
    text = f"{listed('point', fit.missing)} {have} no cell"
    return Reason("missing", "fair", f"{text}: give a radius, or move it inside the cell")


def _compressed(fit: Facts) -> Reason | None:
    if not fit.compressed:
        return None
    text = "the intensities look log-scaled, which shifts every surface"
    return Reason("compressed", "fair", f"{text} (use the image as the camera took it)")


def _shifted(fit: Facts) -> Reason | None:
    much = fit.slices.shift
    if not much > RULES.shifted:
        return None
    text = f"slices are shifted against each other by about {much:.1g} voxels"
    return Reason("shifted", "fair", f"{text}, and the surfaces follow them (register the stack)")


def _flicker(fit: Facts) -> Reason | None:
    much = fit.slices.brightness
    if not much > RULES.flicker:
        return None
    text = f"the brightness of slices varies by {much:.0%}, which surfaces make up for"
    return Reason("flicker", "fair", text)


def _dome(fit: Facts) -> Reason | None:
    if not fit.dome > RULES.dome:
        return None
    text = f"a haze up to {fit.dome:.0%} as bright as the surfaces is only roughly modelled"
    return Reason("dome", "fair", f"{text}, which moves them")


def _sharpened(fit: Facts) -> Reason | None:
    if not fit.sharpened:
        return None
    text = "the image looks deconvolved or smoothed, so bright rims may be artefacts"
    return Reason("sharpened", "fair", f"{text} (use the image as the camera took it)")


def _followed(fit: Facts) -> Reason | None:
    if fit.followed is None or not fit.followed < RULES.followed:
        return None
    text = "the seeds did not match the image, and the surfaces hardly do: are they of the same"
    return Reason("followed", "poor", f"{text} channel, time and voxel size?")


def _single(fit: Facts) -> Reason | None:
    return Reason("single", "poor", SINGLE) if fit.single else None


def _doubted(fit: Facts) -> Reason | None:
    """A wrong voxel size is no misfit: shapes of another scale explain the image as well."""
    return Reason("doubted", "fair", "; ".join(fit.doubts)) if fit.doubts else None


def _coarse(fit: Facts) -> Reason | None:
    if not fit.accuracy > RULES.accuracy:
        return None
    text = f"images are rendered with an error of {fit.accuracy:.0%}, too coarse to judge by"
    return Reason("coarse", "fair", f"{text} (--accuracy)")


def _unsure(fit: Facts) -> Reason | None:
    if not fit.unsure:
        return None
    text = "membranes may be fluorescent, and the surfaces then lie further in"
    return Reason("unsure", "fair", f"{text} (try --structure both)")


def _alone(fit: Facts) -> Reason | None:
    if not fit.alone:
        return None
    text = "insides alone may explain as much, with surfaces further out, as cytoplasm around dark"
    return Reason("alone", "fair", f"{text} nuclei would (try --structure interior)")


def _nuclei(fit: Facts) -> Reason | None:
    if not fit.nuclei:
        return None
    text = "a dim middle was taken for a dark nucleus: a thick membrane would lie further in"
    return Reason("nuclei", "fair", f"{text} (try --structure membrane)")


def _lit(fit: Facts) -> Reason | None:
    if not fit.lit:
        return None
    text = "light around the cells was subtracted as a local background, a rough estimate"
    return Reason("lit", "fair", f"{text}: check the contours")


def _leans(fit: Facts) -> Reason | None:
    """Two such stacks of insides with membranes ended as insides, 0.6 and 1.4 voxels off."""
    if not fit.leans:
        return None
    text = "a tilted PSF's tails look like light of membranes: say which parts of the cells are"
    return Reason("leans", "fair", f"{text} labelled (--structure)")


def _blurred_deep(fit: Facts) -> Reason | None:
    """In a widefield stack, a membrane was taken for a ring of insides: 98 % explained, 1.3 off."""
    if not fit.blurred_deep:
        return None
    text = "in widefield, interiors look like membranes further in: say which are labelled"
    return Reason("blurred_deep", "fair", f"{text} (--structure)")


# Of these, cells tell themselves how well they are explained and how far they may still move; and
# dim cells are not saturated.
FIT_CHECKS: tuple[FitCheck, ...] = (_unfinished, _explained, _saturated, _missing)
# Doubts about what all cells share: the PSF, the image, the model, and what is labelled. If one is
# right, each surface may lie too far in or out.
SHARED_CHECKS: tuple[FitCheck, ...] = (
    _nothing,
    _single,
    _widths,
    _cone,
    _narrow,
    _compressed,
    _shifted,
    _flicker,
    _dome,
    _sharpened,
    _followed,
    _doubted,
    _coarse,
    _unsure,
    _alone,
    _nuclei,
    _lit,
    _leans,
    _blurred_deep,
)
