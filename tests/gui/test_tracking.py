"""Tracking in the widget: a series of stacks becomes a surface over time."""

import gc
import weakref
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from vispy.color import Colormap

from napari_deltamic._writer import write_surface
from napari_deltamic.errors import InputError
from napari_deltamic.gui.tracking import panel, track_work
from napari_deltamic.gui.viewing.colours import region_colours
from napari_deltamic.gui.viewing.frame import OWN, camera_of
from napari_deltamic.results import judged as judged_results
from napari_deltamic.results.track_report import read_results
from napari_deltamic.tracking import FrameResult, track

from .conftest import CENTER, SIZE, STEP


@pytest.fixture
def widget(series_widget):
    return series_widget


@pytest.fixture
def slow(slow_tracking):
    return slow_tracking


def ended(widget):
    return lambda: widget.tracking.work is not None and not widget.tracking.work.running


def test_the_panel_is_there_for_images_over_time_only(make_widget, with_image, series):
    widget = make_widget()
    assert widget.tracking.isHidden()
    with_image.add_image(series, scale=(1, *SIZE), name="movie")
    chooser = widget.image.chooser
    chooser.setCurrentIndex(chooser.findText("movie"))
    assert not widget.tracking.isHidden()


def test_one_click_gives_a_surface_over_time(widget, viewer, series, spin):
    widget.tracking.track_button.click()
    spin(ended(widget), 60)
    assert "4 time points tracked" in widget.tracking.verdict.text()
    surface = viewer.layers["movie: tracked surfaces"]
    vertices, _, values = surface.data
    assert tuple(surface.scale) == (5, 1, 1, 1)
    assert tuple(surface.translate) == (0, 1, 2, 3)
    for t in range(4):
        own = vertices[vertices[:, 0] == t]
        np.testing.assert_allclose(own[:, 1:].mean(axis=0), CENTER + t * STEP, atol=0.08)
    np.testing.assert_array_equal(values, surface.metadata[OWN]["cells"])
    colours = surface.colormap  # of a single cell; as a canvas takes it
    drawn = Colormap(colours.colors, colours.controls, str(colours.interpolation.value))
    shown = drawn.map(np.array([[0.5]]))
    np.testing.assert_allclose(shown[0], region_colours(1), atol=1e-6)
    tracks = viewer.layers["movie: tracks"]
    assert tracks.data.shape == (4, 5)
    assert viewer.dims.current_step[0] == 3, "what is looked at moves on with the frames"
    assert widget.tracking.frame.text().startswith("time 3: 1 cell")
    assert widget.tracking.table.rowCount() == 1


def test_lengths_of_a_frame_are_in_the_units_of_the_window(widget, monkeypatch):
    result = SimpleNamespace(mesh=None, message="the surface still moves at (2.8, 5.6, 5.3) um")
    shown = SimpleNamespace(result=result, results=[result])
    with monkeypatch.context() as patched:
        patched.setattr(widget.tracking, "layers", shown)
        widget.tracking._show_frame()
    assert widget.tracking.frame.text().endswith(" µm")


def test_the_worst_frame_is_told_and_led_to(widget, viewer, spin, monkeypatch):
    def judged(done, *of_fit):
        moving = (2.9, 1.5, 3.2) if done.frame == 2 else None
        grade = "fair" if done.frame in (1, 2) else "good"
        return replace(done, grade=grade, judgement=f"{grade}, off by 30 nm", moving=moving)

    monkeypatch.setattr(judged_results, "judged_frame", judged)
    shown = widget.tracking
    shown.start()
    assert shown.worst_button.isHidden()
    spin(ended(widget), 60)
    assert shown.verdict.verdict == "fair"
    assert "4 time points tracked" in shown.verdict.text()
    assert shown.verdict.text().endswith("worst at time 2: fair, the surface still moves")
    assert shown.frame.text().startswith("time 3: 1 cell; good, off by 30 nm")
    shown.worst_button.click()
    assert viewer.dims.current_step[0] == 2
    np.testing.assert_allclose(camera_of(viewer).center, np.add((1, 2, 3), (2.9, 1.5, 3.2)))


