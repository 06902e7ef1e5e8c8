"""Earlier moments of a fit, undo, what is left of it, and its images."""

import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from napari_deltamic.common.doing import doing
from napari_deltamic.fitting import fit
from napari_deltamic.fitting.rivals.light_cone import confocal_of
from napari_deltamic.gui.running import footer, run_control, worker
from napari_deltamic.gui.running.footer import forecast_text, progress_text
from napari_deltamic.measure.surface_distance import distance_to_surface
from napari_deltamic.optics import GaussianPSF

from .interacting import notes, pause, right_end, use, vertices, went_on


def test_looking_back_while_the_fit_goes_on(begun, spin):
    spin(lambda: len(begun.doc.timeline.moments) > 8)
    bar = begun.running.history
    bar.slider.setValue(1)
    moment = begun.doc.moment
    assert begun.doc.link.shown is moment.mesh
    assert f"iteration {moment.iteration}" in bar.note.text()
    n = len(begun.doc.run.history.loss)
    spin(lambda: len(begun.doc.run.history.loss) > n + 10)
    assert begun.doc.link.shown is moment.mesh
    assert begun.doc.moment is moment
    assert not use(begun, "push").drag(right_end(begun))  # that is not the present surface
    bar.live_button.click()
    assert begun.doc.link.shown is begun.doc.link.mesh is not moment.mesh


def test_going_on_from_an_earlier_moment(begun, spin):
    spin(lambda: len(begun.doc.timeline.moments) > 8)
    bar = begun.running.history
    bar.slider.setValue(0)
    first, of = begun.doc.moment.mesh.vertices_numpy(), begun.doc.moment.iteration
    bar.go_on_button.click()
    spin(lambda: f"back to iteration {of}" in notes(begun))
    moment = next(m for m in begun.doc.timeline.moments if m.note)
    # The same surface; where it is much curved, with more triangles.
    assert distance_to_surface(first, moment.mesh).max() < 0.05
    assert begun.doc.moment is None
    assert begun.doc.link.shown is begun.doc.link.mesh
    pause(begun, spin)
    bar.undo_button.click()
    spin(lambda: notes(begun)[-1].startswith("undo"))
    assert not np.array_equal(vertices(begun), first)


def test_a_fit_that_has_ended_goes_on_from_a_moment(ended, spin):
    bar, timeline = ended.running.history, ended.doc.timeline
    bar.slider.setValue(0)
    first, n = ended.doc.moment.mesh.vertices_numpy(), timeline.moments[-1].iteration
    bar.go_on_button.click()
    spin(went_on(ended))
    assert ended.doc.run.job.settings.fit.levels[0] < 2
    spin(lambda: timeline.moments[-1].iteration > n)
    later = next(m for m in timeline.moments if m.iteration > n)
    assert np.abs(later.mesh.vertices_numpy() - first).max() < 0.5
    ended.stop()
    spin(lambda: not ended.doc.run.running)
    bar.undo_button.click()
    assert not np.array_equal(vertices(ended), first)


def test_undo_and_redo(ended):
    bar = ended.running.history
    start = vertices(ended)
    use(ended, "push").drag(right_end(ended))
    pushed = vertices(ended)
    use(ended, "pin", 0.4).drag(right_end(ended))
    assert bar.undo_button.toolTip() == "Undo: pin"
    bar.undo_button.click()
    assert not ended.edits.pinned.any()
    bar.undo_button.click()
    np.testing.assert_array_equal(vertices(ended), start)
    assert not bar.undo_button.isEnabled()
    bar.redo_button.click()
    np.testing.assert_array_equal(vertices(ended), pushed)
    bar.redo_button.click()
    assert ended.edits.pinned.any()
    assert not bar.redo_button.isEnabled()


@pytest.mark.slow
@pytest.mark.usefixtures("judged")
def test_undo_brings_back_the_fit_with_its_verdict(seeded, spin):
    seeded.start()
    spin(lambda: not seeded.doc.run.running)
    check, record = seeded.running, seeded.doc.result
    spin(lambda: check.grade.verdict != "")
    graded, fitted = (check.grade.text(), check.grade.verdict), record.state
    assert graded[1] == "good"
    assert check.verdict.verdict == "converged"
    for radius in (0.8, 0.5):
        use(seeded, "push", radius).drag(right_end(seeded))
        assert check.grade.text() == "Changed by hand: continue the fit."
        assert (check.grade.verdict, check.verdict.verdict) == ("", "")
    spin(lambda: record.judged is not None)
    assert record.judged.verdict.reasons[0].text == "it was changed by hand: continue the fit"
    assert check.grade.text() == "Changed by hand: continue the fit."
    assert check.again.isHidden()
    check.history.undo_button.click()
    assert record.by_hand
    check.history.undo_button.click()
    assert record.state.converged
    assert (record.state.mesh, record.state.loss) == (fitted.mesh, fitted.loss)
    assert check.verdict.verdict == "converged"
    spin(lambda: record.judged is not None)
    assert (check.grade.text(), check.grade.verdict) == graded
    check.history.redo_button.click()
    assert record.by_hand


