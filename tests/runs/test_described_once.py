"""Every setting is described once, and is found in every place where a user may meet it."""

from pathlib import Path
from typing import get_args

import pytest
import yaml
from benchmarks.settings_page import SECTIONS, reference_page

import napari_deltamic
from napari_deltamic.cli import build_parser
from napari_deltamic.common.description import described
from napari_deltamic.runs.command import command, flags_of
from napari_deltamic.runs.optics_settings import GaussianOptics, MeasuredOptics, MicroscopeOptics
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings
from napari_deltamic.runs.track_run import TrackRun
from napari_deltamic.runs.track_settings import TrackSettings

PACKAGE = Path(napari_deltamic.__file__).parent
PAGE = Path(__file__).parents[2] / "docs" / "settings.md"
MODELS = (RunSettings, SceneSettings, FitSettings, MicroscopeOptics, MeasuredOptics, TrackSettings)
# Parts that hold settings, and what only a file can say.
NOT_SAID = {"scene", "fit", "track", "kind", "zernike", "fitted"}
FIELDS = [(model, name) for model in MODELS for name in described(model)]
OTHER = {"whole": 7, "number": 0.5, "triple": (1.0, 2.0, 3.0), "numbers": (3.5, 1.0)}


def parser_of(name):
    commands = next(a for a in build_parser()._actions if a.dest not in ("help", "version"))
    return commands.choices[name]


def another(found):
    """A value that is not the default."""
    if found.kind == "switch":
        return not found.default
    if found.kind == "choice":
        return next(name for name in found.choices if name != found.default)
    if found.kind == "text":
        return found.choices[0] if found.choices else "a file.tif"
    return OTHER[found.kind]


@pytest.mark.parametrize("model", [*MODELS, TrackRun])
def test_every_field_says_what_there_is_to_say(model):
    assert set(model.model_fields) - NOT_SAID == set(described(model))
    for found in described(model).values():
        assert found.title
        assert not found.title.endswith(".")
        assert len(found.title) <= 32
        assert found.tip
        assert not found.tip.endswith(".")


def test_what_is_said_is_said_with_it():
    """Kinds, bounds and choices follow from the fields."""
    found = described(FitSettings)
    assert found["density"].choices == ("uniform", "interface", "smooth")
    assert found["accuracy"].optional
    assert (found["accuracy"].low, found["accuracy"].high) == (0, 1)
    assert found["levels"].kind == "numbers"
    assert described(SceneSettings)["sigma"].kind == "triple"
    assert described(TrackSettings)["stop"].kind == "whole"
    assert described(GaussianOptics) == {}


@pytest.mark.parametrize(("model", "name"), FIELDS)
def test_the_command_line_has_it(model, name):
    found = described(model)[name]
    parser = parser_of("track" if model is TrackSettings else "fit")
    flags = {flag: action for action in parser._actions for flag in action.option_strings}
    if not found.flag:
        assert name in ("image", "origin", "first", "stop")  # an argument, and --frames
        return
    action = flags[found.flag]
    assert found.kind == "part" or found.tip.replace("%", "%%") in action.help
    if found.kind == "switch":
        assert f"--no-{found.flag[2:]}" in flags
    if found.kind == "choice":
        assert tuple(action.choices) == found.choices


@pytest.mark.parametrize(("model", "name"), FIELDS)
def test_the_command_that_repeats_a_run_gives_it(model, name):
    found = described(model)[name]
    if not found.flag or found.kind == "part":
        return
    base = {"na": 1.2, "wavelength": 0.5} if model is MicroscopeOptics else {}
    base |= {"file": "bead.tif"} if model is MeasuredOptics else {}
    base |= {"voxel_size": (1.0, 1.0, 1.0)} if model is SceneSettings else {}
    if model is RunSettings:
        base = {"image": "i.tif", "seeds": "s.ply", "scene": SceneSettings(voxel_size=(1, 1, 1))}
    value = another(found)
    words = flags_of(model(**{**base, name: value}))
    parser = parser_of("track" if model is TrackSettings else "fit")
    action = next(a for a in parser._actions if found.flag in a.option_strings)
    parsed = parser.parse_args([*words, "-o", "out"])
    got = getattr(parsed, action.dest)
    assert (tuple(got) if isinstance(got, list) else got) == value


def test_a_command_gives_all_of_a_run():
    fit = {name: another(found) for name, found in described(FitSettings).items()}
    scene = SceneSettings(voxel_size=(0.3, 0.2, 0.1), effects=("halo",))
    run = RunSettings(image="a b.tif", seeds="s.csv", scene=scene, fit=FitSettings(**fit))
    text = command(run, "out", missing=True)
    for name, found in described(FitSettings).items():
        assert found.flag in text or f"--no-{found.flag[2:]}" in text, name
    assert "--effects halo" in text
    assert "'a b.tif'" in text
    assert "--missing-nan" in text


def test_a_run_without_wishes_has_a_short_command():
    run = RunSettings(image="a.tif", seeds="s.csv", scene=SceneSettings(voxel_size=(1, 1, 1)))
    words = "napari-deltamic fit a.tif --seeds s.csv --voxel-size 1 1 1 -o out"
    assert command(run, "out") == words


def test_the_page_is_that_of_the_settings():
    """``python -m benchmarks.settings_page docs/settings.md`` makes it anew."""
    assert PAGE.read_text(encoding="utf-8") == reference_page()


def test_the_page_has_every_field():
    rows = PAGE.read_text(encoding="utf-8").split("\n")
    assert sum(line.startswith("| `") for line in rows) == sum(
        len(described(model)) for _, _, model in SECTIONS
    )
    assert len(SECTIONS) == len(MODELS)


def test_preferences_say_the_same():
    """The manifest cannot be made by a program that napari has not asked yet, so it is compared."""
    pages = yaml.safe_load((PACKAGE / "napari.yaml").read_text(encoding="utf-8"))
    shown = {
        name: item
        for page in pages["contributions"]["configurations"].values()
        for name, item in page["properties"].items()
    }
    for model in (FitSettings, MicroscopeOptics):
        for name in sorted({*shown} & {*described(model)} - {"accuracy"}):
            found = described(model)[name]
            title, item = found.label, shown[name]
            assert item["title"] == f"{title[0].upper()}{title[1:]}"
            assert item["description"] == found.sentence
            if found.kind == "choice":
                assert (
                    tuple(item["enum"])
                    == found.choices
                    == get_args(model.model_fields[name].annotation)
                )
