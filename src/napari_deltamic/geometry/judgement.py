"""How good the shape of one cell is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Judgement:
    """The verdict on one fitted cell.

    Attributes
    ----------
    grade
        good, fair or poor.
    shape_error_um
        Predicted error of its surface; None where it is not known.
    reasons
        Why the grade is not better, joined into one text; empty if nothing is wrong.
    """

    grade: str
    shape_error_um: float | None = None
    reasons: str = ""