@pytest.fixture
def swapped(monkeypatch):
    """Fits that begin anew with another kind of PSF after two states, and end when they are let."""
    gate = threading.Event()

    def states(job):
        few = job.settings.fit.model_copy(update={"max_iterations": 3})
        given = job.image, job.grid, job.mesh
        begun = list(fit(*given, job.optics, settings=few))[:2]
        swapped = list(fit(*given, confocal_of((0.4, 0.2, 0.2)), settings=few))
        for last in [*begun, *swapped]:
            yield last
            time.sleep(0.1)  # until each is shown
        while not gate.is_set():
            time.sleep(0.01)
            yield last

    monkeypatch.setattr(worker, "start", states)
    return gate


@pytest.mark.usefixtures("judged")
def test_going_on_from_before_the_fit_swapped_its_psf_and_back(seeded, spin, swapped, told):
    seeded.start()
    bar = seeded.running.history
    kind = type(confocal_of((0.4, 0.2, 0.2)))
    spin(lambda: seeded.doc.begun and isinstance(seeded.doc.present().state.optics, kind))
    spin(lambda: bar.slider.maximum() > 1)
    bar.slider.setValue(0)
    assert isinstance(seeded.doc.moment.optics, GaussianPSF)
    assert not bar.go_on_button.isEnabled()  # it runs with another one
    assert "The PSF was of another kind then" in bar.note.text()
    assert "stop it to continue from here" in bar.go_on_button.toolTip()
    swapped.set()
    spin(lambda: not seeded.doc.running)
    spin(lambda: seeded.doc.result.judged is not None)
    first, words = seeded.doc.result.state, seeded.doc.result.words
    grade = seeded.running.grade.text()
    assert grade.startswith("Of the end: ")  # an earlier moment is shown
    assert bar.go_on_button.isEnabled()
    assert "another kind" not in bar.note.text()
    bar.go_on_button.click()
    spin(lambda: not seeded.doc.running)
    record = seeded.doc.result
    assert not told
    assert record.state is not first
    assert not record.by_hand
    spin(lambda: record.judged is not None)
    bar.undo_button.click()
    assert record.state.mesh is first.mesh
    assert isinstance(record.job.optics, kind)
    assert not record.by_hand
    assert record.words == words
    spin(lambda: record.judged is not None)
    assert seeded.running.grade.text() == grade.removeprefix("Of the end: ")
    bar.redo_button.click()  # to what the second fit reached
    assert record.state.mesh is not first.mesh
    assert not record.by_hand


def test_undo_of_settings_shows_them_again(begun, spin):
    before = begun.doc.settings.fit_settings().density
    begun.settings.density.setCurrentText("smooth")
    spin(lambda: begun.doc.run.job.settings.fit.density == "smooth")
    begun.running.history.undo_button.click()
    spin(lambda: begun.doc.run.job.settings.fit.density == before)
    assert begun.settings.density.currentText() == before
    assert begun.edits.redo_note == "brightness smooth"


@pytest.mark.slow
def test_a_new_run_forgets_the_old_one(ended, spin):
    use(ended, "pin", 0.4).drag(right_end(ended))
    old = ended.doc.timeline
    ended.start()
    spin(lambda: ended.doc.timeline is not old)
    assert not ended.edits.pinned.any()
    assert not ended.edits.undo_note


def test_a_failed_start_keeps_the_last_result(ended, with_image, spin, told):
    timeline, state = ended.doc.timeline, ended.doc.result.state
    with_image.layers["seeds"].data = [[50, 50, 50]]
    ended.seeds.shape.setCurrentIndex(0)
    ended.start()
    spin(lambda: not ended.doc.run.running)
    assert ended.doc.timeline is timeline
    assert ended.doc.result.state is state
    use(ended, "push").drag(right_end(ended))
    assert notes(ended)[-1] == "push"


@pytest.mark.slow
def test_a_step_that_takes_long_is_told_instead_of_a_time_that_stands_still(
    seeded, spin, monkeypatch
):
    gate, states, text = threading.Event(), worker.start, seeded.footer.message.text

    def slow(job):
        for k, state in enumerate(states(job)):
            assert k != 4 or gate.wait(20)
            yield state

    monkeypatch.setattr(worker, "start", slow)
    monkeypatch.setattr(footer, "_LONG", 0.2)
    monkeypatch.setattr(footer, "_USUAL", 0.0)
    seeded.start()
    spin(lambda: text() == "the next step takes longer: 1 s so far; 4 iterations")
    gate.set()
    spin(lambda: "takes longer" not in text())
    seeded.stop()
    spin(lambda: not seeded.doc.run.running)


