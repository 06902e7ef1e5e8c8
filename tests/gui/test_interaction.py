"""What a user does to a fit while it runs, while it is paused, and after its end."""

from types import SimpleNamespace

import numpy as np
import pytest

from napari_deltamic.errors import InputError
from napari_deltamic.gui.running.run_panel import duration, progress_text
from napari_deltamic.inference import Change
from napari_deltamic.scene.effects import Effects

from .conftest import CENTER
from .mouse import Mouse

ALONG_X = np.array([0.0, 0.0, 1.0])


@pytest.fixture
def begun(seeded, with_image, spin, endless):
    """A widget with a fit that runs, and is shown."""
    with_image.dims.set_point(0, CENTER[0] + 1)
    seeded.start()
    spin(lambda: seeded.link.mesh is not None and len(seeded.run.history.loss) > 3)
    return seeded


@pytest.fixture
def ended(begun, spin):
    begun.stop()
    spin(lambda: not begun.run.running)
    return begun


def vertices(widget):
    return widget.link.shown.vertices_numpy()


def use(widget, tool, radius=0.8):
    widget.running.edit.use(tool)
    widget.running.edit.radius.setValue(radius)
    return Mouse(widget.link.viewer, widget.link)


def right_end(widget):
    """The point of the mesh that lies farthest along X in the slice through its centre."""
    v = vertices(widget)
    return np.array([CENTER[0], CENTER[1], v[:, 2].max()])


def notes(widget):
    return [m.note for m in widget.control.timeline.moments if m.note]


# ------------------------------------------------------------------------------------- sculpting


def test_nudging_in_a_slice_moves_the_result(ended):
    mouse, place = use(ended, "nudge"), right_end(ended)
    before = vertices(ended)
    assert mouse.drag(place, place + 0.2 * ALONG_X, place + 0.5 * ALONG_X)
    moved = vertices(ended) - before
    assert moved[:, 2].max() == pytest.approx(0.5, abs=0.1)
    assert np.abs(moved[:, :2]).max() == 0
    far = before[:, 2] < CENTER[2]
    assert (moved[far] == 0).all()
    state = ended.results.last[0]
    np.testing.assert_array_equal(state.mesh.vertices_numpy(), vertices(ended))
    assert state.rendered().shape == ended.results.last[1].image.shape
    assert "nudge" in notes(ended)


def test_pushing_in_3d_moves_out_and_with_shift_in(ended, with_image):
    with_image.dims.ndisplay = 3
    ended.link.surface.visible = True
    mouse = use(ended, "push")
    before = vertices(ended)
    in_front = np.array([CENTER[0], CENTER[1], CENTER[2] - 9])
    assert mouse.drag(in_front)
    low = vertices(ended)[:, 2].min()
    assert low < before[:, 2].min() - 0.05
    assert mouse.drag(in_front, shift=True)
    assert vertices(ended)[:, 2].min() > low + 0.05
    # The far side stays.
    assert vertices(ended)[:, 2].max() == before[:, 2].max()


def test_nudging_in_3d_follows_the_plane_of_the_view(ended, with_image):
    with_image.dims.ndisplay = 3
    mouse = use(ended, "nudge")
    before = vertices(ended)
    start = np.array([CENTER[0], CENTER[1], -5.0])
    assert mouse.drag(start, start + np.array([0.3, 0.0, 4.0]))  # the 4 um are depth
    moved = vertices(ended) - before
    assert moved[:, 0].max() == pytest.approx(0.3, abs=0.05)
    assert np.abs(moved[:, 1:]).max() < 1e-9


def test_a_mouse_that_misses_moves_the_view(ended):
    mouse, before = use(ended, "push", 0.3), vertices(ended)
    assert not mouse.drag(CENTER + 3 * ALONG_X, CENTER + 0.5 * ALONG_X)
    np.testing.assert_array_equal(vertices(ended), before)
    assert not ended.interaction.edits.undo_note


