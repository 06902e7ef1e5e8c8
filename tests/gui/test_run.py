"""A fit in the widget: from the clicks to the result, and everything that may go wrong."""

import gc
import shlex
import threading
import weakref
from dataclasses import replace

import numpy as np
import pytest

from napari_deltamic import load_mesh
from napari_deltamic.cli import build_parser
from napari_deltamic.cli.inputs import gather
from napari_deltamic.cli.messages import Notes
from napari_deltamic.common.doing import doing
from napari_deltamic.errors import DoubtWarning, InputError
from napari_deltamic.fitting import fit
from napari_deltamic.fitting.rivals.light_cone import confocal_of, widefield_of
from napari_deltamic.geometry.labels.bright_cells import CellsFound
from napari_deltamic.gui import document
from napari_deltamic.gui.running import footer, run_control, worker
from napari_deltamic.gui.seeding import find_cells_button
from napari_deltamic.measure import measure_cells
from napari_deltamic.results.session_file import load_session
from napari_deltamic.runs.command import command
from napari_deltamic.runs.run_files import with_files

from .conftest import CENTER, SIZE
from .interacting import pause, went_on
from .seeding import PLACE
from .sessions import save

VOLUME = 4 / 3 * np.pi * 1.2 * 1.1 * 1.1


def running(widget):
    return widget.doc.run is not None and widget.doc.run.running


@pytest.mark.usefixtures("judged")
def test_three_clicks_give_a_mesh(make_widget, with_image, spin):
    widget = make_widget()
    assert widget.doc.image.layer is with_image.layers["cell"]  # the only one
    widget.seeds.place.click()
    seeds = with_image.layers["seeds"]
    assert str(seeds.mode) == "add"
    seeds.add(CENTER)
    widget.footer.run_button.click()
    spin(lambda: not running(widget))
    assert widget.running.verdict.text().startswith("converged")
    surface = with_image.layers["cell: surfaces"]
    assert tuple(surface.translate) == (1, 2, 3)
    row = measure_cells(widget.doc.link.mesh)[0]
    assert row["volume_um3"] == pytest.approx(VOLUME, rel=0.1)
    shown = np.asarray(surface.data[0]) * surface.scale + surface.translate
    assert shown.mean(axis=0) == pytest.approx(np.add(CENTER, (1, 2, 3)), abs=0.1)
    assert widget.results.table.rowCount() == 1
    assert widget.results.isEnabled()
    assert str(seeds.mode) == "pan_zoom"


@pytest.mark.usefixtures("judged")
@pytest.mark.parametrize("fails", [False, True])
def test_it_says_that_shapes_are_judged(seeded, spin, monkeypatch, fails):
    """A table without grades had been there for seconds, with nothing said."""
    waits, judge, said = threading.Event(), run_control.judge, []

    def slowly(*given):
        assert waits.wait(60)
        if fails:
            raise InputError("no room")
        return judge(*given)

    monkeypatch.setattr(run_control, "judge", slowly)
    seeded.doc.warned.connect(said.append)
    seeded.start()
    spin(lambda: seeded.doc.result is not None and not running(seeded))
    grade = seeded.running.grade
    assert (grade.text(), grade.verdict) == ("Judging the shapes ...", "")
    waits.set()
    spin(lambda: grade.text() != "Judging the shapes ...")
    assert (grade.verdict == "") == (grade.text() == "") == fails
    assert ("no room" in said) == fails


def test_an_uneven_background_is_told_and_fitted(seeded, with_image):
    layer = with_image.layers["cell"]
    rise = np.linspace(0, 3, layer.data.shape[2]) * np.ptp(layer.data)
    layer.data = (layer.data + rise).astype(np.float32)
    prepare, _ = seeded.doc.prepared()
    with pytest.warns(DoubtWarning, match="the background varies by"):
        job = prepare()
    assert job.settings.scene.effects.names == ("background",)


def test_the_result_is_saved(seeded, spin, tmp_path):
    seeded.start()
    spin(lambda: not running(seeded))
    results = seeded.results
    for name in ("mesh.ply", "mesh.obj", "mesh.rec", "mesh.stl"):
        results.save_meshes(str(tmp_path / name))
        assert load_mesh(tmp_path / name).vertices_numpy().mean(axis=0) == pytest.approx(
            CENTER, abs=0.1
        )
    results.save_table(str(tmp_path / "table.csv"))
    assert (tmp_path / "table.csv").read_text().startswith("region,volume_um3")
    results.save_image(str(tmp_path / "rendered.ome.tif"))
    results.save_all(str(tmp_path / "all"))
    assert (tmp_path / "all" / "report.json").exists()


