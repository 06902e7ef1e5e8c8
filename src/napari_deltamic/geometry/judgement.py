"""How good the shape of one cell is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Judgement:
    """Of one fitted cell.

    Attributes
    ----------
    grade
        good, fair or poor.
    shape_error_um
        What its surface is thought to be off by; None where that is not known.
    reasons
        Why it is no better, joined; empty if there are none.
    """

    grade: str
    shape_error_um: float | None = None
    reasons: str = ""
