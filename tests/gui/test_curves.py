"""The plot of a fit shows what it gains, and says nothing that the grade does not."""

import pytest

from napari_deltamic.gui.document import Document
from napari_deltamic.gui.running.gain_curve import GainCurve
from napari_deltamic.results.timeline import Moment, Timeline

LOSS, LEVEL = [0.5, 0.3, 0.2, 0.6, 0.4], [1, 1, 1, 2, 2]


def test_each_level_is_a_line_of_what_is_gained(app):
    curve = GainCurve()
    curve.show_losses(LOSS, LEVEL, first=11)
    lines = curve.lines
    assert [line.x for line in lines] == [[11, 12, 13], [14, 15]]
    assert lines[0].y == pytest.approx([0, 20, 30])
    assert lines[1].y == pytest.approx([30, 50])
    for n in range(6):  # also before there is a line to draw
        curve.show_losses(LOSS[:n], LEVEL[:n])
        curve.resize(200, 90)
        curve.grab()


def test_where_voxels_are_weighed_anew_it_does_not_fall_but_where_the_user_changed_something(app):
    curve = GainCurve()
    curve.show_losses([0.4, 0.3, 0.35, 0.34], [1] * 4)
    assert curve.lines[0].y == pytest.approx([0, 10, 10, 11])
    curve.show_losses([0.4, 0.3, 0.35, 0.34], [1] * 4, changed={3})
    assert curve.lines[0].y == pytest.approx([0, 10, 5, 6])


def test_of_a_change_by_hand_no_loss_is_known(app):
    curve = GainCurve()
    curve.show_losses([0.4, float("nan"), 0.3], [1] * 3)
    assert curve.lines[0].x == [1, 3]
    assert curve.lines[0].y == pytest.approx([0, 10])


def test_the_history_tells_which_iteration_is_shown(make_widget, monkeypatch):
    bar, moments = (
        make_widget().running.history,
        [Moment(k, 0.4 - 0.1 * k, None, None) for k in (1, 2)],
    )
    monkeypatch.setattr(Document, "timeline", Timeline(moments))
    bar.update_moments()
    bar.slider.setValue(0)
    assert bar.note.text() == "iteration 1"
