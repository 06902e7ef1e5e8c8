"""Why a fit or a cell is not better graded: a grade, and the reason for it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Grade = Literal["good", "fair", "poor"]
GRADES: tuple[Grade, ...] = ("good", "fair", "poor")


@dataclass(frozen=True)
class Reason:
    """Why something is not better graded.

    kind : what it is about, in a word; code goes by this, never by the text.
    grade : the best grade that it allows.
    text : the reason for users.
    """

    kind: str
    grade: Grade
    text: str


def texts(reasons: Iterable[Reason]) -> tuple[str, ...]:
    """The texts of reasons."""
    return tuple(reason.text for reason in reasons)


def worst(grades: Iterable[Grade]) -> Grade:
    """The worst of some grades; good if there are none."""
    return max(grades, key=GRADES.index, default="good")


def fair_if(enough: bool) -> Grade:
    """The grade if something is not as it should be: fair if it is enough, else poor."""
    return "fair" if enough else "poor"


def unexplained(share: float | None, least: float, enough: float, where: str) -> Reason | None:
    """A reason if less than ``least`` of the signal is explained; poor if less than ``enough``."""
    if share is None or not share < least:
        return None
    # "None" if it is not a share: a model can fit worse than no model. Less than this is rounded to
    # 0 %, by definition.
    much = f"{share:.0%}" if share >= 0.005 else "none"
    text = f"{much} of the signal around {where} is explained"
    return Reason("explained", fair_if(share >= enough), text)
