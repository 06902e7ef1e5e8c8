"""Measuring what accuracy costs on the scene shown: the chart, and how it ends."""

import gc
import threading
import weakref

import numpy as np
import pytest
from qtpy.QtCore import QEvent, QPointF, Qt
from qtpy.QtGui import QMouseEvent

from napari_deltamic.accuracy.tradeoff import Way
from napari_deltamic.errors import InputError
from napari_deltamic.fitting.default_accuracy import image_noise, preset_accuracy
from napari_deltamic.gui import fit_widget
from napari_deltamic.gui.accuracy import accuracy_measure
from napari_deltamic.gui.accuracy.accuracy_view import TradeoffView

from .conftest import CENTER, SHAPE
from .dialing import running, settled

pytestmark = pytest.mark.usefixtures("soon")


def way(accuracy, seconds, error):
    return Way(
        "particle-mesh",
        1e-4,
        "",
        "float32",
        accuracy,
        forward=seconds,
        gradient=seconds,
        error=error,
    )


@pytest.fixture
def ways(pixels):
    standard = preset_accuracy("standard", image_noise(pixels))
    exact = Way("closed form", 0, "", "float64", gradient=1.0, error=0.0, reference=True)
    return [
        exact,
        way(1e-1, 2e-3, 3e-2),
        way(standard, 4e-3, 3e-3),
        way(1e-3, 8e-3, 3e-4),
        Way("closed form", 1e-3, "", "float32", gradient=0.5, error=2e-3),
        Way("closed form", 1e-4, "", "float32", note="not measured: about 9 s"),
    ]


@pytest.fixture
def measuring(seeded, monkeypatch, ways, spin):
    """A widget whose measurements bring these ways, each when it is let."""
    gate, asked = threading.Semaphore(0), []

    def measure(mesh, grid, optics, accuracy, *, progress, **more):
        asked.append((mesh, grid, optics, accuracy))
        for k, one in enumerate(ways, 1):
            assert gate.acquire(timeout=20)
            progress(k, len(ways))
            yield one

    monkeypatch.setattr(accuracy_measure, "measure_ways", measure)
    spin(settled(seeded))
    yield seeded, gate, asked
    gate.release(99)


def test_measuring_draws_the_chart(measuring, ways, spin, pixels):
    widget, gate, asked = measuring
    view = widget.settings.tradeoff
    assert view.plot.isHidden()
    view.button.click()
    gate.release(3)
    spin(lambda: "3 of 6" in view.progress.text())
    assert view.button.text() == "Stop measuring"
    assert not view.plot.isHidden()
    gate.release(3)
    spin(lambda: not widget.measuring.busy)
    mesh, grid, optics, accuracy = asked[0]
    assert (grid.shape, accuracy) == (SHAPE, preset_accuracy("standard", image_noise(pixels)))
    assert optics.sigma_um == pytest.approx(widget.settings.sigma.value())
    assert mesh.vertices_numpy().mean(axis=0) == pytest.approx(CENTER, abs=0.05)
    chart = view.plot.chart
    shown = sorted(p for s in chart.series if s.marker for p in zip(s.x, s.y, strict=True))
    assert shown == [(2e-3, 3e-2), (4e-3, 3e-3), (8e-3, 3e-4), (0.5, 2e-3)]
    front = next(s for s in chart.series if s.line)
    assert list(front.x) == [2e-3, 4e-3, 8e-3]
    assert [(n.x, n.y) for n in chart.notes] == [(4e-3, 3e-3)]
    assert "4 ms" in view.summary.text()
    assert "1 of 6 ways take longer" in view.progress.text()


def test_the_ring_follows_the_dial_and_a_click_sets_it(measuring, spin):
    widget, gate, _ = measuring
    view, dial = widget.settings.tradeoff, widget.settings.accuracy
    view.button.click()
    gate.release(6)
    spin(lambda: not widget.measuring.busy)
    view.plot.resize(280, view.plot.height())
    edited = []
    widget.settings.changed.connect(lambda: edited.append(dial.choice))
    click(view.plot, view.plot.place(8e-3, 3e-4))
    assert dial.choice == "1e-3"
    assert edited == ["1e-3"]
    assert [(n.x, n.y) for n in view.plot.chart.notes] == [(8e-3, 3e-4)]
    for nowhere in (view.plot.place(0.5, 2e-3), QPointF(1, 1)):
        click(view.plot, nowhere)
        assert dial.choice == "1e-3", "only what is planned for an accuracy can be asked for"
    dial.setCurrentText("4e-3")
    assert "not measured" in view.summary.text()
    assert not view.plot.chart.notes
    view.hide_button.click()
    assert view.plot.isHidden()


def click(plot, at):
    button = Qt.MouseButton.LeftButton
    kind, none = QEvent.Type.MouseButtonRelease, Qt.KeyboardModifier.NoModifier
    plot.mouseReleaseEvent(QMouseEvent(kind, at, at, button, button, none))