def test_a_hidden_surface_is_not_touched(ended, with_image):
    mouse, before = use(ended, "push"), vertices(ended)
    with_image.layers["cell contours"].visible = False
    assert not mouse.drag(right_end(ended))
    assert "hidden" in ended.running.edit.hint.text()
    np.testing.assert_array_equal(vertices(ended), before)
    del with_image.layers["cell contours"]
    assert not mouse.drag(right_end(ended))


def test_without_a_tool_nothing_listens(ended, with_image):
    n = len(with_image.mouse_drag_callbacks)
    use(ended, "push")
    assert len(with_image.mouse_drag_callbacks) == n + 1
    ended.seeds.place.click()  # clicks are for seeds now
    assert ended.running.edit.tool is None
    assert len(with_image.mouse_drag_callbacks) == n
    use(ended, "pin")
    ended.close_links()
    assert ended.interaction.sculptor._callback not in with_image.mouse_drag_callbacks


def test_the_fit_goes_on_from_a_nudge(begun, spin):
    mouse, place = use(begun, "nudge"), right_end(begun)
    n = len(begun.run.history.loss)
    mouse.press(place)
    mouse.move(place + 0.6 * ALONG_X)
    held = vertices(begun)
    spin(lambda: len(begun.run.history.loss) > n + 5)
    # While the mouse is down the surface under it stands still.
    np.testing.assert_array_equal(vertices(begun), held)
    mouse.release(place + 0.6 * ALONG_X)
    spin(lambda: "nudge" in notes(begun))
    assert "nudge from iteration" in begun.running.note.text()
    moment = next(m for m in begun.control.timeline.moments if m.note == "nudge")
    assert moment.mesh.vertices_numpy()[:, 2].max() > held[:, 2].max() - 0.25
    shown = begun.link.shown
    spin(lambda: begun.link.shown is not shown)
    assert begun.run.running


def test_a_paused_fit_shows_a_change_at_once(begun, spin):
    begun.running.pause_button.click()
    spin(seconds=0.2, must=False)
    mouse, place = use(begun, "nudge"), right_end(begun)
    n, before = len(begun.run.history.loss), vertices(begun)
    mouse.drag(place, place + 0.6 * ALONG_X)
    spin(lambda: "nudge" in notes(begun))
    spin(seconds=0.1, must=False)
    assert len(begun.run.history.loss) == n + 1
    moved = vertices(begun) - before
    assert moved[:, 2].max() == pytest.approx(0.6, abs=0.15)
    assert begun.run.paused


def test_pinned_vertices_stay(begun, with_image, spin):
    begun.running.pause_button.click()
    spin(seconds=0.2, must=False)
    mouse, place = use(begun, "nudge"), right_end(begun)
    mouse.drag(place, place + 0.6 * ALONG_X)
    spin(lambda: "nudge" in notes(begun))
    mouse = use(begun, "pin", 0.4)
    mouse.drag(right_end(begun))
    pinned = begun.interaction.edits.pinned
    assert 0 < pinned.sum() < len(pinned) / 2
    held = vertices(begun)[pinned]
    begun.running.pause_button.click()
    n = len(begun.run.history.loss)
    spin(lambda: len(begun.run.history.loss) > n + 20)
    np.testing.assert_array_equal(vertices(begun)[pinned], held)
    marks = with_image.layers["cell pinned"]
    assert len(marks.data) == pinned.sum()
    assert begun.running.edit.pins.text().startswith(f"Free {pinned.sum()} pinned")
    begun.running.edit.pins.click()
    assert len(marks.data) == 0
    spin(lambda: not np.array_equal(vertices(begun)[pinned], held))


