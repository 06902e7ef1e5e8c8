"""Good, fair or poor: how far the shapes that a fit found can be trusted.

Convergence only means that the iterations came to an end; it says nothing about the shape. `judged`
is a pure function of a few facts, above all the predicted error of the shape. Each check looks at
one of them (:mod:`.fit_checks`, :mod:`.cell_checks`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from statistics import median_high
from typing import Any

from ..common.words import joined
from ..geometry.judgement import Judgement
from .cell_checks import CELL_CHECKS
from .facts import CellFacts, Facts
from .fit_checks import FIT_CHECKS, SHARED_CHECKS
from .predicted_error import PredictedError
from .reason import GRADES, Grade, Reason, texts, worst
from .verdict_rules import RULES

_MANY = "too many doubts at once to trust its shape"


@dataclass(frozen=True)
class CellVerdict:
    """The grade of one cell, why it is not better, and the predicted error of its shape, um."""

    region: int
    grade: Grade
    reasons: tuple[Reason, ...] = ()
    shape_error_um: float | None = None


@dataclass(frozen=True)
class Verdict:
    """The grades of a fit and of each cell, why they are not better, and the predicted error.

    Reasons of the kind "cells" name cells, which have their own reasons.
    """

    grade: Grade
    reasons: tuple[Reason, ...]
    cells: tuple[CellVerdict, ...]
    error: PredictedError = field(default_factory=PredictedError)

    def as_plain(self) -> dict[str, Any]:
        """The verdict as plain values, for JSON."""
        whole = self.error.whole
        return {
            "grade": self.grade,
            "reasons": texts(self.reasons),
            "cells": [{**asdict(cell), "reasons": texts(cell.reasons)} for cell in self.cells],
            "error": {
                "whole_um": None if whole is None else {**asdict(whole), "total": whole.total},
                "lacks": self.error.lacks,
                "unknown": self.error.unknown,
                "cone": self.error.cone,
            },
        }

    def by_region(self) -> dict[int, Judgement]:
        """Grade, predicted error and reasons of each cell by its region, for tables."""
        return {
            cell.region: Judgement(cell.grade, cell.shape_error_um, "; ".join(texts(cell.reasons)))
            for cell in self.cells
        }

    @property
    def usual_error_um(self) -> float | None:
        """Median predicted error of the cells, um; that of all surfaces if no cell has one.

        A single cell that went wrong would dominate the error of all surfaces.
        """
        of_cells = [c.shape_error_um for c in self.cells if c.shape_error_um is not None]
        if of_cells:
            return median_high(of_cells)
        return None if self.error.whole is None else self.error.whole.total

    def sentence(self) -> str:
        """The grade, the predicted error, and the reasons, in words for a user."""
        off = self.usual_error_um
        about = "" if off is None else f", off by about {1000 * off:.0f} nm"
        return f"{self.grade}{about}" + (
            f": {'; '.join(texts(self.reasons))}" if self.reasons else ""
        )


def judged(facts: Facts) -> Verdict:
    """The verdict that follows from facts.

    The worse grade counts once at least half of the cells have it, so that one bad cell of many
    does not spoil the rest; with more poor cells than a few, the whole is fair at best. Reasons
    that concern the whole fit lower it, too. Doubts about what all cells share, such as the PSF or
    what is labelled, are doubts about each cell as well.
    """
    doubts = [found for check in SHARED_CHECKS if (found := check(facts))]
    reasons = [*(found for check in FIT_CHECKS if (found := check(facts))), *doubts]
    cells = [_of_cell(cell, facts, len(reasons)) for cell in facts.cells]
    grade = worst(reason.grade for reason in reasons)
    for word in GRADES[1:]:
        bad = [cell for cell in cells if cell.grade == word]
        if not bad:
            continue
        if 2 * sum(GRADES.index(c.grade) >= GRADES.index(word) for c in cells) >= len(cells):
            grade = worst((grade, word))
        elif word == "poor" and len(bad) > RULES.astray * len(cells):
            grade = worst((grade, "fair"))
        if len(cells) == 1:
            reasons += [r for r in cells[0].reasons if r.text not in texts(reasons)]
        else:
            alike = GRADES.index(worst(doubt.grade for doubt in doubts)) >= GRADES.index(word)
            are = "are" if len(bad) > 1 else "is"
            said = f"would be {word} even without that" if alike else f"{are} {word}"
            text = f"{_named(bad)} {said} ({_usual_reason(bad)})"
            reasons.append(Reason("cells", word, text))
    doubted = tuple(_because(cell, doubts) for cell in cells)
    return Verdict(grade, tuple(reasons), doubted, facts.error)


def _of_cell(cell: CellFacts, facts: Facts, others: int) -> CellVerdict:
    """The verdict on one cell; others : number of reasons that concern the whole fit."""
    found = [reason for check in CELL_CHECKS if (reason := check(cell, facts))]
    if len(found) + others >= RULES.doubts:
        found.append(Reason("doubts", "poor", _MANY))
    predicted = facts.error.cells.get(cell.region)
    error = None if predicted is None else predicted.total
    return _because(CellVerdict(cell.region, "good", (), error), found)


def _because(cell: CellVerdict, more: Sequence[Reason]) -> CellVerdict:
    """A cell with more reasons, of which what weighs most comes first."""
    reasons = sorted((*cell.reasons, *more), key=lambda one: -GRADES.index(one.grade))
    return replace(cell, grade=worst(one.grade for one in reasons), reasons=tuple(reasons))


def _usual_reason(cells: Sequence[CellVerdict]) -> str:
    """The most frequent main reason, apart from numbers, in the words of its first cell."""
    alike: dict[str, list[CellVerdict]] = {}
    for cell in cells:
        alike.setdefault(re.sub(r"[\d.]+", "", cell.reasons[0].text), []).append(cell)
    first = max(alike.values(), key=len)[0]
    text = first.reasons[0].text
    if len(cells) == 1:
        return text
    often = "" if len(alike) == 1 else "mostly "
    return f"{often}as with cell {first.region}: {text}"


def _named(cells: Sequence[CellVerdict]) -> str:
    regions = [str(cell.region) for cell in cells]
    shown = joined([*regions[:12], "more"] if len(regions) > 12 else regions)
    return f"cell{'s' * (len(regions) > 1)} {shown}"
