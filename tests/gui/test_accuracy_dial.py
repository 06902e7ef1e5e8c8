"""The accuracy dial: what it stands for, what it costs before and during a run, and measuring."""

import threading
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.accuracy import machine_costs
from napari_deltamic.accuracy.experience import Experience
from napari_deltamic.accuracy.forecast import Forecast, LevelForecast, RenewedForecast, forecast
from napari_deltamic.accuracy.outlook import Outlook
from napari_deltamic.common.cache_folder import CACHE_VARIABLE
from napari_deltamic.common.words import duration
from napari_deltamic.errors import InputError
from napari_deltamic.fitting.model.default_accuracy import (
    PRESETS,
    accuracy_of,
    image_noise,
    preset_accuracy,
    usable_choice,
    written,
)
from napari_deltamic.geometry import sphere
from napari_deltamic.gui.results.session import capture, restore
from napari_deltamic.gui.running import run_control, worker
from napari_deltamic.gui.settings.accuracy_forecast import predicted
from napari_deltamic.runs.command import command
from napari_deltamic.runs.settings import NEAR_LEVELS, FitSettings

from .conftest import CENTER, SHAPE, SIZE
from .dialing import running, settled
from .interacting import pause, went_on

pytestmark = pytest.mark.usefixtures("soon")

GRID = nd.Grid(SHAPE, SIZE)
EDGE = 3 * min(SIZE)


def expected(widget, pixels, mesh, costs, **settings):
    """The forecast of what is shown, made without the widget."""
    sigma = widget.settings.sigma.value()
    shown = widget.settings
    chosen = {"density": shown.density.currentText(), "fit_psf": shown.fit_psf.isChecked()}
    given = FitSettings(**{**chosen, **settings})
    return forecast(pixels, GRID, mesh, nd.GaussianPSF(sigma), given, costs=costs)


def in_words(found):
    return f"takes {duration(found.seconds, whole=found.seconds > 2)} or more"


# ---------------------------------------------------------------------------------- the dial


@pytest.mark.slow
def test_a_name_stands_for_a_number_on_this_image(seeded, pixels, spin):
    dial = seeded.settings.accuracy
    for name in PRESETS:
        number = preset_accuracy(name, image_noise(pixels))
        dial.setCurrentText(name)
        assert seeded.doc.settings.number() == number
        assert seeded.doc.settings.fit_settings().accuracy == (None if name == "normal" else number)
        spin(settled(seeded))
        shown = seeded.settings.accuracy_number.text()
        assert accuracy_of(shown, 0) == number


def test_a_number_is_taken_as_it_is(seeded, spin):
    seeded.settings.accuracy.setCurrentText("2,5e-3")
    assert seeded.doc.settings.fit_settings().accuracy == 2.5e-3
    spin(settled(seeded))
    assert seeded.settings.accuracy_number.text() == ""


def test_what_is_no_accuracy_is_said(seeded, spin):
    for text in ("much", "", "1", "-1e-3", "nan", "inf"):
        seeded.settings.accuracy.setCurrentText(text)
        with pytest.raises(InputError, match="accuracy"):
            seeded.doc.settings.fit_settings()
        spin(settled(seeded))
        assert seeded.settings.outlook.text().startswith("accuracy must be quick, normal")
        with pytest.raises(ValueError, match="accuracy"):
            usable_choice(text)


def test_numbers_are_written_short_but_whole():
    assert [written(a) for a in (0.0, 3e-3, 0.1, 1.23456e-3)] == [
        "exact",
        "3e-3",
        "1e-1",
        "1.23456e-3",
    ]
    assert all(float(written(a)) == a for a in (3e-3, 1 / 3, 0.045))


def test_times_are_never_written_with_powers():
    assert [duration(s) for s in (0.0994, 0.0996, 0.1, 99)] == [
        "99 ms",
        "0.1 s",
        "0.1 s",
        "1.6 min",
    ]


def test_typing_adds_nothing_to_the_list(seeded):
    dial = seeded.settings.accuracy
    dial.lineEdit().setText("4e-3")
    dial.lineEdit().returnPressed.emit()
    assert dial.count() == 4
    assert seeded.doc.settings.accuracy == "4e-3"


# ------------------------------------------------------------------------- before a run