@pytest.mark.slow
@pytest.mark.usefixtures("judged")
def test_each_frame_has_a_grade(widget, spin):
    widget.tracking.start()
    spin(ended(widget), 90)
    assert [r.grade for r in widget.tracking.results] == ["good"] * 4
    assert widget.tracking.verdict.verdict == "done"
    assert widget.tracking.worst_button.isHidden()


def test_the_frame_of_the_worst_grade_comes_before_one_that_moves():
    frames = [
        FrameResult(0, 0.0, None, grade="fair", moving=(0.0, 0.0, 0.0)),
        FrameResult(1, 1.0, None, grade="poor"),
        FrameResult(2, 2.0, None, moving=(0.0, 0.0, 0.0)),
        FrameResult(3, 3.0, None, grade="good"),
        FrameResult(4, 4.0, None),
    ]
    assert panel.worst_of(frames) is frames[1]
    assert panel.worst_of(frames[2:]) is frames[2]
    assert panel.worst_of(frames[3:]) is None
    assert panel.worst_of([]) is None


@pytest.mark.slow
def test_contours_and_table_follow_the_slider(widget, viewer, spin):
    widget.tracking.start()
    spin(ended(widget), 60)
    middle = {}
    for t in (0, 3):
        viewer.dims.set_point((0, 1), (5.0 * t, 1 + CENTER[0]))
        contours = viewer.layers["movie: tracked contours"].data
        assert len(contours) > 10
        middle[t] = contours[:, 0].mean(axis=0)
        assert widget.tracking.frame.text().startswith(f"time {t}")
    np.testing.assert_allclose((middle[3] - middle[0])[1:], 3 * STEP[1:], atol=0.1)


@pytest.mark.slow
def test_a_row_goes_to_its_cell_in_its_frame(widget, viewer, spin):
    widget.tracking.start()
    spin(ended(widget), 60)
    table = widget.tracking.table
    for t in (1, 3):
        viewer.dims.set_current_step(0, t)
        viewer.dims.set_point((1, 2, 3), (1, 2, 3))
        camera_of(viewer).center = (0, 0, 0)
        table.clearSelection()
        assert camera_of(viewer).center == (0, 0, 0), "nothing was chosen"
        table.selectRow(0)
        place = np.add((1, 2, 3), CENTER) + t * STEP
        assert viewer.dims.current_step[0] == t
        np.testing.assert_allclose(viewer.dims.point, (5 * t, *place), atol=0.2)
        np.testing.assert_allclose(camera_of(viewer).center, place, atol=0.1)
    widget.tracking.layers.go_to_frame(2, CENTER)
    assert viewer.dims.current_step[0] == 2


@pytest.mark.slow
def test_tracking_starts_at_the_frame_shown(widget, viewer, spin):
    viewer.dims.set_current_step(0, 2)
    widget.tracking.start()
    spin(ended(widget), 60)
    assert [r.frame for r in widget.tracking.results] == [2, 3]
    viewer.dims.set_current_step(0, 0)
    assert widget.tracking.frame.text() == "not tracked at this time"
    assert len(viewer.layers["movie: tracked contours"].data) == 0


@pytest.mark.slow
def test_stop_keeps_the_frames_that_are_done_and_go_on_tracks_the_rest(
    widget, viewer, spin, slow, tmp_path
):
    widget.tracking.start()
    assert not widget.footer.run_button.isEnabled()
    slow += [1, 1]
    spin(lambda: len(widget.tracking.results) == 2, 60)
    assert "of 4" in widget.footer.message.text()
    widget.footer.stop_button.click()
    spin(ended(widget))
    assert widget.tracking.verdict.text().startswith("stopped (2 time points kept")
    assert set(viewer.layers["movie: tracked surfaces"].data[0][:, 0]) == {0, 1}
    assert widget.footer.run_button.isEnabled()
    slow += [1] * 4
    assert widget.tracking.go_on_button.isVisibleTo(widget.tracking)
    widget.tracking.go_on_button.click()
    spin(ended(widget), 60)
    assert [r.frame for r in widget.tracking.results] == [0, 1, 2, 3]
    widget.tracking.save(str(tmp_path))
    assert [r.frame for r in read_results(tmp_path)] == [0, 1, 2, 3]


