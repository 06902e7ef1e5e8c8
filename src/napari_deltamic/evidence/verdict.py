"""Good, fair or poor: what is to be thought of the shapes that a fit found.

That a fit has converged says that its iterations ended, nothing of the shape. `judged` is a pure
function of a few facts, the predicted error of the shape first among them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from statistics import median, median_high
from typing import Any, Literal

from ..fitting.deep_insides import RULES as DEEP
from ..geometry.judgement import Judgement
from .facts import CellFacts, Facts
from .predicted_error import PredictedError, ShapeDeviation
from .sanity import oblong_told
from .verdict_rules import RULES

Grade = Literal["good", "fair", "poor"]
GRADES: tuple[Grade, ...] = ("good", "fair", "poor")
_PARTS = {
    "noise": "the noise",
    "settling": "too few iterations",
    "prior": "the prior on its shape",
    "triangles": "triangles that are too large",
    "alternative": "what the model lacks ({lacks})",
}


@dataclass(frozen=True)
class CellVerdict:
    """A grade of one cell, why it is no better, and the predicted error of its shape, um."""

    region: int
    grade: Grade
    reasons: tuple[str, ...] = ()
    shape_error_um: float | None = None


@dataclass(frozen=True)
class Verdict:
    """A grade of a fit and of each cell, why they are no better, and the predicted error."""

    grade: Grade
    reasons: tuple[str, ...]
    cells: tuple[CellVerdict, ...]
    error: PredictedError = field(default_factory=PredictedError)

    def as_plain(self) -> dict[str, Any]:
        """For JSON."""
        found = asdict(self)
        whole = self.error.whole
        found["error"] = {
            "whole_um": None if whole is None else {**asdict(whole), "total": whole.total},
            "lacks": self.error.lacks,
            "unknown": self.error.unknown,
            "cone": self.error.cone,
        }
        return found

    def by_region(self) -> dict[int, Judgement]:
        """For tables: grade, predicted error and reasons of each cell."""
        return {
            cell.region: Judgement(cell.grade, cell.shape_error_um, "; ".join(cell.reasons))
            for cell in self.cells
        }

    @property
    def usual_error_um(self) -> float | None:
        """That of the cell in the middle, as the grade is; of all surfaces where no cell has one.

        One cell that went wrong would have most of what is predicted of all surfaces.
        """
        of_cells = [c.shape_error_um for c in self.cells if c.shape_error_um is not None]
        if of_cells:
            return median_high(of_cells)
        return None if self.error.whole is None else self.error.whole.total

    def sentence(self) -> str:
        """For a user: the grade, the predicted error, and why."""
        off = self.usual_error_um
        about = "" if off is None else f", off by about {1000 * off:.0f} nm"
        return f"{self.grade}{about}" + (f": {'; '.join(self.reasons)}" if self.reasons else "")


def judged(facts: Facts) -> Verdict:
    """The grade: that of most cells, lowered by what concerns all; one bad cell spoils no other.

    Where half of them are worse, the worse one. Doubts of what shines are doubts of each cell, too.
    """
    doubts = _of_structure(facts)
    whole = [*_of_whole(facts), *doubts]
    usual = _usual_growth(facts.cells)
    cells = tuple(_of_cell(cell, usual, facts) for cell in facts.cells)
    grade = _worst(grade for grade, _ in whole)
    reasons = [text for _, text in whole]
    for word in GRADES[1:]:
        bad = [cell.region for cell in cells if cell.grade == word]
        if not bad:
            continue
        if 2 * sum(GRADES.index(c.grade) >= GRADES.index(word) for c in cells) >= len(cells):
            grade = _worst((grade, word))
        if len(cells) == 1:
            reasons += [text for text in cells[0].reasons if text not in reasons]
        else:
            why = _usual_reason([cell for cell in cells if cell.grade == word])
            reasons.append(f"{_cells(bad)} {'are' if len(bad) > 1 else 'is'} {word} ({why})")
    doubted = tuple(_doubted(cell, doubts) for cell in cells)
    return Verdict(grade, tuple(reasons), doubted, facts.error)


def names_cells(reason: str) -> bool:
    """Whether a reason is the list of cells of a grade; earlier versions began it with that."""
    return re.match(r"(fair: |poor: )?cells? \d", reason) is not None


def _of_whole(facts: Facts) -> list[tuple[Grade, str]]:
    found: list[tuple[Grade, str]] = []
    if facts.by_hand:
        found.append(("poor", "it was changed by hand: continue the fit"))
    elif not facts.finished:
        found.append(("poor", "the fit has not converged: continue it, or start from better seeds"))
    if facts.explained is None:
        found.append(("poor", "nothing around the surfaces is brighter or darker than noise"))
    elif facts.explained < RULES.good:
        word: Grade = "fair" if facts.explained >= RULES.fair else "poor"
        found.append(
            (word, f"{_share(facts.explained)} of the signal around the surfaces is explained")
        )
    found += _of_widths(facts.widths)
    if facts.error.cone:
        text = "the image shows the light cone of an objective, which a Gaussian PSF lacks"
        found.append(("fair", f"{text}: describe it (--modality, --na, --wavelength)"))
    if facts.narrow:
        text = "the fitted PSF is too narrow for the voxels"
        found.append(("fair", f"{text}: it stands in for something else, such as texture or haze"))
    if facts.cut > RULES.cut:
        text = f"{facts.cut:.0%} of the bright voxels are saturated: their brightness is a guess"
        grade: Grade = "poor" if facts.cut > RULES.cut_most else "fair"
        found.append((grade, f"{text} (use a shorter exposure)"))
    if facts.compressed:
        text = "the intensities look log-scaled, which shifts every surface"
        found.append(("fair", f"{text} (use the image as the camera took it)"))
    if facts.slices.shift > RULES.shifted:
        text = f"slices are shifted against each other by about {facts.slices.shift:.1g} voxels"
        found.append(("fair", f"{text}, and the surfaces follow them (register the stack)"))
    if facts.slices.brightness > RULES.flicker:
        text = f"the brightness of slices varies by {facts.slices.brightness:.0%}"
        found.append(("fair", f"{text}, which surfaces make up for"))
    if facts.dome > RULES.dome:
        text = f"a haze up to {facts.dome:.0%} as bright as the surfaces is only roughly modelled"
        found.append(("fair", f"{text}, which moves them"))
    if facts.sharpened:
        text = "the image looks deconvolved or smoothed, so bright rims may be artefacts"
        found.append(("fair", f"{text} (use the image as the camera took it)"))
    if facts.followed is not None and facts.followed < RULES.followed:
        text = "the seeds did not match the image, and the surfaces hardly do"
        found.append(("poor", f"{text}: are they of the same channel, time and voxel size?"))
    if facts.oblong is not None:
        found.append(("fair", oblong_told(facts.oblong)))
    if facts.accuracy > RULES.accuracy:
        text = f"images are rendered with an error of {facts.accuracy:.0%}, too coarse to judge by"
        found.append(("fair", f"{text} (--accuracy)"))
    return found


def _of_structure(facts: Facts) -> list[tuple[Grade, str]]:
    """Of what shines: if that is wrong, all surfaces lie further in or out."""
    found: list[tuple[Grade, str]] = []
    if facts.unsure:
        text = "membranes may be fluorescent as well, and the surfaces then lie further in"
        found.append(("fair", f"{text} (try --structure both)"))
    if facts.alone:
        text = "insides alone may explain as much, with surfaces further out"
        text += ", as cytoplasm around dark nuclei would"
        found.append(("fair", f"{text} (try --structure interior)"))
    if facts.nuclei:
        text = "a dim middle was taken for a dark nucleus: a thick membrane would lie further in"
        found.append(("fair", f"{text} (try --structure membrane)"))
    return found


def _doubted(cell: CellVerdict, doubts: Sequence[tuple[Grade, str]]) -> CellVerdict:
    grade = _worst((cell.grade, *(word for word, _ in doubts)))
    return replace(cell, grade=grade, reasons=(*cell.reasons, *(text for _, text in doubts)))


def _of_widths(widths: Mapping[str, float]) -> list[tuple[Grade, str]]:
    """Of the blur that the image tells beside that of the PSF."""
    if widths.get("across", 1.0) > RULES.widths[1]:
        text = (
            f"the image is {widths['across']:.2g} times as blurred as the PSF implies: a thick "
            "layer, light inside, or too narrow a PSF (--structure auto, --fit-psf)"
        )
        return [("fair", text)]
    least = {"across": RULES.widths[0], "along Z": RULES.along}
    sharper = {axis: 1 / width for axis, width in widths.items() if width < least[axis]}
    if not sharper:
        return []
    planes = {"across": "in XY", "along Z": "in Z"}
    told = " and ".join(f"{times:.2g} times as sharp {planes[a]}" for a, times in sharper.items())
    word: Grade = "poor" if max(sharper.values()) > 1 / RULES.far_off else "fair"
    text = f"the image is {told} as the PSF allows"
    return [(word, f"{text}: is this a thick bright layer? If not, give the PSF's width")]


def _of_cell(cell: CellFacts, usual: float, facts: Facts) -> CellVerdict:
    found: list[tuple[Grade, str]] = []
    predicted = facts.error.cells.get(cell.region)
    if cell.seen < RULES.seen:
        word: Grade = "fair" if cell.seen >= RULES.unseen else "poor"
        much = f"{1 - cell.seen:.0%} of its surface"
        found.append((word, f"the image is missing at {much}: what lies there is a guess"))
    elif cell.counted < RULES.seen:
        word = "fair" if cell.counted >= RULES.unseen else "poor"
        text = f"{1 - cell.counted:.0%} of its surface lies in light assigned to other objects"
        found.append((word, f"{text}: is its seed in the right place?"))
    if predicted is not None:
        found += _of_error(predicted, facts)
    if cell.explained is not None and cell.explained < RULES.good:
        word = "fair" if cell.explained >= RULES.fair else "poor"
        found.append((word, f"{_share(cell.explained)} of the signal around it is explained"))
    if cell.stray > RULES.stray:
        much = f"{cell.stray:.0%} of its light" if cell.stray < 1 else "more than its light"
        text = f"unexplained light beside it, {much}"
        found.append(("fair", text + ": light inside, haze or a neighbour (--effects auto)"))
    if cell.left_out is not None and cell.left_out[0] > RULES.left_out:
        share, (z, y, x) = cell.left_out
        much = f"{share:.0%} of its light" if share < 1 else "more than its light"
        text = (
            f"bright parts beside it, {much}, brightest at ({z:.1f}, {y:.1f}, {x:.1f}) um, belong"
        )
        found.append(("fair", f"{text} to no cell: are they arms of it?"))
    if cell.inside is not None and abs(cell.inside) > RULES.inside:
        where = "inside it" if cell.inside > 0 else "around it"
        text = (
            f"light {where}, {abs(cell.inside):.0%} as bright as its surface, is not in the model"
        )
        found.append(("fair", f"{text} (--structure both)"))
    if cell.medium < DEEP.shown:
        text = "the model assumes that its inside is darker than the medium, but it is not"
        found.append(("fair", text + ": is this a thick bright layer?"))
    if cell.compact is not None and cell.compact < RULES.compact:
        text = "it is much less round than its start: has it fins or arms, or has it crumpled or"
        found.append(("fair", f"{text} leaked into a neighbour?"))
    if cell.growth is not None:
        growth = cell.growth / usual
        if growth > RULES.grown:
            text = f"it has grown to {growth:.2g} times its volume: has it swallowed a neighbour?"
            found.append(("fair", text))
        elif growth < RULES.shrunk:
            found.append(("poor", f"it has shrunk to {growth:.0%} of its volume"))
    if cell.point:
        found.append(("poor", "it has shrunk to a point: give it a new seed, or leave it out"))
    if cell.small:
        text = "it is so small that membrane and interior look the same through the PSF"
        found.append(("fair", f"{text}: say which is labelled (--structure)"))
    if cell.crowded:
        text = "several points lie in it: are there several cells? Then give each a radius"
        found.append(("fair", text))
    if cell.slices < RULES.slices:
        text = f"it is only {cell.slices:.1f} slices high: its height is poorly determined"
        found.append(("fair", text))
    if cell.dent is not None:
        z, y, x = cell.dent.end
        text = f"a thin dent reaches to ({z:.1f}, {y:.1f}, {x:.1f}) um"
        text += ": is something bright there, inside the cell"
        found.append(
            ("fair", text + (", or two cells under one label?" if cell.dent.wall else "?"))
        )
    elif cell.fold is not None:
        z, y, x = cell.fold
        text = f"its surface is folded at ({z:.1f}, {y:.1f}, {x:.1f}) um: are these two cells?"
        found.append(("fair", text))
    if cell.unseen_wall is not None:
        text = f"the image hardly shows its wall with cell {cell.unseen_wall}: are they one cell?"
        found.append(("fair", text))
    if cell.outgrowth is not None:
        z, y, x = cell.outgrowth
        text = f"a thin outgrowth reaches to ({z:.1f}, {y:.1f}, {x:.1f}) um"
        found.append(("fair", f"{text}: is it part of the cell, or something bright beside it?"))
    if cell.beyond_neck is not None:
        z, y, x = cell.beyond_neck
        text = f"it has grown through a neck to ({z:.1f}, {y:.1f}, {x:.1f}) um"
        found.append(("fair", f"{text}: is there another cell? Then give it a seed"))
    if cell.uneven * cell.inside_share > RULES.uneven:
        text = f"its interior brightness varies by {cell.uneven:.0%}"
        found.append(("fair", f"{text}: the border may be off where it is dim or bright"))
    if cell.lit < RULES.lit:
        word = "fair" if cell.lit >= RULES.dark else "poor"
        found.append((word, f"only {cell.lit:.0%} of its surface is bright: the rest is a guess"))
    if cell.cut:
        found.append(("fair", "the border of the image cuts it: what lies beyond is a guess"))
    found.sort(key=lambda one: -GRADES.index(one[0]))  # what weighs most comes first
    grade, reasons = _worst(g for g, _ in found), tuple(text for _, text in found)
    error = None if predicted is None else predicted.total
    return CellVerdict(cell.region, grade, reasons, error)


def _of_error(predicted: ShapeDeviation, facts: Facts) -> list[tuple[Grade, str]]:
    off = predicted.total / facts.voxel
    if off <= RULES.error_good:
        return []
    word: Grade = "fair" if off <= RULES.error_fair else "poor"
    shares = predicted.shares()
    most = _PARTS[max(shares, key=lambda name: shares[name])].format(lacks=facts.error.lacks)
    return [(word, f"its surface is off by about {off:.2g} voxels, mostly from {most}")]


def _usual_growth(cells: Iterable[CellFacts]) -> float:
    known = [cell.growth for cell in cells if cell.growth is not None]
    # Of fewer cells the median could be one of those that are wrong.
    return max(median(known), 1e-9) if len(known) >= 4 else 1.0


def _share(explained: float) -> str:
    """In words where it is no share: a model may be further from the image than none."""
    least = 0.005  # less than that is rounded to 0 %, by definition
    return f"{explained:.0%}" if explained >= least else "none"


def _worst(grades: Iterable[Grade]) -> Grade:
    return max(grades, key=GRADES.index, default="good")


def _usual_reason(cells: list[CellVerdict]) -> str:
    """The reason that most of some cells have, numbers aside, as the first of them has it."""
    alike: dict[str, list[CellVerdict]] = {}
    for cell in cells:
        alike.setdefault(re.sub(r"[\d.]+", "", cell.reasons[0]), []).append(cell)
    first = max(alike.values(), key=len)[0]
    if len(cells) == 1:
        return first.reasons[0]
    often = "" if len(alike) == 1 else "most often "
    return f"{often}like cell {first.region}: {first.reasons[0]}"


def _cells(regions: list[int]) -> str:
    shown = ", ".join(map(str, regions[:12])) + (" and more" if len(regions) > 12 else "")
    return f"cell{'s' * (len(regions) > 1)} {shown}"