def test_a_disk_that_cannot_be_written_is_told_in_words(seeded, spin, tmp_path, told):
    seeded.start()
    spin(lambda: not running(seeded))
    path = tmp_path / "no folder" / "mesh.ply"
    seeded.doc.guarded(lambda: seeded.results.save_meshes(str(path)))
    assert "cannot be written" in told[-1]
    assert seeded.results.isEnabled()


def test_pause_holds_the_fit_and_stop_keeps_what_it_reached(seeded, spin, endless):
    seeded.start()
    spin(went_on(seeded))
    pause(seeded, spin)
    assert seeded.footer.message.text().startswith("paused after ")
    n = len(seeded.doc.run.history.loss)
    spin(seconds=0.2, must=False)
    assert len(seeded.doc.run.history.loss) == n
    seeded.footer.pause_button.click()
    spin(went_on(seeded, n + 2))
    seeded.footer.stop_button.click()
    spin(lambda: not running(seeded))
    assert seeded.running.verdict.text().startswith("stopped")
    assert seeded.results.table.rowCount() == 1
    assert seeded.footer.run_button.isEnabled()


def test_what_is_prepared_is_told_and_can_be_stopped(seeded, spin, monkeypatch):
    gate, ended = threading.Event(), []

    def forever(*arguments, **options):
        try:
            while True:
                doing("making meshes of 44 cells")
                gate.wait(0.01)
        finally:
            ended.append(True)

    monkeypatch.setattr(document, "put_together", forever)
    monkeypatch.setattr(footer, "_LONG", 0.3)
    seeded.start()
    spin(lambda: seeded.footer.message.text() == "making meshes of 44 cells ...")
    spin(lambda: seeded.footer.message.text() == "making meshes of 44 cells: 1 s so far")
    seeded.footer.stop_button.click()
    spin(lambda: not running(seeded))
    assert ended
    assert seeded.footer.run_button.isEnabled()
    assert not seeded.footer.reason.text()


@pytest.mark.usefixtures("judged")
def test_a_fit_that_cannot_be_prepared_leaves_the_result_before_it(ended, spin, monkeypatch, told):
    spin(lambda: ended.doc.result.judged is not None)
    judged, words, grade = ended.doc.result.judged, ended.doc.result.words, ended.running.grade
    said = ended.running.verdict.text(), grade.text()

    def empty(*arguments, **options):
        raise InputError("the label image has no labels above 0")

    monkeypatch.setattr(document, "put_together", empty)
    ended.start()
    spin(lambda: not running(ended))
    assert ended.footer.reason.text() == "The label image has no labels above 0."
    assert told[-1] == "the label image has no labels above 0"
    assert (ended.running.verdict.text(), grade.text()) == said
    assert (ended.doc.result.words, ended.doc.result.judged) == (words, judged)


def test_a_paused_fit_can_be_stopped(seeded, spin, endless):
    seeded.start()
    spin(went_on(seeded))
    pause(seeded, spin)
    seeded.footer.stop_button.click()
    spin(lambda: not running(seeded))
    assert not seeded.footer.pause_button.isChecked()


def test_a_second_start_is_refused_while_a_fit_runs(seeded, spin, endless, told):
    seeded.start()
    first = seeded.doc.run
    seeded.start()
    assert seeded.doc.run is first
    assert "running already" in told[-1]
    assert not seeded.footer.run_button.isEnabled()


@pytest.mark.parametrize("name", ["cell: surfaces", "cell: contours"])
def test_a_layer_that_was_removed_is_there_again_with_the_next_fit(seeded, with_image, spin, name):
    """And nothing is left of the others that were with it."""
    seeded.settings.max_iterations.setValue(2)
    seeded.start()
    spin(lambda: not seeded.doc.run.running)
    before = sorted(layer.name for layer in with_image.layers)
    with_image.layers.remove(name)
    seeded.start()
    spin(lambda: not seeded.doc.run.running)
    assert sorted(layer.name for layer in with_image.layers) == before
    assert seeded.doc.link.mesh is seeded.doc.result.state.mesh


