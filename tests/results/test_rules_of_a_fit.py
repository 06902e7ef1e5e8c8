"""Rules that decide in a fit are kept with its result."""

import importlib
import json
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest

import napari_deltamic
from napari_deltamic.results.rules_of_a_fit import RULES_OF_A_FIT

PACKAGE = Path(napari_deltamic.__file__).parent


def rules():
    """Every class of rules of the rooms in which a fit is decided."""
    for file in sorted(
        p for room in ("fitting", "evidence") for p in (PACKAGE / room).glob("*.py")
    ):
        if "Rules:" in file.read_text(encoding="utf-8"):
            module = importlib.import_module(f"napari_deltamic.{file.parent.name}.{file.stem}")
            for name, kind in vars(module).items():
                if name.endswith("Rules") and kind.__module__ == module.__name__:
                    yield pytest.param(kind, id=name)


@pytest.mark.parametrize("kind", list(rules()))
def test_rules_say_what_each_number_is_and_nobody_changes_them(kind):
    assert is_dataclass(kind)
    assert kind.__dataclass_params__.frozen
    assert [f.name for f in fields(kind) if f.name not in kind.__doc__] == []


def test_those_of_every_step_of_a_fit_are_kept():
    names = {frozenset(kept) for kept in RULES_OF_A_FIT.values()}
    steps = [p.values[0] for p in rules() if "fitting" in p.values[0].__module__]
    assert len(steps) >= 15
    assert all(frozenset(f.name for f in fields(kind)) in names for kind in steps)
    assert json.loads(json.dumps(RULES_OF_A_FIT)).keys() == RULES_OF_A_FIT.keys()
