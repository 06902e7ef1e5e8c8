"""Tracked cells in a session: what was tracked is there again, and goes on."""

import numpy as np
import pytest

from napari_deltamic.errors import InputError
from napari_deltamic.gui import fit_widget
from napari_deltamic.gui.results import session
from napari_deltamic.results.session_file import load_session, save_session
from napari_deltamic.results.track_report import read_results

from .test_tracking import ended


@pytest.fixture
def widget(series_widget):
    return series_widget


@pytest.fixture
def slow(slow_tracking):
    return slow_tracking


@pytest.fixture
def reopened_here(app, viewer, spin, tmp_path):
    """Save a session, and show it in an empty viewer and a new widget."""
    made = []

    def reopened_here(widget):
        found, _ = session.capture(widget.parts)
        save_session(tmp_path / "a.deltamic", found)
        widget.close_links()
        viewer.layers.clear()
        other = fit_widget.FitWidget(viewer)
        made.append(other)
        list(session.restore(other.parts, load_session(tmp_path / "a.deltamic")))
        return other

    yield reopened_here
    for other in made:
        other.close_links()


def test_frames_come_back_as_they_were(widget, viewer, series, spin, reopened_here, tmp_path):
    widget.tracking.start()
    spin(ended(widget), 60)
    before = widget.tracking.results
    surface = viewer.layers["movie: tracked surfaces"].data
    paths = viewer.layers["movie: tracks"].data
    viewer.dims.set_current_step(0, 1)
    other = reopened_here(widget)
    for old, new in zip(before, other.tracking.results, strict=True):
        assert (old.frame, old.time, old.loss, old.sigma_um) == (
            (new.frame, new.time, new.loss, new.sigma_um)
        )
        np.testing.assert_array_equal(old.mesh.vertices, new.mesh.vertices)
    np.testing.assert_array_equal(viewer.layers["movie"].data, series)
    assert tuple(viewer.layers["movie"].scale) == (5, 0.3, 0.2, 0.2)
    for part, again in zip(surface, viewer.layers["movie: tracked surfaces"].data, strict=True):
        np.testing.assert_array_equal(part, again)
    np.testing.assert_array_equal(viewer.layers["movie: tracks"].data, paths)
    assert viewer.dims.current_step[0] == 1
    assert other.tracking.frame.text().startswith("time 1: 1 cell")
    assert "4 time points tracked" in other.tracking.verdict.text()
    other.tracking.save(str(tmp_path))
    assert [r.frame for r in read_results(tmp_path)] == [0, 1, 2, 3]


def test_what_was_stopped_goes_on_after_reopening(widget, spin, slow, reopened_here):
    widget.tracking.start()
    slow += [1, 1]
    spin(lambda: len(widget.tracking.results) == 2, 60)
    widget.footer.stop_button.click()
    spin(ended(widget))
    other = reopened_here(widget)
    assert other.tracking.go_on_button.isVisibleTo(other.tracking)
    slow += [1] * 4
    other.tracking.go_on_button.click()
    spin(ended(other), 60)
    assert [r.frame for r in other.tracking.results] == [0, 1, 2, 3]
    assert other.tracking.verdict.text().startswith("4 time points tracked")


@pytest.mark.slow
@pytest.mark.usefixtures("judged")
def test_a_fit_of_one_time_comes_back_at_its_time(widget, viewer, spin, reopened_here):
    viewer.dims.set_current_step(0, 2)
    widget.tracking.start()
    spin(ended(widget), 60)
    viewer.dims.set_current_step(0, 1)
    widget.settings.max_iterations.setValue(3)
    widget.doc.look("rendered")
    widget.start()
    spin(lambda: widget.doc.run is not None and not widget.doc.run.running, 60)
    viewer.dims.set_current_step(0, 3)
    other = reopened_here(widget)
    spin(lambda: other.doc.result.judged is not None, 60)
    assert other.doc.link.time == (1,)
    assert viewer.dims.current_step[0] == 3
    assert "movie: rendered" not in viewer.layers  # made when it is first looked at
    viewer.dims.set_current_step(0, 1)
    assert viewer.layers["movie: rendered"].visible


def test_no_session_is_opened_while_cells_are_tracked(widget, spin, slow):
    found, _ = session.capture(widget.parts)
    widget.tracking.start()
    with pytest.raises(InputError, match="being tracked"):
        list(session.restore(widget.parts, found))
    widget.stop()


def test_the_rendered_image_is_there_at_its_time_only(widget, viewer, spin):
    viewer.dims.set_current_step(0, 1)
    widget.settings.max_iterations.setValue(3)
    widget.doc.look("rendered")
    widget.start()
    spin(lambda: widget.doc.run is not None and not widget.doc.run.running, 60)
    spin(lambda: widget.doc.link.rendered is not None)
    rendered = viewer.layers["movie: rendered"]
    assert rendered.visible
    viewer.dims.set_current_step(0, 2)
    assert not rendered.visible
    widget.doc.look("image")
    viewer.dims.set_current_step(0, 1)
    assert not rendered.visible
    widget.doc.look("rendered")
    assert rendered.visible


@pytest.mark.slow
def test_frames_of_a_region_come_back_where_they_were(widget, viewer, series, spin, reopened_here):
    """With the voxels of the region, and none of those around it."""
    widget.doc.image.take_region(((0, 20), (2, 23), (1, 24)))
    widget.tracking.start()
    spin(ended(widget), 60)
    vertices = viewer.layers["movie: tracked surfaces"].data[0]
    place = viewer.layers["movie: tracked surfaces"].translate
    other = reopened_here(widget)
    again = viewer.layers["movie: tracked surfaces"]
    np.testing.assert_array_equal(again.data[0], vertices)
    np.testing.assert_allclose(again.translate, place)
    image = viewer.layers["movie"]
    np.testing.assert_array_equal(image.data, series[:, :, 2:23, 1:24])
    np.testing.assert_allclose(image.translate, (0, 1, 2 + 2 * 0.2, 3 + 0.2))
    assert other.tracking.work.job.image.shape == (20, 21, 23)


@pytest.mark.slow
def test_tracks_of_another_region_are_not_saved(widget, spin):
    widget.tracking.start()
    spin(ended(widget), 60)
    widget.doc.image.take_region(((0, 20), (2, 23), (1, 24)))
    found, left_out = session.capture(widget.parts)
    assert found.tracks is None
    assert left_out.startswith("the tracks are of another image or region")