def test_a_second_run_uses_the_same_layers(seeded, with_image, spin):
    for _ in range(2):
        seeded.start()
        spin(lambda: not running(seeded))
    assert [layer.name for layer in with_image.layers] == [
        "cell",
        "seeds",
        "cell: surfaces",
        "cell: contours",
    ]


@pytest.mark.parametrize("name", ["cell", "cell: surfaces"])
def test_removing_a_layer_that_the_fit_needs_ends_it(seeded, with_image, spin, endless, told, name):
    seeded.start()
    spin(lambda: "cell: surfaces" in with_image.layers)
    del with_image.layers[name]
    spin(lambda: not running(seeded))
    assert "removed" in told[-1]
    assert seeded.results.isEnabled()
    words = seeded.running.verdict.text()
    assert words.startswith("stopped (")
    assert "by you" not in words


@pytest.mark.parametrize(
    "name",
    [
        "cell: contours",
        "seeds",
        pytest.param("cell: rendered", marks=pytest.mark.slow),
        pytest.param("cell: residual", marks=pytest.mark.slow),
    ],
)
def test_other_layers_can_be_removed_while_it_runs(seeded, with_image, spin, endless, name):
    seeded.doc.look("residual" if "residual" in name else "rendered")
    seeded.start()
    spin(lambda: name in with_image.layers)
    del with_image.layers[name]
    n = len(seeded.doc.run.history.loss)
    spin(went_on(seeded, n + 30))
    assert running(seeded)
    assert name not in with_image.layers
    with_image.dims.set_point(0, 4.0)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (FloatingPointError("the fit met a number that is not finite"), "not finite"),
        pytest.param(
            RuntimeError("something of torch"), "something of torch", marks=pytest.mark.slow
        ),
        (MemoryError(), "not enough memory"),
        (InputError("the mesh lies outside"), "the mesh lies outside"),
    ],
)
def test_an_error_of_the_engine_is_told_in_words(seeded, spin, monkeypatch, told, error, words):
    def states(job):
        for n, state in enumerate(
            fit(job.image, job.grid, job.mesh, job.optics, settings=job.settings.fit)
        ):
            if n == 4:
                raise error
            yield state

    monkeypatch.setattr(worker, "start", states)
    seeded.start()
    spin(lambda: not running(seeded))
    assert words in told[-1]
    assert "Traceback" not in told[-1]
    assert seeded.results.isEnabled(), "the last good state is kept"
    assert seeded.footer.run_button.isEnabled()


def test_a_remark_on_the_way_stands_behind_the_verdict(seeded, spin, monkeypatch):
    def states(job):
        for state in fit(job.image, job.grid, job.mesh, job.optics, settings=job.settings.fit):
            yield replace(state, message="it leaks") if state.iteration == 3 else state

    monkeypatch.setattr(worker, "start", states)
    seeded.footer.run_button.click()
    spin(lambda: not running(seeded))
    assert seeded.running.verdict.text().startswith("converged")
    assert seeded.running.remarks.content.text() == "it leaks"


def test_an_error_before_the_first_iteration(seeded, with_image, spin, told):
    with_image.layers["seeds"].data = [[50, 50, 50]]
    seeded.seeds.shape.setCurrentIndex(0)
    seeded.start()
    spin(lambda: not running(seeded))
    assert "outside the image" in told[-1]
    assert not seeded.results.isEnabled()


def test_what_is_missing_is_said(make_widget, with_image, told):
    widget = make_widget()
    widget.start()
    assert "no cells yet" in told[-1]
    del with_image.layers["cell"]
    widget.start()
    assert "image" in told[-1]
    assert widget.doc.run is None