def test_the_forecast_is_that_of_the_engine(seeded, pixels, spin, costs):
    ball = sphere(CENTER, 0.9, edge_length=EDGE)
    for name in ("normal", "exact"):
        seeded.settings.accuracy.setCurrentText(name)
        spin(settled(seeded))
        number = preset_accuracy(name, image_noise(pixels))
        found = expected(seeded, pixels, ball, costs, accuracy=number)
        assert seeded.settings.outlook.text() == in_words(found)


def test_the_surfaces_of_the_preview_are_used(seeded, pixels, spin, costs):
    seeded.seeds.shape.setCurrentIndex(0)
    spin(lambda: seeded.seeds.preview.mesh is not None)
    spin(settled(seeded))
    found = expected(seeded, pixels, seeded.seeds.preview.mesh, costs, levels=NEAR_LEVELS)
    assert seeded.settings.outlook.text() == in_words(found)


def test_without_a_preview_sizes_are_guessed(seeded, pixels, spin, costs):
    seeded.seeds.preview.setChecked(False)
    seeded.seeds.shape.setCurrentIndex(0)
    spin(settled(seeded))
    ball = sphere(CENTER, min(np.multiply(SHAPE, SIZE)) / 3, edge_length=EDGE)
    found = expected(seeded, pixels, ball, costs, levels=NEAR_LEVELS)
    assert seeded.settings.outlook.text() == in_words(found)


def test_labels_and_surfaces_are_seeds_too(
    make_widget, with_image, pixels, spin, ball_labels, costs
):
    widget = make_widget()
    spin(settled(widget))
    assert widget.settings.outlook.text() == "", "there are no seeds yet"
    place = {"scale": SIZE, "translate": (1, 2, 3), "units": ("um",) * 3}
    labels = with_image.add_labels(ball_labels, **place)
    spin(settled(widget))
    radius = np.cbrt(3 / (4 * np.pi) * (ball_labels > 0).sum() * np.prod(SIZE))
    middle = (np.asarray(SHAPE) - 1) / 2 * SIZE
    ball = sphere(middle, radius, edge_length=EDGE)
    found = expected(widget, pixels, ball, costs, levels=NEAR_LEVELS)
    assert widget.settings.outlook.text() == in_words(found)
    surface = sphere(CENTER, 1.0, edge_length=0.4)
    data = (surface.vertices_numpy(), surface.faces)
    with_image.add_surface(data, translate=(1, 2, 3), units=("um",) * 3)
    widget.seeds.cells.choose(labels, False)
    spin(settled(widget))
    found = expected(widget, pixels, surface, costs)
    assert widget.settings.outlook.text() == in_words(found)


def test_it_follows_what_is_edited(seeded, spin):
    texts = []
    for edit in (
        lambda: None,
        lambda: seeded.settings.density.setCurrentText("smooth"),
        lambda: [box.setValue(0.6) for box in seeded.settings.sigma._boxes],
        lambda: seeded.seeds.radius.setValue(1.8),
        lambda: seeded.image.voxel_size._boxes[2].setValue(0.6),
    ):
        edit()
        spin(settled(seeded))
        texts.append(seeded.settings.outlook.text())
    assert all(a != b for a, b in pairwise(texts)), texts


def test_the_first_time_the_machine_is_measured_in_the_background(
    seeded, spin, costs, monkeypatch, tmp_path
):
    spin(settled(seeded))
    gate, calls = threading.Event(), []

    def slow():
        calls.append(threading.current_thread())
        assert gate.wait(20)
        return costs

    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    monkeypatch.setattr(machine_costs, "calibrate", slow)
    for text in ("1e-3", "2e-3"):
        seeded.settings.accuracy.setCurrentText(text)
        if text == "1e-3":
            spin(lambda: calls)
            assert "measuring this computer" in seeded.settings.outlook.text()
            gate.set()
        spin(settled(seeded))
        assert seeded.settings.outlook.text().startswith("takes")
    assert len(calls) == 1, "it is kept"
    assert calls[0] is not threading.main_thread()


def test_closing_the_widget_while_the_forecast_is_made(seeded, make_widget, spin, held_costs):
    gate, _ = held_costs
    widget = make_widget()
    spin(lambda: "measuring" in widget.settings.outlook.text())
    widget.close_links()
    assert not widget.settings.forecast.background.busy
    gate.set()
    spin(seconds=0.2, must=False)
    assert "measuring" in widget.settings.outlook.text(), "nobody was told"