def test_stopping_keeps_what_was_measured(measuring, spin):
    widget, gate, _ = measuring
    view = widget.settings.tradeoff
    view.button.click()
    gate.release(2)
    spin(lambda: "2 of 6" in view.progress.text())
    view.button.click()
    assert not widget.measuring.busy
    assert "2 ways" in view.progress.text()
    gate.release(9)
    spin(seconds=0.1, must=False)
    assert len(view.ways) == 2


def test_not_while_a_fit_runs(measuring, spin, endless):
    widget, gate, asked = measuring
    view = widget.settings.tradeoff
    view.button.click()
    gate.release(1)
    spin(lambda: "1 of 6" in view.progress.text())
    widget.start()
    assert not widget.measuring.busy
    assert "as a fit started" in view.progress.text()
    assert not view.button.isEnabled()
    assert "fit runs" in view.button.toolTip()
    widget.measuring.start()
    assert not widget.measuring.busy
    widget.stop()
    spin(lambda: not running(widget))
    assert view.button.isEnabled()
    assert len(asked) == 1


def test_the_reason_is_shown_where_there_is_no_chart(seeded, spin, endless):
    seeded.start()
    assert "while a fit runs" in seeded.settings.tradeoff.reason.text()
    seeded.stop()
    spin(lambda: not running(seeded))
    assert seeded.settings.tradeoff.reason.text() == ""


def test_what_goes_wrong_is_told_in_words(seeded, make_widget, monkeypatch, spin):
    def fail(*arguments, **more):
        raise InputError("the image of the mesh is empty")

    monkeypatch.setattr(accuracy_measure, "measure_ways", fail)
    view = seeded.settings.tradeoff
    view.button.click()
    spin(lambda: not seeded.measuring.busy)
    assert view.progress.text() == "not measured: the image of the mesh is empty"
    assert view.button.text() == "Measure on this scene"


def test_without_seeds_it_says_so(make_widget):
    widget = make_widget()
    widget.settings.tradeoff.button.click()
    assert "no cells yet" in widget.settings.tradeoff.progress.text()


def test_a_chart_of_another_psf_says_so(measuring, spin):
    widget, gate, _ = measuring
    view, box = widget.settings.tradeoff, widget.settings.sigma._boxes[0]
    view.button.click()
    gate.release(6)
    spin(lambda: not widget.measuring.busy)
    old = box.value()
    box.setValue(2 * old)
    assert "measure again" in view.progress.text()
    box.setValue(old)
    assert view.progress.text() == ""


def test_closing_while_it_measures_releases_everything(measuring, with_image, spin):
    _, gate, asked = measuring

    def measured_and_closed():
        widget = fit_widget.FitWidget(with_image)
        spin(settled(widget))
        widget.measuring.start()
        spin(lambda: asked)
        gate.release(1)
        spin(lambda: len(widget.settings.tradeoff.ways) == 1)
        under_way = widget.measuring._measuring
        parts = (widget, widget.measuring, widget.forecast, widget.settings, under_way)
        widget.close_links()
        return [weakref.ref(part) for part in parts]

    refs = measured_and_closed()
    gc.collect()
    assert [ref() for ref in refs] == [None] * len(refs), "though a way is still under way"
    gate.release(9)
    spin(seconds=0.2, must=False)


def test_a_small_scene_is_really_measured(seeded, spin, monkeypatch):
    monkeypatch.setattr(accuracy_measure, "BUDGET", 0.02)
    spin(settled(seeded))
    view = seeded.settings.tradeoff
    view.button.click()
    spin(lambda: not seeded.measuring.busy, 60)
    assert any(one.in_use and one.measured for one in view.ways)
    assert view.plot.chart.notes
    assert view.summary.text().startswith("ringed: in use; ")


@pytest.mark.parametrize("paper", ["#262930", "#f0f0f0"])
def test_the_chart_can_be_read_in_any_theme_at_300_pixels(app, ways, paper):
    view = TradeoffView()
    ink = "#f0f1f2" if paper == "#262930" else "#3b3a39"
    view.setStyleSheet(f"background-color: {paper}; color: {ink};")
    view.resize(280, 400)
    view.show_accuracy(ways[2].accuracy)
    view.show_ways(ways)
    picture = (
        view.plot.grab().toImage().convertToFormat(view.plot.grab().toImage().Format.Format_RGB32)
    )
    bits = picture.constBits()
    bits.setsize(picture.sizeInBytes())
    found = np.frombuffer(bytes(bits), np.uint8).reshape(picture.height(), -1, 4)[..., :3]
    assert (np.abs(found.astype(int) - found[2, -2]).max(axis=-1) > 60).mean() > 0.02
    edges = [view.plot.place(one.gradient, one.error) for one in ways if one.error]
    assert all(0 < at.x() < view.plot.width() and 0 < at.y() < 190 for at in edges)