@pytest.mark.slow
def test_a_bad_frame_is_told_and_skipped(widget, viewer, spin, told):
    layer = viewer.layers["movie"]
    layer.data = np.where(np.arange(4).reshape(4, 1, 1, 1) == 1, np.nan, layer.data)
    widget.tracking.start()
    spin(ended(widget), 60)
    assert any("frame 1 skipped: every voxel is missing" in text for text in told)
    assert "1 of them skipped" in widget.tracking.verdict.text()
    viewer.dims.set_current_step(0, 1)
    assert "skipped" in widget.tracking.frame.text()


def test_what_is_missing_is_said(widget, viewer, told):
    viewer.dims.set_current_step(0, 3)
    widget.tracking.start()
    assert "last time point" in told[-1]
    viewer.dims.set_current_step(0, 0)
    viewer.layers["seeds"].data = np.zeros((0, 3))
    widget.tracking.start()
    assert "seeds" in told[-1]
    assert widget.tracking.work is None


def test_an_error_of_the_engine_is_told_in_words(widget, spin, monkeypatch, told):
    def broken(*arguments, **options):
        yield next(track(*arguments, **options))
        raise InputError("it cannot be")

    monkeypatch.setattr(judged_results, "track", broken)
    widget.tracking.start()
    spin(ended(widget))
    assert told[-1] == "it cannot be"
    assert widget.tracking.track_button.isEnabled()


def test_a_region_is_not_taken_for_all_of_its_file(widget, spin, monkeypatch):
    """Or run.toml would track something else."""
    monkeypatch.setattr(panel, "origin_of", lambda layer: ("/data/movie.tif", None))
    for box, path in ((None, "/data/movie.tif"), (((0, 20), (2, 23), (1, 24)), "")):
        widget.doc.image.take_region(box)
        widget.tracking.start()
        spin(lambda: widget.tracking.work.job is not None)
        assert widget.tracking.work.job.settings.image == path
        widget.stop()
        spin(ended(widget), 60)


@pytest.mark.slow
def test_a_second_run_replaces_the_layers_of_the_first(widget, viewer, spin):
    names = None
    for _ in range(2):
        viewer.dims.set_current_step(0, 2)
        widget.tracking.start()
        spin(ended(widget), 60)
        names = names or sorted(layer.name for layer in viewer.layers)
    assert sorted(layer.name for layer in viewer.layers) == names


def test_closing_ends_tracking_and_leaves_no_connection(widget, viewer, spin, slow):
    slow.append(1)
    widget.tracking.start()
    spin(lambda: widget.tracking.layers is not None)
    refs = [weakref.ref(widget.tracking.work), weakref.ref(widget.tracking.layers)]
    run = widget.tracking.work
    widget.close_links()
    assert not run.running
    widget.tracking.work = widget.tracking.layers = run = None
    spin(seconds=0.3, must=False)
    gc.collect()
    assert [ref() for ref in refs] == [None, None]
    viewer.dims.set_current_step(0, 1)


def test_the_surface_of_a_fit_is_there_at_its_time_only(widget, viewer, spin):
    viewer.dims.set_current_step(0, 1)
    viewer.dims.ndisplay = 3
    widget.start()
    spin(lambda: widget.doc.run is not None and not widget.doc.run.running, 60)
    surface = viewer.layers["movie: surfaces"]
    assert surface.visible
    viewer.dims.set_current_step(0, 2)
    assert not surface.visible
    viewer.dims.set_current_step(0, 1)
    assert surface.visible
    surface.visible = False  # by the user
    viewer.dims.set_current_step(0, 2)
    viewer.dims.set_current_step(0, 1)
    assert not surface.visible