def test_pins_outlast_the_fit_and_the_next_one(ended, spin):
    use(ended, "pin", 0.4).drag(right_end(ended))
    pinned = ended.interaction.edits.pinned.copy()
    held = vertices(ended)[pinned]
    ended.running.history.go_on_button.click()
    spin(lambda: ended.run.running and len(ended.run.history.loss) > 20)
    np.testing.assert_array_equal(vertices(ended)[pinned], held)
    ended.stop()
    spin(lambda: not ended.run.running)
    use(ended, "pin", 3.0).drag(right_end(ended), shift=True)
    assert not ended.interaction.edits.pinned.any()


def test_a_change_that_comes_too_late_changes_the_result(begun, spin):
    begun.running.pause_button.click()
    spin(seconds=0.2, must=False)
    begun.stop()  # the thread has ended, and has not told yet
    shift = np.zeros_like(vertices(begun))
    shift[:, 1] = 0.25
    before = begun.run.state.mesh.vertices_numpy()
    begun.interaction.edits.shift(shift, "nudge")
    spin(lambda: not begun.run.running)
    np.testing.assert_allclose(vertices(begun), before + shift)


def test_there_is_nothing_to_sculpt_before_a_fit(seeded):
    with pytest.raises(InputError, match="run a fit first"):
        seeded.interaction.edits.shift(np.zeros((3, 3)), "nudge")


# -------------------------------------------------------------------------------- live settings


def test_settings_are_taken_over(begun, spin):
    begun.settings.accuracy.setCurrentText("1e-4")
    begun.settings.accuracy.lineEdit().editingFinished.emit()
    spin(lambda: begun.run.job.settings.fit.accuracy == 1e-4)
    spin(lambda: "accuracy" in begun.running.note.text())
    assert begun.running.note.text().startswith("accuracy 1e-4 from iteration")
    begun.settings.fit_psf.setChecked(True)
    begun.settings.likelihood.setCurrentText("gaussian")
    spin(lambda: "likelihood gaussian" in " ".join(notes(begun)))
    fit_settings = begun.run.job.settings.fit
    assert (fit_settings.fit_psf, fit_settings.likelihood) == (True, "gaussian")
    begun.stop()
    spin(lambda: not begun.run.running)
    assert begun.results.last[1].settings.fit.accuracy == 1e-4


def test_the_psf_is_taken_over(begun, spin):
    begun.settings.sigma._boxes[0].setValue(0.5)
    spin(lambda: begun.run.state.optics.sigma_um[0] == pytest.approx(0.5))
    spin(lambda: begun.running.psf.shown("now")[0] == "0.500")
    spin(lambda: begun.running.sigmas.isVisibleTo(begun.running))


def test_effects_are_taken_over_and_taken_back(begun, spin):
    panel = begun.settings
    panel.show_effects(Effects.of("attenuation"))
    panel.changed.emit()
    spin(lambda: begun.run.state.effects.names == ("attenuation",))
    spin(lambda: "effects attenuation" in " ".join(notes(begun)))
    panel.effects.table.tick("pixel_integration")
    spin(lambda: begun.run.state.effects.names == ("pixel_integration", "attenuation"))
    assert begun.run.job.settings.scene.effects.names == ("pixel_integration", "attenuation")
    assert panel.effects_fold.title == "Effects: pixel integration, attenuation"
    for left in (("attenuation",), ()):
        begun.interaction.edits.undo()
        spin(lambda left=left: begun.run.state.effects.names == left)
        assert panel.scene_settings().effects.names == left


def test_what_cannot_be_used_is_told_and_the_fit_goes_on(begun, spin):
    begun.settings.accuracy.setCurrentText("much")
    begun.settings.accuracy.lineEdit().editingFinished.emit()
    assert "accuracy" in begun.running.note.text()
    n = len(begun.run.history.loss)
    spin(lambda: len(begun.run.history.loss) > n + 3)


