"""No effect is called by its name outside its own file and the registry.

What an effect is, it says itself (``scene/effects/``); a name elsewhere is a rule that a new effect
would have to be written into.
"""

import re
from pathlib import Path

import napari_deltamic
from napari_deltamic.scene.effects import KINDS

PACKAGE = Path(napari_deltamic.__file__).parent
OWN = ("scene/effects/", "common/choices.py", "gui/")  # the effects, their registry, the window
NAMES = "|".join(KINDS)
BY_NAME = re.compile(
    rf"effects\.({NAMES})\b"
    rf"|\.(replace|of|without)\([^)]*\b({NAMES})\b"
    rf"|effect\.name [!=]= [\"']({NAMES})[\"']"
)


def test_no_file_calls_an_effect_by_its_name():
    found = sorted(
        place
        for path in PACKAGE.rglob("*.py")
        if not (place := path.relative_to(PACKAGE).as_posix()).startswith(OWN)
        and BY_NAME.search(path.read_text(encoding="utf-8"))
    )
    assert found == []


def test_the_search_finds_names():
    for text in ("scene.effects.halo", 'x.without("halo")', 'if effect.name == "halo":'):
        assert BY_NAME.search(text)
