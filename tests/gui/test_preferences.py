"""What the user prefers is how a new widget is set; what cannot be used is named."""

import warnings
from pathlib import Path

import npe2
import pytest

import napari_deltamic
from napari_deltamic.fitting.model.default_accuracy import PRESETS, usable_choice
from napari_deltamic.gui.settings import preferences
from napari_deltamic.gui.settings.preferences import PLUGIN, Preferences, read_preferences, usable
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene.effects import Attenuation, Effects

MANIFEST = Path(napari_deltamic.__file__).with_name("napari.yaml")


@pytest.fixture(scope="module")
def pages():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        manifest = npe2.PluginManifest.from_file(MANIFEST)
    found = manifest.contributions.configurations
    if not found:
        pytest.skip("this npe2 knows no preferences (before 0.9)")
    return found


def test_the_page_has_the_defaults_of_the_program(pages):
    """Nothing is set twice in different ways."""
    defaults = {
        key: item.default for page in pages.values() for key, item in page.properties.items()
    }
    found, remark = usable(defaults)
    assert remark == ""
    assert found == Preferences()
    assert found.fit == FitSettings()
    assert set(defaults) == {"fit_psf", "density", *Preferences.model_fields} - {"fit"}
    offered = pages["fit"].properties["accuracy"].enum
    assert offered[: len(PRESETS)] == list(PRESETS)
    numbers = [float(usable_choice(one)) for one in offered[len(PRESETS) :]]
    assert numbers == sorted(numbers, reverse=True)


def test_what_is_preferred_is_used():
    found, remark = usable(
        {"accuracy": "1e-4", "fit_psf": True, "density": "smooth", "updates_per_second": 5}
    )
    assert remark == ""
    assert found.fit == FitSettings(fit_psf=True, density="smooth")
    assert found.accuracy == "1e-4"
    assert found.updates_per_second == 5


def test_what_is_invalid_is_ignored_and_named_in_one_line():
    found, remark = usable({"accuracy": "much", "density": "smooth", "updates_per_second": 0})
    assert found == Preferences(fit=FitSettings(density="smooth"))
    assert "accuracy = much" in remark
    assert "updates_per_second = 0" in remark
    assert "\n" not in remark
    assert "density" not in remark


def test_a_new_widget_is_set_as_preferred(make_widget, monkeypatch, told):
    chosen = {
        "fit": FitSettings(fit_psf=True, density="interface"),
        "accuracy": "3e-4",
        "preview_seeds": False,
        "show_rendered": True,
        "updates_per_second": 4,
        "effects": "attenuation=0.2",
        "psf": "from the objective",
        "modality": "widefield",
        "na": 0.8,
    }
    monkeypatch.setattr(
        "napari_deltamic.gui.fit_widget.read_preferences",
        lambda: (Preferences(**chosen), "a remark"),
    )
    widget = make_widget()
    assert widget.doc.settings.fit_settings() == chosen["fit"].model_copy(update={"accuracy": 3e-4})
    assert widget.doc.settings.accuracy == "3e-4"
    assert widget.doc.view == "rendered"
    assert not widget.seeds.preview.isChecked()
    assert widget.doc.work.interval == 0.25
    scene = widget.doc.settings.scene_settings()
    assert scene.effects == Effects.of(Attenuation(per_um=0.2))
    assert (scene.optics.modality, scene.optics.na) == ("widefield", 0.8)
    assert told == ["a remark"]


def test_the_page_of_napari_is_read(monkeypatch, tmp_path):
    """With napari's own settings object, made from our manifest."""
    napari_settings = pytest.importorskip("napari.settings")
    if not hasattr(napari_settings, "get_plugin_settings"):
        pytest.skip("before napari 0.9")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        manager = npe2.PluginManager.instance()
        manager.discover()
    if PLUGIN not in manager:
        pytest.skip("not installed")
    monkeypatch.setattr(napari_settings, "_PLUGIN_SETTINGS", {})
    (tmp_path / f"{PLUGIN}.yaml").write_text("fit:\n  accuracy: '1e-5'\n  density: nonsense\n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        page = napari_settings.get_plugin_settings(PLUGIN, path_dir=tmp_path)
    found, remark = read_preferences()
    assert found == Preferences(accuracy="1e-5"), "what is invalid is napari's default"
    assert remark == ""
    page.viewing.updates_per_second = 7
    assert read_preferences()[0].updates_per_second == 7


@pytest.mark.parametrize("error", [KeyError("no such plugin"), ValueError("a bad file")])
def test_preferences_that_cannot_be_read_are_told(monkeypatch, error):
    napari_settings = pytest.importorskip("napari.settings")

    def fail(name):
        raise error

    monkeypatch.setattr(napari_settings, "get_plugin_settings", fail, raising=False)
    monkeypatch.setattr(preferences, "PluginManager", _Manager)
    found, remark = read_preferences()
    assert found == Preferences()
    assert "cannot be read" in remark
    assert "\n" not in remark


def test_without_the_plugin_known_nothing_is_asked(monkeypatch):
    monkeypatch.setattr(preferences, "PluginManager", _Nothing)
    assert read_preferences() == (Preferences(), "")


class _Manager:
    @staticmethod
    def instance():
        return {PLUGIN}


class _Nothing:
    @staticmethod
    def instance():
        return set()
