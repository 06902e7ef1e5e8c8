"""The plot of a fit speaks of what is explained, and does not jump where a level begins."""

import pytest

from napari_deltamic.gui.document import Document
from napari_deltamic.gui.running.check_panel import ExplainedCurve
from napari_deltamic.results.timeline import Moment, Timeline


def test_each_level_is_a_line_of_what_is_explained(app):
    curve = ExplainedCurve()
    curve.show_losses([0.5, 0.3, 0.2, 0.6, 0.4], [1, 1, 1, 2, 2], first=11)
    lines = curve.lines
    assert [line.x for line in lines] == [[11, 12, 13], [14, 15]]
    assert curve.text == "60.0%"
    assert lines[0].y == pytest.approx([50, 70, 80])
    assert lines[1].y == pytest.approx([40, 60])
    for n in range(6):  # also before there is a line to draw
        curve.show_losses([0.5, 0.3, 0.2, 0.6, 0.4][:n], [1, 1, 1, 2, 2][:n])
        curve.resize(200, 90)
        curve.grab()


def test_the_history_tells_it_too(make_widget, monkeypatch):
    bar, moments = (
        make_widget().running.history,
        [Moment(k, 0.4 - 0.1 * k, None, None) for k in (1, 2)],
    )
    monkeypatch.setattr(Document, "timeline", Timeline(moments))
    bar.update_moments()
    bar.slider.setValue(0)
    assert bar.note.text() == "iteration 1, match 70.0%"
