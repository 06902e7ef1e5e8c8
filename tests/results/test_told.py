"""How good a fit is, in words: which cells are not good, and where the reasons are."""

from types import SimpleNamespace

import pytest

from napari_deltamic.evidence.reason import Reason
from napari_deltamic.evidence.verdict import CellVerdict, Verdict
from napari_deltamic.results.judged import told


def judged(grades, reasons):
    """What is known of a fit whose cells have these grades; reasons: texts by kind."""
    cells = tuple(CellVerdict(k, grade) for k, grade in enumerate(grades, 1))
    verdict = Verdict("fair", tuple(Reason(k, "fair", text) for k, text in reasons.items()), cells)
    return SimpleNamespace(verdict=verdict, found=SimpleNamespace(explained=0.9))


@pytest.mark.parametrize(
    ("grades", "reasons", "said"),
    [
        (["good"] * 3, {}, "."),
        (
            ["fair", "good"],
            {"explained": "90% is explained", "cells": "cell 1 is fair (uneven)"},
            ". Cell 1 is fair: choose one in the table to see why.",
        ),
        (
            ["fair"] * 8 + ["poor", "poor", "good"],
            {"cells": "some are poor", "cone": "cell 1 is explained: the PSF is not"},
            ". Cell 1 is explained: the PSF is not."
            " 8 of 11 cells are fair, cells 9 and 10 are poor: choose one in the table to see why.",
        ),
        (
            ["poor"] * 2,
            {"cells": "both are"},
            ". Both cells are poor: choose one in the table to see why.",
        ),
    ],
)
def test_cells_that_are_not_good_are_named_or_counted(grades, reasons, said):
    """What else is told does not depend on the words of a reason."""
    text = "Fair: the cells explain 90% of the signal around them"
    assert told(judged(grades, reasons)) == text + said


def test_a_question_has_no_full_stop():
    reasons = {"fold": "it is thick: are these two cells?", "shifted": "slices are shifted"}
    said = told(judged(["fair"], reasons))
    assert said.endswith("them. It is thick: are these two cells? Slices are shifted.")


def test_of_a_fit_that_was_stopped_that_is_told_first():
    reasons = {"unfinished": "the fit has not converged", "cells": "cell 2 is poor"}
    known = judged(["good", "poor"], reasons)
    assert told(known).endswith(
        " The fit has not converged. Cell 2 is poor: choose one in the table to see why."
    )
    said = told(known, stopped=True)
    assert said.startswith("Stopped before it converged, so fair: the cells explain 90%")
    assert said.endswith("around them. Continue it.")
    known.found.explained = 0.4
    assert told(known, stopped=True).endswith("Continue it, or start from better cells.")
