"""Errors that nobody expected: the user reads a line, the log has the traceback."""

import logging
import threading

import pytest

from napari_deltamic.errors import InputError
from napari_deltamic.gui.running import worker
from napari_deltamic.gui.window_words import attempt
from napari_deltamic.gui.work import Background
from napari_deltamic.results import judged

LOGGER = "napari_deltamic.gui.window_words"


def broken(*arguments, **options):
    raise KeyError("a bug")


def wrong(*arguments, **options):
    raise InputError("no image")


def tracebacks(caplog):
    return [r.exc_info[0] for r in caplog.records if r.name == LOGGER and r.exc_info]


def test_an_action(caplog):
    said = []
    attempt(broken, said.append)
    attempt(wrong, said.append)
    assert said == ["KeyError: 'a bug'; the log shows where", "no image"]
    assert tracebacks(caplog) == [KeyError]  # what a user got wrong needs none


def test_work_in_the_background(app, spin, caplog):
    said = []
    background = Background(said.append)
    for action, n in ((broken, 1), (wrong, 2)):
        background.ask(action, print)
        spin(lambda n=n: len(said) == n)
    assert said[1] == "no image"
    assert tracebacks(caplog) == [KeyError]


@pytest.mark.parametrize("where", ["the thread", "the viewer"])
def test_a_fit(seeded, spin, told, monkeypatch, caplog, where):
    if where == "the thread":
        monkeypatch.setattr(worker, "start", broken)
    else:
        drawn, draw = [], seeded.running.curve.show_losses

        def broken_once(*arguments):
            drawn.append(True)
            (broken if len(drawn) == 1 else draw)(*arguments)

        monkeypatch.setattr(seeded.running.curve, "show_losses", broken_once)
    seeded.start()
    spin(lambda: not seeded.doc.run.running)
    assert "the log shows where" in told[-1]
    assert tracebacks(caplog) == [KeyError]
    assert caplog.records[-1].levelno == logging.ERROR


def test_tracking(series_widget, spin, told, monkeypatch, caplog):
    monkeypatch.setattr(judged, "track", broken)
    series_widget.tracking.start()
    spin(lambda: not series_widget.tracking.work.running)
    assert tracebacks(caplog) == [KeyError]


def test_what_a_thread_brings_too_late_is_dropped(app, spin):
    """With PySide6 it once reached an object that was gone."""
    gate, told = threading.Event(), []
    for _ in range(5):
        background = Background(told.append)
        background.ask(gate.wait, told.append)
        background.close()
        del background
    gate.set()
    kept = Background(told.append)
    kept.ask(lambda: "kept", told.append)
    spin(lambda: told)
    spin(seconds=0.1, must=False)
    assert told == ["kept"]
