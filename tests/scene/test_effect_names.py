"""Where an effect is called by its name: a list that may only grow shorter.

What an effect is, it says itself (``scene/effects/``); a name elsewhere is a rule that a new effect
would have to be written into.
"""

import re
from pathlib import Path

import napari_deltamic
from napari_deltamic.scene.effects import KINDS

PACKAGE = Path(napari_deltamic.__file__).parent
OWN = ("scene/effects/", "common/choices.py", "gui/")  # the effects, their registry, the window
STILL = {
    "cli/second_view_input.py",
    "evidence/recommend.py",
    "evidence/surface.py",
    "evidence/transforms.py",
    "fitting/errors_of_measures.py",
    "fitting/fit.py",
    "fitting/imaging.py",
    "fitting/level.py",
    "fitting/local_misfit.py",
    "fitting/run.py",
    "fitting/second_view.py",
    "results/session_result.py",
    "runs/track_run.py",
    "scene/formation.py",
    "scene/simulate.py",
    "scene/structures.py",
}


def test_no_further_file_calls_an_effect_by_its_name():
    names = "|".join(KINDS)
    by_name = re.compile(
        rf"effects\.({names})\b"
        rf"|\.(replace|of|without)\([^)]*\b({names})\b"
        rf"|effect\.name [!=]= [\"']({names})[\"']"
    )
    found = {
        place
        for path in PACKAGE.rglob("*.py")
        if not (place := path.relative_to(PACKAGE).as_posix()).startswith(OWN)
        and by_name.search(path.read_text(encoding="utf-8"))
    }
    assert sorted(found - STILL) == []
    assert len(found) > 5, "the search finds nothing"
