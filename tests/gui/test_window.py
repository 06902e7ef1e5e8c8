"""The widget in a viewer: docked and closed."""

import gc
import os
import warnings
import weakref
from types import SimpleNamespace

import numpy as np
import pytest
from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QPushButton

from napari_deltamic.gui import fit_widget
from napari_deltamic.gui.fit_widget import agreed

from .conftest import CENTER, SIZE
from .interacting import went_on

DISPLAY = os.environ.get("QT_QPA_PLATFORM") != "offscreen"


def dock(viewer, pixels):
    """A widget in a dock, with an image and a seed."""
    viewer.add_image(pixels, scale=SIZE, name="cell")
    widget = fit_widget.FitWidget(viewer)
    viewer.window.add_dock_widget(widget, name="deltaMic")
    widget.seeds.place.click()
    viewer.layers["seeds"].add(CENTER)
    return widget


@pytest.fixture
def docked(window, pixels):
    """The same, for tests that need not see it go."""
    return dock(window, pixels)


def test_closing_the_dock_ends_and_releases_everything(window, pixels, spin, endless):
    widget = dock(window, pixels)
    widget.start()
    run = widget.doc.run
    spin(went_on(widget))
    widget.running.edit.use("push")
    spin(lambda doc=widget.doc: len(doc.timeline.moments) > 3)
    widget.running.history.slider.setValue(1)
    parts = (widget.image, widget.seeds, widget.control, widget.edits, widget.running.edit)
    refs = [weakref.ref(x) for x in (widget, run, widget.doc.link, widget.doc.timeline, *parts)]
    n = len(refs)
    window.window.remove_dock_widget(widget)
    assert not run.running
    assert not [c for c in window.mouse_drag_callbacks if "deltamic" in str(c)]
    del widget, run, parts
    spin(lambda: gc.collect() >= 0 and [ref() for ref in refs] == [None] * n)


@pytest.fixture
def asked(monkeypatch):
    """What the user is asked when the dock is closed; the answers are given beforehand."""
    found, answers = [], []

    def answer(widget, text):
        found.append(text)
        return answers.pop(0)

    monkeypatch.setattr("napari_deltamic.gui.fit_widget.agreed", answer)
    return found, answers


def press_close(widget):
    """The cross in the title of the dock."""
    button = widget.parent().titleBarWidget().close_button
    button.click()


def test_closing_the_dock_in_a_fit_asks(window, docked, spin, endless, asked):
    found, answers = asked
    docked.start()
    run = docked.doc.run
    spin(went_on(docked))
    answers += [False, True]
    press_close(docked)
    assert len(found) == 1
    assert "A fit is running" in found[0]
    assert run.running
    assert docked.parent() is not None
    press_close(docked)
    assert len(found) == 2
    assert not run.running
    assert docked.parent() is None


def test_closing_the_dock_else_asks_nobody(window, docked, asked):
    press_close(docked)
    assert asked[0] == []
    assert docked.parent() is None


def test_closing_the_dock_asks_where_a_result_is_in_no_file(docked, spin, asked, tmp_path):
    found, answers = asked
    docked.settings.max_iterations.setValue(2)
    docked.start()
    spin(lambda: not docked.doc.running)
    answers.append(False)
    press_close(docked)
    (text,) = found
    assert "Grade, table and history of image 'cell' would be lost" in text
    assert "Save session" in text
    assert docked.parent() is not None
    docked.sessions.save(str(tmp_path / "a.deltamic"))
    spin(lambda: not docked.sessions.busy)
    press_close(docked)
    assert len(found) == 1
    assert docked.parent() is None


def test_closing_the_dock_asks_where_tracked_times_are_in_no_file(docked):
    tracking = docked.tracking
    frames = [SimpleNamespace(frame=k) for k in range(2)]
    tracking.work = SimpleNamespace(results=frames)
    assert "tracked times would be lost" in docked.doc.would_end()
    tracking.note_saved(frames)
    assert docked.doc.would_end() == ""
    tracking.work = None


def test_who_closes_the_dock_in_a_fit_can_keep_it(app, docked, spin):
    """The question itself: Escape keeps what runs."""
    pressed = []

    def press():
        box = app.activeModalWidget()
        buttons = {button.text().replace("&", ""): button for button in box.buttons()}
        pressed.append(sorted(buttons))
        box.reject() if len(pressed) == 1 else buttons["Close anyway"].click()

    for wanted in (False, True):
        QTimer.singleShot(50, press)
        assert agreed(docked, "A fit is running.") is wanted
    assert pressed[0] == ["Close anyway", "Keep it open"]


def test_closing_the_viewer_ends_the_fit(window, docked, spin, endless):
    docked.start()
    spin(went_on(docked))
    run = docked.doc.run
    window.close()
    spin(lambda: not run.running)
    spin(lambda: run.done)


def test_napari_opens_the_widget_of_the_manifest(window):
    import npe2

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        npe2.PluginManager.instance().discover()
        _, widget = window.window.add_plugin_dock_widget("napari-deltamic")
    assert isinstance(widget, fit_widget.FitWidget)


@pytest.mark.skipif(not DISPLAY, reason="needs a display (DISPLAY is not set)")
@pytest.mark.usefixtures("judged")
def test_a_real_window_shows_contours_and_surfaces(window, docked, spin, tmp_path):
    docked.start()
    spin(lambda: not docked.doc.run.running)
    window.dims.set_point(0, CENTER[0])
    spin(seconds=0.3, must=False)
    flat = window.screenshot(canvas_only=True, flash=False)
    window.dims.ndisplay = 3
    spin(seconds=0.3, must=False)
    solid = window.screenshot(canvas_only=True, flash=False)
    for picture in (flat, solid):  # orange is only on the mesh
        orange = (picture[..., 0] > 120) & (picture[..., 2] < 0.3 * picture[..., 0])
        assert orange.sum() > 100
    assert docked.findChild(QPushButton).isVisible()
    assert np.ptp(solid) > 0