def test_a_comparison_of_models_is_told_and_can_be_stopped(seeded, spin, monkeypatch):
    states, text = worker.start, seeded.footer.message.text

    def comparing(job):
        for k, state in enumerate(states(job)):
            while k == 2:  # it yields no state
                time.sleep(0.01)
                doing("comparing models")
            yield state

    monkeypatch.setattr(worker, "start", comparing)
    monkeypatch.setattr(footer, "_LONG", 0.2)
    monkeypatch.setattr(footer, "_USUAL", 0.0)
    seeded.start()
    spin(lambda: text() == "comparing models: 1 s so far; 2 iterations")
    seeded.stop()
    spin(lambda: not seeded.doc.run.running)
    assert seeded.running.verdict.text().startswith("stopped")
    assert seeded.doc.result.state.iteration == 2


def test_iterations_that_all_take_long_are_no_longer_step(begun, spin):
    shown = begun.footer
    spin(lambda: begun.doc.run.history.loss)
    begun.stop()
    spin(lambda: not begun.doc.run.running)
    snapshot = SimpleNamespace(
        state=SimpleNamespace(level=1, levels=1), remaining=300.0, iterations_per_second=0.1
    )
    begun.doc.run.stopping = False
    shown._show_fit(snapshot)
    assert shown._long == 50.0
    assert shown.progress.format().endswith("%p%")
    reached, snapshot.remaining = shown.progress.value(), None
    shown._show_fit(snapshot)
    assert shown.progress.value() == reached, "never back"
    assert shown.progress.format() == "level 1 of 1", "its end is known no more"


@pytest.mark.slow
def test_remaining_time_is_told_where_it_is_known(begun, spin, monkeypatch):
    spin(lambda: " left; " in begun.footer.message.text())
    begun.stop()
    spin(lambda: not begun.doc.run.running)
    text = begun.footer.message.text
    for left in (42.0, None):
        known = left is not None
        found = SimpleNamespace(kind="", remaining_seconds=lambda *course, left=left: left)
        found.after = lambda earlier, found=found: found
        monkeypatch.setattr(run_control, "expected", lambda job, found=found: found)
        begun.start()
        spin(lambda: text().endswith("a second"))
        spin(lambda known=known: text().startswith("about 42 s left") is known)
        begun.stop()
        spin(lambda: not begun.doc.run.running)
    assert "left" not in progress_text(10, 3.0, None)
    assert progress_text(1, 3.0, None) == "1 iteration, 3 a second"
    assert progress_text(10, 0.25, None).endswith("0.2 a second")
    assert [forecast_text(s) for s in (1, 20, 100, 4000, 9000)] == [
        "a second",
        "about 20 s",
        "about 2 min",
        "about 67 min",
        "about 2 h",
    ]


def test_the_rendered_image_follows_the_result(ended, with_image, spin):
    ended.doc.look("rendered")
    spin(lambda: "cell: rendered" in with_image.layers)
    layer = with_image.layers["cell: rendered"]
    assert layer.visible
    before = layer.data.copy()
    use(ended, "push").drag(right_end(ended))
    spin(lambda: not np.array_equal(layer.data, before))
    np.testing.assert_allclose(layer.data, ended.doc.result.state.rendered())
    ended.doc.look("image")
    assert not layer.visible


def test_a_surface_that_was_hidden_is_the_newest_when_it_is_shown(begun, with_image, spin):
    spin(lambda: begun.doc.link.surface is not None)
    layer = begun.doc.link.surface
    assert not layer.visible
    n = len(begun.doc.run.history.loss)
    spin(lambda: len(begun.doc.run.history.loss) > n + 10)
    pause(begun, spin)
    # The hidden layer was left as it was, which saved the time. The fit may have been given
    # more triangles since then.
    old, new = layer.data[0], vertices(begun)
    assert old.shape != new.shape or not np.allclose(old, new, atol=1e-4)
    with_image.dims.ndisplay = 3
    np.testing.assert_allclose(layer.data[0], vertices(begun), atol=1e-6)


@pytest.mark.usefixtures("judged")
def test_while_an_earlier_moment_is_shown_grade_and_results_say_that_they_are_of_the_end(
    ended, spin
):
    running, results = ended.running, ended.results
    spin(lambda: running.grade.verdict != "")
    grade = running.grade.text()
    assert results.valid_for.isHidden()
    running.history.slider.setValue(0)
    assert running.grade.text() == f"Of the end: {grade}"
    assert results.valid_for.text() == (
        "An earlier moment is shown: table and exports are of the end."
    )
    running.history.live_button.click()
    assert running.grade.text() == grade
    assert results.valid_for.isHidden()
