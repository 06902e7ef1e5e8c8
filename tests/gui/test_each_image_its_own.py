"""Two images are fitted: undo, grade and contours belong to one of them each."""

import numpy as np
import pytest

from napari_deltamic.gui.running import footer

from .conftest import SIZE
from .sessions import done


@pytest.fixture
def both(seeded, with_image, pixels, spin):
    """A widget with results of two images; the second one is chosen."""
    with_image.add_image(
        pixels[:, ::-1], name="other", scale=SIZE, translate=(1, 2, 3), units=("um",) * 3
    )
    seeded.settings.max_iterations.setValue(3)
    for name in ("cell", "other"):
        choose(seeded, name)
        seeded.start()
        spin(done(seeded))
    return seeded


def choose(widget, name):
    widget.doc.image.choose(widget.doc.viewer.layers[name])


def nudge(widget):
    mesh = widget.doc.present().state.mesh
    shift = np.zeros((len(mesh.vertices), 3))
    shift[:20] = 0.2
    widget.edits.shift(shift, "nudge", mesh)


def test_what_was_done_to_another_image_is_not_undone_in_this_one(both):
    choose(both, "cell")
    nudge(both)
    changed = both.doc.result.state.mesh
    choose(both, "other")
    mesh, history = both.doc.result.state.mesh, both.running.history
    assert (both.edits.undo_note, history.undo_button.isEnabled()) == ("", False)
    both.edits.undo()
    assert both.doc.result.state.mesh is mesh
    choose(both, "cell")
    assert history.undo_button.isEnabled()
    history.undo_button.click()
    assert both.doc.result.state.mesh is not changed
    choose(both, "other")
    assert not history.redo_button.isEnabled()


def test_a_result_that_was_changed_can_be_had_back_after_a_fit_of_another_image(both, spin):
    choose(both, "cell")
    fitted = both.doc.result.state.mesh
    nudge(both)
    choose(both, "other")
    both.start()
    spin(done(both))
    choose(both, "cell")
    assert both.doc.result.by_hand
    both.running.history.undo_button.click()
    assert both.doc.result.state.mesh is fitted
    assert not both.doc.result.by_hand


def test_undo_goes_with_its_image_and_with_a_new_fit_of_it(both, with_image, spin):
    choose(both, "cell")
    nudge(both)
    both.start()
    spin(done(both))
    assert not both.edits.undo_note
    nudge(both)
    with_image.layers.remove("cell")
    with_image.layers.remove("other")
    assert not both.edits.undo_note
    assert not both.running.history.undo_button.isEnabled()


@pytest.mark.usefixtures("judged")
def test_a_fit_that_ends_while_another_image_is_chosen_is_judged_when_its_own_is(
    seeded, with_image, pixels, spin
):
    with_image.add_image(pixels, name="other", scale=SIZE, translate=(1, 2, 3), units=("um",) * 3)
    choose(seeded, "cell")
    seeded.settings.max_iterations.setValue(3)
    seeded.start()
    choose(seeded, "other")
    spin(done(seeded))
    spin(lambda: not seeded.judging.background.busy)
    assert seeded.running.grade.isHidden()
    choose(seeded, "cell")
    spin(lambda: not seeded.judging.background.busy)
    assert seeded.doc.result.judged is not None
    assert not seeded.running.grade.isHidden()


def test_contours_are_seen_with_their_image_alone(both, with_image):
    cell, other = (with_image.layers[f"{name}: contours"] for name in ("cell", "other"))
    assert [cell.visible, other.visible] == [False, True]
    choose(both, "cell")
    assert [cell.visible, other.visible] == [True, False]
    other.visible = True  # the user wants to compare them
    choose(both, "other")
    assert [cell.visible, other.visible] == [False, True]
    other.visible = False  # nor is what was hidden shown again
    choose(both, "cell")
    choose(both, "other")
    assert not other.visible


def test_surfaces_are_seen_with_their_image_alone(both, with_image):
    with_image.dims.ndisplay = 3
    cell, other = (with_image.layers[f"{name}: surfaces"] for name in ("cell", "other"))
    assert [cell.visible, other.visible] == [False, True]
    choose(both, "cell")
    assert [cell.visible, other.visible] == [True, False]


def test_contours_that_were_hidden_are_those_of_the_slice_once_they_are_shown(both, with_image):
    layer = with_image.layers["other: contours"]
    layer.visible = False
    with_image.dims.set_point(0, 3.4)
    nudge(both)
    layer.visible = True
    assert layer.data[:, 0, 0] == pytest.approx(2.4, abs=0.2)


def test_the_fit_of_another_image_is_not_shown_as_that_of_the_one_chosen(
    begun, with_image, pixels, spin, monkeypatch
):
    with_image.add_image(pixels, name="other", scale=SIZE, translate=(1, 2, 3), units=("um",) * 3)
    running, told = begun.running, begun.footer.message
    begun.running.edit.use("push")
    assert running.title() == "4  Check"
    choose(begun, "other")
    assert running.title() == "4  Check: fit of 'cell'"
    for part in (running.edit, running.history, running.view):
        assert not part.isVisibleTo(running)
    assert running.edit.tool is None
    assert not with_image.layers["cell: contours"].visible
    spin(lambda: told.text().startswith("Fit of 'cell': "))
    monkeypatch.setattr(footer, "_LONG", 0.0)
    assert running.note.text().startswith("the fit goes on with 'cell'")
    choose(begun, "cell")
    assert running.title() == "4  Check"
    assert running.note.text() == ""
    assert not running.edit.isHidden()
    spin(lambda: told.text() and not told.text().startswith("Fit of"))


def test_a_result_that_is_shown_while_another_image_is_chosen_says_so(
    both, with_image, spin, endless
):
    choose(both, "cell")
    both.start()
    spin(lambda: both.doc.begun)
    assert both.results.title() == "5  Results"
    assert both.results.valid_for.text().startswith("Of the fit before")
    choose(both, "other")
    assert both.results.title() == "5  Results of 'cell'"
    both.stop()
    spin(done(both))
    assert both.results.title() == "5  Results"
    assert both.results.valid_for.isHidden()