@pytest.fixture
def held_costs(monkeypatch, tmp_path, costs):
    """A machine whose measurement does not end before it is let go."""
    gate, calls = threading.Event(), []

    def slow():
        calls.append(None)
        assert gate.wait(20)
        return costs

    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    monkeypatch.setattr(machine_costs, "calibrate", slow)
    yield gate, calls
    gate.set()


# ------------------------------------------------------------------------- during a run

LEVELS = tuple(
    LevelForecast(n, 1.0, SHAPE, "particle-mesh", 1e-2, 0.01 * n, 40, 0.0) for n in range(1, 6)
)


def test_a_run_shows_its_own_forecast(seeded, spin, endless):
    seeded.start()
    assert seeded.settings.outlook.text() == ""
    spin(lambda: "takes" in seeded.settings.outlook.text())
    assert seeded.settings.outlook.text() == in_words(seeded.doc.run.forecast)


def test_measured_beside_predicted(seeded, spin, endless, monkeypatch):
    monkeypatch.setattr(run_control, "expected", lambda job: Forecast(LEVELS, True))
    seeded.start()
    spin(lambda: seeded.doc.run.state is not None)
    seeded.stop()
    spin(lambda: not running(seeded))
    text = seeded.settings.pace.text()
    assert text.startswith("the last fit took ")
    assert text.endswith(f"{duration(Forecast(LEVELS, True).seconds)} predicted")


def test_a_run_that_takes_another_psf_on_the_way_teaches_too(seeded, spin, monkeypatch):
    whole = Forecast(tuple(replace(one, seconds_per_iteration=1e4) for one in LEVELS), True)
    monkeypatch.setattr(run_control, "expected", lambda job: whole)
    # As where the image shows a light cone: the job is another one from the tenth state on.
    monkeypatch.setattr(
        worker, "following", lambda job, state: replace(job) if state.iteration == 10 else job
    )
    seeded.settings.max_iterations.setValue(30)
    seeded.start()
    spin(lambda: not running(seeded))
    run = seeded.doc.run
    assert isinstance(run.forecast, RenewedForecast)
    assert seeded.doc.learned.about(whole.kind).seconds < 0.1
    assert seeded.settings.pace.text().endswith(f"{duration(whole.seconds)} predicted")


def test_the_next_run_is_predicted_by_what_the_last_one_took(seeded, spin, monkeypatch):
    # So slow as no machine is: what is learned does not depend on this one.
    whole = Forecast(tuple(replace(one, seconds_per_iteration=1e4) for one in LEVELS), True)
    monkeypatch.setattr(run_control, "expected", lambda job: whole)
    seeded.settings.max_iterations.setValue(30)
    seeded.start()
    spin(lambda: not running(seeded))
    run = seeded.doc.run
    learned = whole.experience(run.history, run.state, run.seconds)
    assert learned.seconds < 0.1
    known = seeded.doc.learned.about(whole.kind)
    assert known.seconds == pytest.approx(learned.seconds)
    assert learned.iterations < known.iterations < 1  # one fit says less of that
    # Of the same image it says all that is known.
    known = seeded.doc.learned.about(whole.kind, seeded.doc.image.key())
    assert known == learned
    seeded.start()
    spin(lambda: not running(seeded))
    assert seeded.doc.run.forecast.seconds == pytest.approx(whole.after(known).seconds)
    assert seeded.doc.run.forecast.iterations == whole.after(known).iterations
    # Also in words, before a third one starts.
    key = seeded.doc.image.key()
    known = seeded.doc.learned.about(whole.kind, key)
    spin(lambda: not seeded.settings.forecast.background.busy)
    seeded.settings.forecast._show(key, Outlook(0.1, 1e-2, whole))
    assert seeded.settings.outlook.text() == predicted(whole.after(known))
    assert seeded.settings.outlook.text().endswith("or more"), "it was cut short"
    whole = whole.after(Experience(0.1, 0.1, single=True))
    assert predicted(whole) == f"takes about {duration(whole.seconds, whole=True)}"


@pytest.mark.slow
def test_time_that_a_fit_was_paused_does_not_count(seeded, spin, endless, monkeypatch):
    monkeypatch.setattr(worker, "FORECAST_EVERY", 0.01)
    elapsed = []

    def remaining(history, state, seconds=None):
        elapsed.append(seconds)
        return 1.0

    found = SimpleNamespace(kind="", remaining_seconds=remaining, levels=())
    found.after = lambda earlier: found
    monkeypatch.setattr(run_control, "expected", lambda job: found)
    seeded.start()
    spin(lambda: elapsed and elapsed[-1] > 0)
    pause(seeded, spin)
    before, asked = seeded.doc.run.seconds, len(elapsed)
    spin(seconds=1.0, must=False)
    seeded.footer.pause_button.click()
    spin(lambda: len(elapsed) > asked)
    assert 0 < elapsed[asked] < before + 0.5