def test_the_voxel_size_is_for_the_next_run(begun, spin):
    sigma = begun.run.state.optics.sigma_um
    begun.image.voxel_size._boxes[0].setValue(0.4)
    assert "voxel size: from the next run on" in begun.running.note.text()
    n = len(begun.run.history.loss)
    spin(lambda: len(begun.run.history.loss) > n + 3)
    assert begun.run.state.optics.sigma_um == sigma


def test_another_image_is_for_the_next_run(begun, with_image, pixels, spin):
    begun.image.chooser.choose(with_image.add_image(pixels.max() - pixels, name="other"))
    assert "goes on with 'cell'; the next run takes 'other'" in begun.running.note.text()
    n = len(begun.run.history.loss)
    spin(lambda: len(begun.run.history.loss) > n + 3)
    assert begun.link.image_layer.name == "cell"


def test_a_tool_that_fails_says_why_and_keeps_the_verdict(ended, told):
    verdict = ended.running.verdict.text()
    edits = ended.interaction.edits
    ended.control.tried(lambda: edits.shift(np.full_like(vertices(ended), 500.0), "nudge"))
    assert "outside the image" in told[-1]
    assert "outside the image" in ended.running.note.text()
    assert ended.running.verdict.text() == verdict
    assert not edits.undo_note


def test_a_change_that_the_fit_refuses_does_not_end_it(begun, spin, told):
    away = begun.link.mesh.translated((500, 500, 500))
    with pytest.raises(InputError, match="outside"):
        begun.interaction.edits.change(Change(mesh=away), "nudge")
    begun.run.change(Change(mesh=away))  # past the first check
    spin(lambda: bool(told))
    assert "not changed" in told[-1]
    n = len(begun.run.history.loss)
    spin(lambda: len(begun.run.history.loss) > n + 3)


# ----------------------------------------------------------------------------- history and undo


def test_looking_back_while_the_fit_goes_on(begun, spin):
    spin(lambda: len(begun.control.timeline.moments) > 8)
    bar = begun.running.history
    bar.slider.setValue(1)
    moment = bar.chosen
    assert begun.link.shown is moment.mesh
    assert f"iteration {moment.iteration}" in bar.note.text()
    n = len(begun.run.history.loss)
    spin(lambda: len(begun.run.history.loss) > n + 10)
    assert begun.link.shown is moment.mesh
    assert bar.chosen is moment
    assert not use(begun, "push").drag(right_end(begun))  # that is not the present surface
    bar.live_button.click()
    assert begun.link.shown is begun.link.mesh is not moment.mesh


def test_going_on_from_an_earlier_moment(begun, spin):
    spin(lambda: len(begun.control.timeline.moments) > 8)
    bar = begun.running.history
    bar.slider.setValue(0)
    first = bar.chosen.mesh.vertices_numpy()
    bar.go_on_button.click()
    spin(lambda: "back to iteration 1" in notes(begun))
    moment = next(m for m in begun.control.timeline.moments if m.note)
    np.testing.assert_array_equal(moment.mesh.vertices_numpy(), first)
    assert bar.chosen is None
    assert begun.link.shown is begun.link.mesh
    begun.running.pause_button.click()
    spin(seconds=0.2, must=False)
    bar.undo_button.click()
    spin(lambda: notes(begun)[-1].startswith("undo"))
    assert not np.array_equal(vertices(begun), first)


def test_a_fit_that_has_ended_goes_on_from_a_moment(ended, spin):
    bar, timeline = ended.running.history, ended.control.timeline
    bar.slider.setValue(0)
    first, n = bar.chosen.mesh.vertices_numpy(), timeline.moments[-1].iteration
    bar.go_on_button.click()
    spin(lambda: ended.run.running and len(ended.run.history.loss) > 3)
    assert ended.run.job.settings.fit.levels[0] < 2
    spin(lambda: timeline.moments[-1].iteration > n)
    later = next(m for m in timeline.moments if m.iteration > n)
    assert np.abs(later.mesh.vertices_numpy() - first).max() < 0.5
    ended.stop()
    spin(lambda: not ended.run.running)
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
    assert not ended.interaction.edits.pinned.any()
    bar.undo_button.click()
    np.testing.assert_array_equal(vertices(ended), start)
    assert not bar.undo_button.isEnabled()
    bar.redo_button.click()
    np.testing.assert_array_equal(vertices(ended), pushed)
    bar.redo_button.click()
    assert ended.interaction.edits.pinned.any()
    assert not bar.redo_button.isEnabled()


