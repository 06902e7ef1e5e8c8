"""Why a fit or a cell is no better than it is: a grade, and a reason for it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Grade = Literal["good", "fair", "poor"]
GRADES: tuple[Grade, ...] = ("good", "fair", "poor")


@dataclass(frozen=True)
class Reason:
    """Why something is no better.

    kind : what it is about, in a word; what is shown where is decided by it, never by the text.
    grade : the best that it leaves.
    text : for users.
    """

    kind: str
    grade: Grade
    text: str


def texts(reasons: Iterable[Reason]) -> tuple[str, ...]:
    """What they say."""
    return tuple(reason.text for reason in reasons)


def worst(grades: Iterable[Grade]) -> Grade:
    """The worst of them; good where there are none."""
    return max(grades, key=GRADES.index, default="good")


def fair_if(enough: bool) -> Grade:
    """What is left of a grade where something is not as it should be, but may be enough."""
    return "fair" if enough else "poor"


def unexplained(share: float | None, least: float, enough: float, where: str) -> Reason | None:
    """Where less than ``least`` of the signal is explained; less than ``enough`` is poor."""
    if share is None or not share < least:
        return None
    # In words where it is no share: a model may be further from the image than none. Less than
    # this is rounded to 0 %, by definition.
    much = f"{share:.0%}" if share >= 0.005 else "none"
    text = f"{much} of the signal around {where} is explained"
    return Reason("explained", fair_if(share >= enough), text)