def test_a_change_of_the_dial_is_forecast_anew(seeded, spin, endless, monkeypatch):
    jobs = []
    monkeypatch.setattr(
        run_control, "expected", lambda job: jobs.append(job) or Forecast(LEVELS, True)
    )
    seeded.start()
    spin(went_on(seeded))
    dial = seeded.settings.accuracy
    dial.setCurrentText("careful")
    seeded.doc.settings.changed.emit(True)
    spin(lambda: len(jobs) == 2)
    assert jobs[1].settings.fit.accuracy == seeded.doc.settings.number()
    spin(lambda: isinstance(seeded.doc.run.forecast, RenewedForecast))
    assert seeded.doc.run.forecast.iterations >= 3
    dial.setCurrentText("normal")
    seeded.doc.settings.changed.emit(True)
    spin(lambda: len(jobs) == 3)
    assert jobs[2].settings.fit.accuracy == seeded.doc.settings.number(), "not what it had before"


def test_a_renewed_forecast_goes_by_the_time_since():
    old = 30  # iterations that took ten times as long
    history = SimpleNamespace(level=[1] * (old + 10), first=1)
    found = RenewedForecast(Forecast(LEVELS[:1], True), old, old * 0.1)
    state = SimpleNamespace(level=1, converged=False)
    left = 12 * 0.01  # a window: it has had as many as were expected
    assert found.remaining_seconds(history, state) == pytest.approx(left)
    usual = old * 0.1 + 10 * 0.01
    assert found.remaining_seconds(history, state, usual) == pytest.approx(left)
    twice = found.remaining_seconds(history, state, usual + 10 * 0.01)
    assert 1.3 * left < twice < 2 * left


# -------------------------------------------------------------- sessions, commands


def test_a_session_keeps_the_name(seeded, make_widget, spin):
    seeded.settings.accuracy.setCurrentText("quick")
    session, _ = capture(seeded.parts)
    number = seeded.doc.settings.number()
    assert session.settings.fit.accuracy == number
    other = make_widget()
    list(restore(other.parts, session))
    assert other.doc.settings.accuracy == "quick"
    assert other.doc.settings.fit_settings() == session.settings.fit
    # Without the name, the number is shown.
    fit = session.settings.fit.model_copy(update={"shape_error": "normal"})
    settings = session.settings.model_copy(update={"fit": fit})
    list(restore(other.parts, replace(session, panels={}, settings=settings)))
    assert other.doc.settings.accuracy == written(number)


def test_a_length_is_taken_for_the_shape(seeded):
    dial = seeded.settings.accuracy
    dial.setCurrentText("20 nm")
    found = seeded.doc.settings.fit_settings()
    assert (found.accuracy, found.shape_error) == (None, "20nm")
    dial.setCurrentText("quick")
    assert seeded.doc.settings.fit_settings().shape_error == "quick"
    seeded.doc.settings.show_fit(found)
    assert dial.currentText() == "20nm"
    dial.setCurrentText("3e-3")
    assert seeded.doc.settings.fit_settings().shape_error == "normal"


def test_the_command_names_a_number(seeded, pixels):
    for name in PRESETS:
        seeded.settings.accuracy.setCurrentText(name)
        words = command(seeded.doc.run_settings(), "result").split()
        if name == "normal":
            assert "--accuracy" not in words
        else:
            given = float(words[words.index("--accuracy") + 1])
            assert given == preset_accuracy(name, image_noise(pixels))


def test_another_image_has_another_noise(seeded, with_image, pixels, spin):
    spin(settled(seeded))
    seeded.settings.accuracy.setCurrentText("quick")
    smooth = np.full(SHAPE, 100, np.float32) + np.arange(SHAPE[2], dtype=np.float32)
    before = seeded.doc.settings.number()
    layer = with_image.add_image(smooth, scale=SIZE, name="smooth")
    seeded.doc.image.choose(layer)
    number = preset_accuracy("quick", image_noise(smooth))
    assert seeded.doc.settings.number() == number != before