def test_undo_of_settings_shows_them_again(begun, spin):
    before = begun.settings.fit_settings().density
    begun.settings.density.setCurrentText("smooth")
    spin(lambda: begun.run.job.settings.fit.density == "smooth")
    begun.running.history.undo_button.click()
    spin(lambda: begun.run.job.settings.fit.density == before)
    assert begun.settings.density.currentText() == before
    assert begun.interaction.edits.redo_note == "density smooth"


def test_a_new_run_forgets_the_old_one(ended, spin):
    use(ended, "pin", 0.4).drag(right_end(ended))
    old = ended.control.timeline
    ended.start()
    spin(lambda: ended.control.timeline is not old)
    assert not ended.interaction.edits.pinned.any()
    assert not ended.interaction.edits.undo_note


def test_a_failed_start_keeps_the_last_result(ended, with_image, spin, told):
    timeline, state = ended.control.timeline, ended.results.last[0]
    with_image.layers["seeds"].data = [[50, 50, 50]]
    ended.seeds.shape.setCurrentIndex(0)
    ended.start()
    spin(lambda: not ended.run.running)
    assert ended.control.timeline is timeline
    assert ended.results.last[0] is state
    use(ended, "push").drag(right_end(ended))
    assert notes(ended)[-1] == "push"


# ------------------------------------------------------------------------------------- progress


def test_remaining_time_is_told_where_it_is_known(begun, spin):
    spin(lambda: begun.running.message.text().endswith("left"))
    begun.stop()
    spin(lambda: not begun.run.running)
    for left, text in ((42.0, "about 42 s left"), (None, "a second")):
        begun.control._forecaster = lambda job, left=left: SimpleNamespace(
            remaining_seconds=lambda history, state, elapsed: left
        )
        begun.start()
        spin(lambda text=text: begun.running.message.text().endswith(text))
        begun.stop()
        spin(lambda: not begun.run.running)
    assert "left" not in progress_text(10, 3.0, None)
    assert progress_text(10, 0.25, None).endswith("0.2 a second")
    assert [duration(s) for s in (1, 20, 100, 4000, 9000)] == [
        "a second",
        "about 20 s",
        "about 2 min",
        "about 67 min",
        "about 2 h",
    ]


# ------------------------------------------------------------------------------------- overlays


def test_the_rendered_image_follows_the_result(ended, with_image, spin):
    ended.running.rendered.setChecked(True)
    spin(lambda: "cell rendered" in with_image.layers)
    layer = with_image.layers["cell rendered"]
    assert layer.visible
    before = layer.data.copy()
    use(ended, "push").drag(right_end(ended))
    spin(lambda: not np.array_equal(layer.data, before))
    np.testing.assert_allclose(layer.data, ended.results.last[0].rendered())
    ended.running.rendered.setChecked(False)
    assert not layer.visible


def test_a_surface_that_was_hidden_is_the_newest_when_it_is_shown(begun, with_image, spin):
    layer = begun.link.surface
    assert not layer.visible
    n = len(begun.run.history.loss)
    spin(lambda: len(begun.run.history.loss) > n + 10)
    begun.running.pause_button.click()
    spin(seconds=0.2, must=False)
    assert not np.allclose(layer.data[0], vertices(begun), atol=1e-4)  # saved the time
    with_image.dims.ndisplay = 3
    np.testing.assert_allclose(layer.data[0], vertices(begun), atol=1e-6)
