"""Sessions that cannot be saved or opened, and what happens meanwhile."""

import os
import warnings
import weakref
from dataclasses import replace
from functools import partial

import napari.components
import npe2
import numpy as np
import pytest

from napari_deltamic import _reader
from napari_deltamic.geometry import files
from napari_deltamic.gui import fit_widget
from napari_deltamic.gui.results.session import capture, restore
from napari_deltamic.results.session_file import load_session

from .sessions import fitted, save, shown

pytestmark = pytest.mark.usefixtures("judged")


def test_a_result_of_another_image_is_left_out_and_told(seeded, with_image, spin, tmp_path, told):
    fitted(seeded, spin)
    with_image.add_image(np.random.default_rng(0).random((5, 6, 7)), name="other")
    seeded.doc.image.choose(with_image.layers["other"])
    save(seeded, tmp_path / "a.deltamic", spin)
    assert any("not in this session" in text for text in told)
    assert load_session(tmp_path / "a.deltamic").result is None


def test_no_image_and_bad_settings_are_told(app, seeded, with_image, tmp_path, told, monkeypatch):
    name = str(tmp_path / "a")
    monkeypatch.setattr("qtpy.QtWidgets.QFileDialog.getSaveFileName", lambda *a, **k: (name, ""))
    seeded.settings.accuracy.setCurrentText("much")
    seeded.sessions.save_action.trigger()
    assert "accuracy" in told[-1]
    del with_image.layers["cell"]
    seeded.sessions.save_action.trigger()
    assert "open a 3D image" in told[-1]
    (tmp_path / "a.deltamic").touch()
    seeded.sessions.save_action.trigger()
    assert "is there already" in told[-1]
    assert seeded.sessions.save_action.isEnabled()


def test_a_full_disk_is_told_and_the_session_can_be_saved_elsewhere(
    seeded, spin, tmp_path, told, monkeypatch
):
    fitted(seeded, spin)
    verdict = seeded.running.verdict.text()

    def fail(descriptor):
        raise OSError(28, os.strerror(28))

    with monkeypatch.context() as patch:
        patch.setattr(files.os, "fsync", fail)
        seeded.sessions.save(str(tmp_path / "a.deltamic"))
        spin(lambda: not seeded.sessions.busy)
        assert "No space left" in told[-1]
        results = seeded.results
        for write, name in (
            (results.save_meshes, "a.ply"),
            (results.save_table, "a.csv"),
            (results.save_image, "a.ome.tif"),
            (results.save_all, "all"),
        ):
            seeded.doc.attempt(partial(write, str(tmp_path / name)))
            assert "No space left" in told[-1], name
            assert "Traceback" not in told[-1]
    assert seeded.running.verdict.text() == verdict, "the fit did not fail"
    save(seeded, tmp_path / "b.deltamic", spin)
    assert load_session(tmp_path / "b.deltamic").result is not None
    assert not (tmp_path / "a.deltamic").exists()


def test_a_damaged_file_is_told_and_changes_nothing(seeded, with_image, spin, tmp_path, told):
    (tmp_path / "a.deltamic").write_bytes(b"no session")
    n = len(with_image.layers)
    seeded.sessions.open(str(tmp_path / "a.deltamic"))
    spin(lambda: not seeded.sessions.busy)
    assert "not a deltaMic session" in told[-1]
    assert len(with_image.layers) == n
    assert seeded.sessions.open_action.isEnabled()


def test_the_reader_opens_the_layers(seeded, with_image, spin, tmp_path):
    save(fitted(seeded, spin), tmp_path / "a.deltamic", spin)
    path = str(tmp_path / "a.deltamic")
    viewer = napari.components.ViewerModel()
    for data, options, kind in _reader.get_reader(path)(path):
        getattr(viewer, f"add_{kind}")(data, **options)
    assert [layer.name for layer in viewer.layers] == ["cell", "seeds", "cell: surfaces"]
    np.testing.assert_array_equal(viewer.layers["cell"].data, with_image.layers["cell"].data)
    assert viewer.layers["cell: surfaces"].units == with_image.layers["cell: surfaces"].units
    assert tuple(viewer.layers["cell: surfaces"].translate) == (1, 2, 3)


@pytest.mark.parametrize("docked", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_session_that_is_dropped_opens_whole(window, seeded, spin, tmp_path, docked):
    path = tmp_path / "a.deltamic"
    save(fitted(seeded, spin), path, spin)
    before = len(seeded.doc.timeline.moments)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        npe2.PluginManager.instance().discover()
        own = fit_widget.FitWidget(window) if docked else None
        if docked:  # not by napari's menu
            window.window.add_dock_widget(own)
        window.open(str(path), plugin="napari-deltamic")
    (widget,) = (
        w for w in window.window.dock_widgets.values() if isinstance(w, fit_widget.FitWidget)
    )
    assert own is None or widget is own
    spin(lambda: not widget.sessions.busy)
    assert {layer.name for layer in window.layers} >= {"cell", "seeds", "cell: surfaces"}
    assert shown(widget)["cells"] == shown(seeded)["cells"]
    assert shown(widget)["fit"] == shown(seeded)["fit"]
    for one in (widget, seeded):
        spin(lambda one=one: one.running.grade.verdict != "")
    assert widget.running.grade.text() == seeded.running.grade.text()
    assert widget.results.table.rows == seeded.results.table.rows
    assert len(widget.doc.timeline.moments) == before
    widget.close_links()


def test_closing_the_widget_while_a_session_is_saved(seeded, spin, tmp_path):
    fitted(seeded, spin)
    bar = weakref.ref(seeded.sessions)
    seeded.sessions.save(str(tmp_path / "a.deltamic"))
    seeded.close_links()
    spin(lambda: (tmp_path / "a.deltamic").exists())
    assert bar() is not None
    assert load_session(tmp_path / "a.deltamic").result is not None


@pytest.mark.slow
def test_capture_shares_the_pixels(seeded, with_image, spin):
    """A large image is not copied."""
    fitted(seeded, spin)
    session, remark = capture(seeded.parts)
    assert remark == ""
    assert np.shares_memory(session.image.pixels, with_image.layers["cell"].data)
    viewer = napari.components.ViewerModel()
    widget = fit_widget.FitWidget(viewer)
    list(restore(widget.parts, session))
    assert np.shares_memory(viewer.layers["cell"].data, session.image.pixels)
    widget.close_links()


def test_the_entry_of_the_menu_asks_in_the_widget(window, monkeypatch):
    from napari_deltamic.gui.menu import open_session

    asked = []
    monkeypatch.setattr(
        "qtpy.QtWidgets.QFileDialog.getOpenFileName", lambda *a: asked.append(a[0]) or ("", "")
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        npe2.PluginManager.instance().discover()
        open_session(window)
    assert [type(parent).__name__ for parent in asked] == ["FitWidget"]


@pytest.mark.parametrize("part", ["image", "seeds"])
def test_layers_that_napari_cannot_make_are_told_and_change_nothing(seeded, with_image, told, part):
    found, _ = capture(seeded.parts)
    if part == "image":
        wrong = replace(found.image, display={**found.image.display, "blending": "no such"})
        found = replace(found, image=wrong)
    else:
        wrong = replace(found.seeds[0], options={**found.seeds[0].options, "colour": "no such"})
        found = replace(found, seeds=(wrong,))
    before = list(with_image.layers)
    seeded.sessions._opened(found)
    assert "damaged" in told[-1]
    assert list(with_image.layers) == before