def test_a_fit_waits_for_the_cells_that_are_looked_for(
    make_widget, with_image, told, spin, monkeypatch, ball_labels
):
    gate, widget = threading.Event(), make_widget()

    def look(*given):
        assert gate.wait(20)
        return CellsFound(ball_labels.astype(np.int32), 1.0, False)

    monkeypatch.setattr(find_cells_button, "look", look)
    for again in (False, True):  # cells that are to be replaced are not fitted either
        gate.clear()
        widget.seeds.find_cells.click()
        widget.start()
        assert "'Find cells' is still looking" in told[-1]
        assert widget.doc.run is None
        gate.set()
        spin(lambda: not widget.seeds.find_cells.background.busy)
        spin(lambda: not widget.footer.reason.text())
        assert widget.doc.cells.ticked, again
    gate.clear()
    widget.seeds.find_cells.click()
    widget.seeds.cells.choose(with_image.layers["found cells"], ticked=False)
    with_image.add_labels(ball_labels, name="own", **PLACE)
    assert widget.doc.cells.seeds(widget.doc.image.frame())
    gate.set()


def test_why_a_fit_did_not_start_goes_when_it_could(make_widget, with_image, told, spin, pixels):
    widget = make_widget()
    reason, check = widget.footer.reason, widget.running
    widget.start()
    assert reason.text().startswith("No cells yet: press 'Find cells'")
    assert reason.verdict == "failed"
    assert check.isHidden(), "nothing was fitted yet"
    widget.seeds.place.click()
    spin(lambda: reason.text() == "Layer 'seeds' has no points yet: click inside each cell.")
    with_image.layers["seeds"].add(CENTER)
    spin(lambda: not reason.text())
    widget.settings.accuracy.setCurrentText("much")
    widget.start()
    assert reason.text().startswith("Accuracy must be")
    widget.settings.accuracy.show_choice("normal")
    widget.settings.accuracy.lineEdit().editingFinished.emit()
    assert not reason.text()
    with_image.layers["seeds"].data = np.zeros((0, 3))
    widget.start()
    assert reason.text()
    widget.doc.image.choose(with_image.add_image(pixels[::-1], name="other", scale=SIZE))
    assert not reason.text()


def test_closing_the_widget_ends_the_fit(seeded, with_image, spin, endless):
    seeded.start()
    spin(lambda: "cell: surfaces" in with_image.layers)
    run = seeded.doc.run
    seeded.close_links()
    assert not run.running
    spin(lambda: run.done)
    with_image.dims.set_point(0, 4.0)  # nothing listens any more
    del with_image.layers["cell: surfaces"]


def test_closing_releases_widget_run_and_link(seeded, make_widget, spin, endless):
    seeded.start()
    spin(lambda: seeded.doc.link.mesh is not None)
    refs = [weakref.ref(seeded.doc.run), weakref.ref(seeded.doc.link)]
    seeded.close_links()
    spin(lambda: gc.collect() >= 0 and [ref() for ref in refs] == [None, None])


def test_updates_do_not_queue_up(seeded, spin, endless):
    """A slow viewer gets fewer states, and none while it still draws the one before."""
    counts, busy = [], []
    show = seeded.control._show

    def slow(record, snapshot):
        assert not busy
        busy.append(True)
        spin(seconds=0.05, must=False)
        counts.append(snapshot.state.iteration)
        show(record, snapshot)
        busy.clear()

    seeded.control._show = slow
    seeded.start()
    spin(lambda: len(counts) > 5)
    assert len(counts) < len(seeded.doc.run.history.loss) / 2


def test_the_command_repeats_the_run(seeded, with_image, tmp_path):
    """The widget and the command line make the same settings of the same run."""
    frame = seeded.doc.image.frame()
    seeds = seeded.doc.cells.seeds(frame)
    seeded.settings.accuracy.setCurrentText("3e-3")
    seeded.settings.density.setCurrentText("smooth")
    seeded.settings.fit_psf.setChecked(True)
    # As a user does: a PSF that is left open is found in the image by either.
    for box, width in zip(seeded.settings.sigma._boxes, (0.4, 0.25, 0.25), strict=True):
        box.setValue(width)
    pixels = seeded.doc.image.stack()
    grid = frame.grid(pixels.shape)
    settings = with_files(seeded.doc.run_settings(seeds.path), pixels, grid, seeds, tmp_path)
    words = shlex.split(command(settings, str(tmp_path / "result")))
    assert words[:2] == ["napari-deltamic", "fit"]
    job = gather(build_parser().parse_args(words[1:]), Notes())
    filled_in = {"flatness": job.settings.fit.flatness}  # from the noise, once the start is known
    fit = settings.fit.model_copy(update=filled_in)
    assert job.settings == settings.model_copy(update={"fit": fit})
    assert job.grid == grid
    np.testing.assert_array_equal(job.image, pixels)
    start = seeds.make(pixels, grid)
    np.testing.assert_allclose(job.mesh.vertices_numpy(), start.vertices_numpy(), atol=1e-5)


