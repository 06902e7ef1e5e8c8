"""Rules that decide in a fit are kept with its result."""

import importlib
import json
from collections import Counter
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest

import napari_deltamic
from napari_deltamic.fitting.objective.schedule import Schedule
from napari_deltamic.results.rules_of_a_fit import rules_of_a_fit

PACKAGE = Path(napari_deltamic.__file__).parent


ROOMS = ("images", "geometry/labels", "optics", "fitting", "evidence")


def rules():
    """Every class of rules of the rooms in which a fit is decided."""
    for file in sorted(p for room in ROOMS for p in (PACKAGE / room).rglob("*.py")):
        if "Rules:" in file.read_text(encoding="utf-8"):
            place = ".".join(file.relative_to(PACKAGE).with_suffix("").parts)
            module = importlib.import_module(f"napari_deltamic.{place}")
            for name, kind in vars(module).items():
                if name.endswith("Rules") and kind.__module__ == module.__name__:
                    yield pytest.param(kind, id=f"{file.stem}.{name}")


@pytest.mark.parametrize("kind", list(rules()))
def test_rules_say_what_each_number_is_and_nobody_changes_them(kind):
    assert is_dataclass(kind)
    assert kind.__dataclass_params__.frozen
    assert [f.name for f in fields(kind) if f.name not in kind.__doc__] == []


def test_those_of_every_step_of_a_fit_are_kept_each_under_a_name_of_its_own():
    kept, kinds = rules_of_a_fit(), [p.values[0] for p in rules()]
    assert len(kinds) >= 60
    expected = [frozenset(f.name for f in fields(kind)) for kind in [*kinds, Schedule]]
    assert Counter(frozenset(one) for one in kept.values()) == Counter(expected)
    assert json.loads(json.dumps(kept)).keys() == kept.keys()


def test_their_names_stay():
    """Reports of other versions have them."""
    some = {"cells", "first PSF", "voxels that count", "schedule", "slices", "camera", "verdict"}
    assert some <= rules_of_a_fit().keys()
    assert "largest_shift" not in rules_of_a_fit()["slices"], "those of a fit, not of its image"
