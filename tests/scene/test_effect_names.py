"""No effect is called by its name outside its own file and the registry.

What an effect is, it says itself (``scene/effects/``); a name elsewhere is a rule that a new effect
would have to be written into.
"""

import ast
import re
from pathlib import Path

import pytest

import napari_deltamic
from napari_deltamic.scene.effects import KINDS

PACKAGE = Path(napari_deltamic.__file__).parent
OWN = ("scene/effects/", "common/choices.py")  # the effects, and their registry
# Plain words, too: of a detector's numbers, of states of a fit, of what is not there.
WORDS = {"background", "camera", "missing"}
NAMES = "|".join(KINDS)
BY_NAME = re.compile(
    rf"effects\.({NAMES})\b"
    rf"|\.(replace|of|without)\([^)]*\b({NAMES})\b"
    rf"|(effect\.name [!=]= |KINDS\[|getattr\(\w*effects, )[\"']({NAMES})[\"']"
)


def quoted(text):
    """The strings of a module that are just the name of an effect, but for plain words."""
    strings = {
        node.value
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    return strings & (set(KINDS) - WORDS)


def test_no_file_calls_an_effect_by_its_name():
    found = []
    for path in PACKAGE.rglob("*.py"):
        place, text = path.relative_to(PACKAGE).as_posix(), path.read_text(encoding="utf-8")
        if not place.startswith(OWN) and (BY_NAME.search(text) or quoted(text)):
            found.append(place)
    assert sorted(found) == []


@pytest.mark.parametrize(
    "text",
    [
        "scene.effects.halo",
        'x.without("halo")',
        "x.replace(second_view=self.second.view())",
        'if effect.name == "halo":',
        'KINDS["camera"]',
        'getattr(effects, "missing")',
    ],
)
def test_the_search_finds_names(text):
    assert BY_NAME.search(text)


def test_quoted_names_are_found():
    assert quoted('x = ("pixel_integration",) if y else {\'halo\': "missing"}') == {
        "pixel_integration",
        "halo",
    }
    assert not quoted('"as halo=0.1"')