@pytest.mark.slow
@pytest.mark.usefixtures("judged")
def test_a_result_tells_its_time_and_leads_back_to_it(widget, viewer, spin):
    viewer.dims.set_current_step(0, 1)
    widget.start()
    spin(lambda: bool(widget.running.grade.verdict), 60)
    check, results = widget.running, widget.results
    assert check.title() == "4  Check, time 1"
    assert results.title() == "5  Results, time 1"
    assert check.away_row.isHidden()
    viewer.dims.set_current_step(0, 3)
    assert not check.away_row.isHidden()
    assert check.away.text() == "This is of time 1, not of the time shown."
    check.away_go.click()
    assert viewer.dims.current_step[0] == 1
    assert check.away_row.isHidden()
    viewer.dims.set_current_step(0, 2)
    results.table.selectRow(0)
    assert viewer.dims.current_step[0] == 1, "a row goes to its cell, which is of one time"


def test_a_surface_of_several_times_is_no_mesh_file(tmp_path):
    vertices, faces = np.random.default_rng(0).random((6, 4)), [[0, 1, 2], [3, 4, 5]]
    vertices[:, 0] = [0, 0, 0, 1, 1, 1]
    with pytest.raises(InputError, match="several times"):
        write_surface(str(tmp_path / "a.ply"), (vertices, faces), {})
    vertices[:, 0] = 2
    assert write_surface(str(tmp_path / "a.ply"), (vertices, faces), {})


@pytest.mark.slow
def test_the_start_is_not_shown_again_over_what_was_tracked(widget, viewer, spin, soon):
    widget.seeds.shape.setCurrentText("the membrane")
    spin(lambda: any("start" in layer.name for layer in viewer.layers))
    widget.tracking.start()
    spin(ended(widget), 60)
    for t in (1, 3):
        viewer.dims.set_current_step(0, t)
        spin(seconds=0.5, must=False)
        assert not any("start" in layer.name for layer in viewer.layers)


@pytest.mark.slow
def test_what_is_tracked_stays_until_another_run_has_a_frame(widget, viewer, spin, slow, tmp_path):
    slow += [1, 1]
    widget.tracking.start()
    spin(lambda: len(widget.tracking.results) == 2, 60)
    widget.stop()
    spin(ended(widget))
    shown, surface = widget.tracking, viewer.layers["movie: tracked surfaces"]
    before = shown.verdict.text()
    viewer.dims.set_current_step(0, 0)
    slow.clear()
    for again in (shown.start, shown.go_on):
        again()
        assert len(shown.results) == 2
        assert surface in viewer.layers
        widget.stop()
        spin(ended(widget))
        assert shown.verdict.text() == before
        assert surface in viewer.layers
        assert shown.frame.text().startswith("time 0: 1 cell")
        assert shown.go_on_button.isVisibleTo(shown)
    shown.save(str(tmp_path))
    assert [r.frame for r in read_results(tmp_path)] == [0, 1]
    slow.append(1)
    shown.start()
    spin(lambda: len(shown.results) == 1, 60)
    assert surface not in viewer.layers
    assert shown.verdict.text() == ""


def test_which_times_are_left_out_is_said_before(widget, viewer):
    shown = widget.tracking
    assert shown.first.text() == ""
    viewer.dims.set_current_step(0, 1)
    assert "starts at time 1" in shown.first.text()
    assert "time 0 is left out" in shown.first.text()
    viewer.dims.set_current_step(0, 3)
    assert "times 0 to 2 are left out" in shown.first.text()
    shown.first_go.click()
    assert viewer.dims.current_step[0] == 0
    assert shown.first.text() == ""


def test_how_it_ended_says_which_times_were_tracked():
    results = [SimpleNamespace(frame=frame) for frame in range(3)]
    assert track_work.times_tracked(results[1:], 3) == "times 1 to 2 of 0 to 2 tracked"
    assert track_work.times_tracked(results[1:2], 3) == "time 1 of 0 to 2 tracked"
    assert track_work.times_tracked(results, 3) == "3 time points tracked"