def test_the_voxel_size_is_the_scale_of_the_layer(make_widget, with_image):
    widget = make_widget()
    assert widget.image.voxel_size.value() == SIZE
    with_image.layers["cell"].scale = (0.5, 0.2, 0.2)
    assert widget.image.voxel_size.value() == (0.5, 0.2, 0.2)
    widget.image.voxel_size._boxes[0].setValue(0.4)
    assert tuple(with_image.layers["cell"].scale) == (0.4, 0.2, 0.2)
    assert widget.doc.run_settings().scene.voxel_size == (0.4, 0.2, 0.2)
    assert widget.settings.sigma.value() == pytest.approx((0.48, 0.24, 0.24))


def test_the_verdict_is_one_line_with_a_list_behind(seeded, spin, monkeypatch):
    def states(job):
        for state in fit(job.image, job.grid, job.mesh, job.optics, settings=job.settings.fit):
            k = state.iteration
            yield replace(state, message=f"cells {k} and 9 meet") if k in (2, 3, 4) else state

    monkeypatch.setattr(worker, "start", states)
    seeded.settings.max_iterations.setValue(8)
    seeded.start()
    spin(lambda: not running(seeded))
    panel = seeded.running
    assert "meet" not in panel.verdict.text()
    assert "8 iterations" in panel.verdict.text()
    assert panel.remarks.title == "3 remarks"
    assert panel.remarks.content.isHidden()
    assert panel.remarks.content.text().split("\n") == [f"cells {k} and 9 meet" for k in (2, 3, 4)]
    verdict = seeded.doc.record.words
    panel._show_verdict("", "")
    assert panel.remarks.isHidden()
    panel._show_verdict(*verdict)  # as a session does
    assert panel.remarks.title == "3 remarks"


@pytest.mark.usefixtures("judged")
@pytest.mark.parametrize("made", [pytest.param(widefield_of, marks=pytest.mark.slow), confocal_of])
def test_a_fit_that_begins_anew_with_another_psf(seeded, spin, monkeypatch, tmp_path, made):
    """Settings, forecast and session follow the kind of PSF."""

    def states(job):
        few = job.settings.fit.model_copy(update={"max_iterations": 3})
        given = job.image, job.grid, job.mesh
        yield from list(fit(*given, job.optics, settings=few))[:2]
        yield from fit(*given, made(job.optics.sigma_um), settings=few)

    monkeypatch.setattr(worker, "start", states)
    seeded.start()
    spin(lambda: not running(seeded))
    record = seeded.doc.result
    kind = type(made((0.3, 0.11, 0.11)))
    assert isinstance(record.state.optics, kind)
    assert isinstance(record.job.optics, kind)
    assert record.job.settings.scene.optics.kind == "microscope"
    assert seeded.doc.run.forecast.iterations == 2  # counted from the new beginning on
    spin(lambda: not seeded.judging.background.busy)
    save(seeded, tmp_path / "a.deltamic", spin)
    result = load_session(tmp_path / "a.deltamic").result
    assert repr(result.state.optics) == repr(record.state.optics)


def test_a_fit_that_is_stopped_by_a_key_is_said_to_stop(begun):
    begun.start_or_stop()
    begun.doc.work.looked.emit()
    assert begun.footer.message.text() == "stopping ..."


def test_who_pauses_while_the_fit_is_prepared_is_told_when_it_will(
    seeded, spin, endless, monkeypatch
):
    gate, put_together = threading.Event(), document.put_together

    def slowly(*given, **more):
        assert gate.wait(20)
        return put_together(*given, **more)

    monkeypatch.setattr(document, "put_together", slowly)
    seeded.start()
    seeded.footer.pause_button.click()
    told = seeded.footer.message
    spin(lambda: told.text().startswith("pauses as soon as the fit has begun; "))
    gate.set()
    spin(lambda: told.text() == "paused after 1 iteration")
    seeded.stop()
    spin(lambda: not running(seeded))
