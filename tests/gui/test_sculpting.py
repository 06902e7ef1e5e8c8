"""The surface changed with the mouse: while a fit runs, while it is paused, and after its end."""

import numpy as np
import pytest

from napari_deltamic.errors import InputError

from .conftest import CENTER
from .interacting import ALONG_X, notes, pause, right_end, use, vertices, went_on


def test_nudging_in_a_slice_moves_the_result(ended):
    mouse, place = use(ended, "nudge"), right_end(ended)
    before = vertices(ended)
    assert mouse.drag(place, place + 0.2 * ALONG_X, place + 0.5 * ALONG_X)
    moved = vertices(ended) - before
    assert moved[:, 2].max() == pytest.approx(0.5, abs=0.1)
    assert np.abs(moved[:, :2]).max() == 0
    far = before[:, 2] < CENTER[2]
    assert (moved[far] == 0).all()
    state = ended.doc.result.state
    np.testing.assert_array_equal(state.mesh.vertices_numpy(), vertices(ended))
    assert state.rendered().shape == ended.doc.result.job.image.shape
    assert "nudge" in notes(ended)


def test_pushing_in_3d_moves_out_and_with_shift_in(ended, with_image):
    with_image.dims.ndisplay = 3
    ended.doc.link.surface.visible = True
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
    assert not ended.edits.undo_note


def test_a_hidden_surface_is_not_touched(ended, with_image):
    mouse, before = use(ended, "push"), vertices(ended)
    with_image.layers["cell: contours"].visible = False
    assert not mouse.drag(right_end(ended))
    assert "hidden" in ended.running.edit.hint.text()
    np.testing.assert_array_equal(vertices(ended), before)
    del with_image.layers["cell: contours"]
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
    assert ended.running.edit.presses.callback not in with_image.mouse_drag_callbacks


def test_the_fit_goes_on_from_a_nudge(begun, spin):
    mouse, place = use(begun, "nudge"), right_end(begun)
    n = len(begun.doc.run.history.loss)
    mouse.press(place)
    mouse.move(place + 0.6 * ALONG_X)
    held = vertices(begun)
    spin(lambda: len(begun.doc.run.history.loss) > n + 5)
    # While the mouse is down the surface under it stands still.
    np.testing.assert_array_equal(vertices(begun), held)
    mouse.release(place + 0.6 * ALONG_X)
    spin(lambda: "nudge" in notes(begun))
    assert "nudge from iteration" in begun.running.note.text()
    moment = next(m for m in begun.doc.timeline.moments if m.note == "nudge")
    assert moment.mesh.vertices_numpy()[:, 2].max() > held[:, 2].max() - 0.25
    shown = begun.doc.link.shown
    spin(lambda: begun.doc.link.shown is not shown)
    assert begun.doc.run.running


def test_a_paused_fit_shows_a_change_at_once(begun, spin):
    pause(begun, spin)
    mouse, place = use(begun, "nudge"), right_end(begun)
    n, before = len(begun.doc.run.history.loss), vertices(begun)
    mouse.drag(place, place + 0.6 * ALONG_X)
    spin(lambda: "nudge" in notes(begun))
    spin(seconds=0.1, must=False)
    assert len(begun.doc.run.history.loss) == n + 1
    # The bump is more curved, so there may be more vertices.
    assert vertices(begun)[:, 2].max() - before[:, 2].max() == pytest.approx(0.6, abs=0.15)
    assert begun.doc.run.paused


@pytest.mark.slow
def test_pinned_vertices_stay(begun, with_image, spin):
    pause(begun, spin)
    mouse, place = use(begun, "nudge"), right_end(begun)
    mouse.drag(place, place + 0.6 * ALONG_X)
    spin(lambda: "nudge" in notes(begun))
    mouse = use(begun, "pin", 0.4)
    mouse.drag(right_end(begun))
    pinned = begun.edits.pinned
    assert 0 < pinned.sum() < len(pinned) / 2
    held = vertices(begun)[pinned]
    begun.footer.pause_button.click()
    n = len(begun.doc.run.history.loss)
    spin(lambda: len(begun.doc.run.history.loss) > n + 20)
    pause(begun, spin)  # what is shown lags behind the newest state of a fit that runs
    pinned = begun.edits.pinned  # of other vertices, where the surface was remeshed meanwhile
    now = vertices(begun)[pinned]
    assert np.abs(now[:, None] - held).max(axis=2).min(axis=0).max() < 1e-5
    marks = with_image.layers["cell: pinned"]
    assert len(marks.data) == pinned.sum()
    assert begun.running.edit.pins.text().startswith(f"Free {pinned.sum()} pinned")
    begun.running.edit.pins.click()
    assert len(marks.data) == 0

    def moved():
        shown = vertices(begun)  # which may have been remeshed meanwhile
        return len(shown) != len(pinned) or not np.array_equal(shown[pinned], now)

    begun.footer.pause_button.click()
    spin(moved)


@pytest.mark.slow
def test_pins_outlast_the_fit_and_the_next_one(ended, spin):
    use(ended, "pin", 0.4).drag(right_end(ended))
    pinned = ended.edits.pinned.copy()
    held = vertices(ended)[pinned]
    ended.running.history.go_on_button.click()
    spin(went_on(ended, 20))
    np.testing.assert_array_equal(vertices(ended)[pinned], held)
    ended.stop()
    spin(lambda: not ended.doc.run.running)
    use(ended, "pin", 3.0).drag(right_end(ended), shift=True)
    assert not ended.edits.pinned.any()


def test_a_change_that_comes_too_late_changes_the_result(begun, spin):
    pause(begun, spin)
    begun.stop()  # the thread has ended, and has not told yet
    shift = np.zeros_like(vertices(begun))
    shift[:, 1] = 0.25
    before = begun.doc.run.state.mesh.vertices_numpy()
    begun.edits.shift(shift, "nudge")
    spin(lambda: not begun.doc.run.running)
    np.testing.assert_allclose(vertices(begun), before + shift)


def test_there_is_nothing_to_sculpt_before_a_fit(seeded):
    with pytest.raises(InputError, match="run a fit first"):
        seeded.edits.shift(np.zeros((3, 3)), "nudge")
