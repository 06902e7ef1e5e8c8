"""Measuring what accuracy costs on the scene shown: the chart, and how it ends."""

import gc
import threading
import weakref
from dataclasses import replace

import pytest

from napari_deltamic.accuracy.tradeoff import Way
from napari_deltamic.errors import InputError
from napari_deltamic.fitting.model.default_accuracy import image_noise, preset_accuracy
from napari_deltamic.gui import fit_widget
from napari_deltamic.gui.settings import accuracy_forecast

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
    standard = preset_accuracy("normal", image_noise(pixels))
    exact = Way("closed form", 0, "", "float64", gradient=1.0, error=0.0, reference=True)
    return [
        exact,
        way(1e-1, 2e-3, 3e-2),
        way(standard, 4e-3, 3e-3),
        way(1e-3, 8e-3, 3e-4),
        Way("closed form", 1e-4, "", "float32", 1e-4, note="not measured: about 9 s"),
        Way("closed form", 1e-4, "", "float32", 1e-5, note="not measured: about 9 s"),
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

    monkeypatch.setattr(accuracy_forecast, "measure_ways", measure)
    spin(settled(seeded))
    yield seeded, gate, asked
    gate.release(99)


def lines(view):
    return [view.list.item(k).text() for k in range(view.list.count())]


def test_each_way_is_a_line(measuring, ways, spin, pixels):
    widget, gate, asked = measuring
    view = widget.settings.tradeoff
    assert view.list.isHidden()
    view.button.click()
    assert view.button.text() == "Stop measuring"
    gate.release(3)
    spin(lambda: len(view.ways) == 3)
    assert not view.list.isHidden()
    gate.release(3)
    spin(lambda: not view.button.busy)
    assert view.button.text() == "Measure on this scene"
    mesh, grid, optics, accuracy = asked[0]
    assert (grid.shape, accuracy) == (SHAPE, preset_accuracy("normal", image_noise(pixels)))
    assert optics.sigma_um == pytest.approx(widget.settings.sigma.value())
    assert mesh.vertices_numpy().mean(axis=0) == pytest.approx(CENTER, abs=0.05)
    shown = lines(view)
    assert shown[0] == "1e-1: 2 ms an image, error 3e-2"
    assert [text.partition(": ")[2] for text in shown[1:]] == [
        "4 ms an image, error 3e-3",
        "8 ms an image, error 3e-4",
    ]
    assert [view.list.item(k).font().bold() for k in range(3)] == [False, True, False]
    assert "2 of 5 left out" in view.progress.text()


def test_what_others_are_compared_with_is_not_offered(measuring, ways, spin):
    view, gate = measuring[0].settings.tradeoff, measuring[1]
    ways[0] = replace(ways[0], accuracy=1e-9)
    view.button.click()
    gate.release(6)
    spin(lambda: not view.button.busy)
    assert lines(view)[0].startswith("1e-1:")
    assert len(lines(view)) == 3


def test_a_click_sets_the_dial(measuring, spin):
    widget, gate, _ = measuring
    view, dial = widget.settings.tradeoff, widget.settings.accuracy
    view.button.click()
    gate.release(6)
    spin(lambda: not view.button.busy)
    edited = []
    settings = widget.doc.settings
    settings.changed.connect(lambda: edited.append(settings.accuracy))
    view.list.itemClicked.emit(view.list.item(2))
    assert dial.currentText() == "1e-3"
    assert edited == ["1e-3"]
    assert view.list.item(2).font().bold()


def test_stopping_keeps_what_was_measured(measuring, spin):
    widget, gate, _ = measuring
    view = widget.settings.tradeoff
    view.button.click()
    gate.release(2)
    spin(lambda: len(view.ways) == 2)
    view.button.click()
    assert not view.button.busy
    assert "2 ways" in view.progress.text()
    gate.release(9)
    spin(seconds=0.1, must=False)
    assert len(view.ways) == 2


def test_a_fit_ends_it(measuring, spin, endless):
    widget, gate, asked = measuring
    view = widget.settings.tradeoff
    view.button.click()
    gate.release(1)
    spin(lambda: len(view.ways) == 1)
    widget.start()
    assert not view.button.busy
    assert running(widget)
    assert "stopped" in view.progress.text()
    assert not view.button.isEnabled()
    view.button.start()
    assert not view.button.busy
    assert "stop it first" in view.progress.text()
    widget.stop()
    spin(lambda: not running(widget))
    assert view.button.isEnabled()
    assert len(asked) == 1


def test_what_goes_wrong_is_told_in_words(seeded, make_widget, monkeypatch, spin):
    def fail(*arguments, **more):
        raise InputError("the image of the mesh is empty")

    monkeypatch.setattr(accuracy_forecast, "measure_ways", fail)
    view = seeded.settings.tradeoff
    view.button.click()
    spin(lambda: not seeded.settings.tradeoff.button.busy)
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
    spin(lambda: not widget.settings.tradeoff.button.busy)
    old = box.value()
    box.setValue(2 * old)
    assert "measure again" in view.progress.text()
    box.setValue(old)
    assert view.progress.text() == ""


@pytest.mark.slow
def test_closing_while_it_measures_releases_everything(measuring, with_image, spin):
    _, gate, asked = measuring

    def measured_and_closed():
        widget = fit_widget.FitWidget(with_image)
        spin(settled(widget))
        view = widget.settings.tradeoff
        view.button.start()
        spin(lambda: asked)
        gate.release(1)
        spin(lambda: len(view.ways) == 1)
        parts = (widget, view, widget.settings.forecast, widget.settings, widget.doc)
        widget.close_links()
        return [weakref.ref(part) for part in parts]

    refs = measured_and_closed()
    gc.collect()
    assert [ref() for ref in refs] == [None] * len(refs), "though a way is still under way"
    gate.release(9)
    spin(seconds=0.2, must=False)


def test_a_small_scene_is_really_measured(seeded, spin, monkeypatch):
    monkeypatch.setattr(accuracy_forecast, "BUDGET", 0.02)
    spin(settled(seeded))
    view = seeded.settings.tradeoff
    view.button.click()
    spin(lambda: not view.button.busy, 60)
    assert any(one.measured for one in view.ways)
    assert lines(view)
