"""Another image is chosen: nothing that is of the first one is shown as the new one's."""

from types import SimpleNamespace

import numpy as np
import pytest
import tifffile
from napari.layers import Image
from napari.layers._source import layer_source

from napari_deltamic.errors import InputError
from napari_deltamic.evidence import put_together
from napari_deltamic.geometry.labels.bright_cells import CellsFound
from napari_deltamic.gui.fit_widget import FitWidget
from napari_deltamic.gui.results import session
from napari_deltamic.gui.seeding import find_cells_button
from napari_deltamic.gui.settings import effects_panel
from napari_deltamic.runs.settings import FitSettings

from .conftest import SIZE
from .sessions import done, fitted, save
from .test_effects_panel import FADING, HALO, recommendation, row_of


@pytest.fixture
def other(with_image, pixels):
    """A second image, not chosen."""

    def add():
        return with_image.add_image(pixels[::-1], name="other", scale=np.multiply(SIZE, 2))

    return add


def choose(widget, name):
    chooser = widget.image.chooser
    chooser.setCurrentIndex(chooser.findText(name))
    assert widget.doc.image.layer.name == name


def of_a_fit(widget):
    """What a result is told by: is any of it to be seen?"""
    running = widget.running
    parts = (running.verdict, running.note, running.curve, running.edit)
    parts += (running.history, running.numbers, widget.results, widget.settings.pace)
    return [part for part in parts if not part.isHidden()]


def test_the_result_goes_and_comes_back_with_its_image(seeded, spin, other):
    fitted(seeded, spin)
    before = of_a_fit(seeded)
    assert seeded.results in before
    other()
    choose(seeded, "other")
    assert of_a_fit(seeded) == []
    choose(seeded, "cell")
    assert set(before) - set(of_a_fit(seeded)) <= {seeded.settings.pace}


def test_the_image_that_is_chosen_is_seen(make_widget, with_image, pixels, other):
    widget, mine = make_widget(), with_image.layers["cell"]
    above, added = other(), with_image.add_image(pixels, name="added", blending="additive")
    labels = with_image.add_labels(np.zeros(pixels.shape, int))
    choose(widget, "other")
    mine.visible = False
    choose(widget, "cell")
    assert [x.visible for x in (mine, above, added, labels)] == [True, False, True, True]
    choose(widget, "other")
    assert [x.visible for x in (mine, above)] == [True, True]
    above.visible = False
    with_image.add_image(pixels, name="new")
    assert not above.visible, "only who chooses an image wants to see it"
    widget.image.chooser.activated.emit(widget.image.chooser.currentIndex())
    assert above.visible
    assert not with_image.layers["new"].visible


def test_a_fit_that_fails_does_not_take_over_the_last_result(seeded, with_image, spin, other, told):
    fitted(seeded, spin)
    other()
    choose(seeded, "other")
    with_image.layers["seeds"].data = [(500, 500, 500)]
    seeded.seeds.shape.setCurrentIndex(0)
    seeded.start()
    spin(done(seeded))
    reason = seeded.footer.reason
    assert "outside the image" in reason.text()
    assert len(told) == 1, "the dock is not seen"
    assert seeded.running.isHidden(), "there is nothing to check"
    assert seeded.results.isHidden()
    assert seeded.doc.present() is None
    choose(seeded, "cell")
    assert not seeded.results.isHidden()
    assert not reason.text(), "it is of the other image"


def test_a_failure_that_the_footer_shows_is_not_told_again(seeded, with_image, spin, told):
    seeded.show()
    with_image.layers["seeds"].data = [(500, 500, 500)]
    seeded.start()
    spin(done(seeded))
    assert "outside the image" in seeded.footer.reason.text()
    assert told == []
    with_image.layers["seeds"].data = [(2, 2, 2)]
    spin(lambda: not seeded.footer.reason.text())


def test_found_cells_are_of_their_image(make_widget, with_image, spin, other, monkeypatch):
    labels = np.zeros(with_image.layers["cell"].data.shape, np.int32)
    labels[5:12, 5:15, 5:15] = 1
    monkeypatch.setattr(
        find_cells_button, "look", lambda *arguments: CellsFound(labels, 2.0, False)
    )
    widget = make_widget()
    widget.seeds.find_cells.click()
    spin(lambda: "Found 1 cell" in widget.seeds.note.text())
    found = with_image.layers["found cells"]
    assert found in widget.seeds.cells.ticked
    widget.image.voxel_size._boxes[0].setValue(0.31)  # the same image
    assert "Found 1 cell, with another voxel size." in widget.seeds.note.text()
    other()
    choose(widget, "other")
    assert "Found" not in widget.seeds.note.text()
    assert found not in widget.seeds.cells.ticked


def test_cells_found_in_another_image_leave_those_of_the_first_as_they_are(
    make_widget, with_image, spin, other, monkeypatch
):
    def look(read, voxel_size, size):
        labels = np.zeros(read().shape, np.int32)
        labels[5:12, 5:15, 5:15] = 1
        return CellsFound(labels, 2.0, False)

    monkeypatch.setattr(find_cells_button, "look", look)
    widget = make_widget()
    cells, find = widget.doc.cells, widget.seeds.find_cells
    find.click()
    spin(lambda: "Found 1 cell" in find.message)
    mine = with_image.layers["found cells"]
    mine.data[15:18, 15:18, 15:18] = 7  # corrected by hand
    find.edited()
    corrected = mine.data.copy()
    other()
    choose(widget, "other")
    assert not mine.visible
    find.click()
    spin(lambda: "Found 1 cell of about 2" in find.message)
    theirs = with_image.layers["other: found cells"]
    np.testing.assert_array_equal(mine.data, corrected)
    assert cells.ticked == [theirs]
    choose(widget, "cell")
    assert cells.ticked == [mine]
    assert (mine.visible, theirs.visible) == (True, False)
    assert find.message == "2 cells."
    cells.choose(mine, ticked=False)
    choose(widget, "other")
    assert cells.ticked == [theirs]
    assert find.message == "Found 1 cell of about 2 µm."
    choose(widget, "cell")
    assert cells.ticked == [], "as the user left it"
    with_image.layers.remove(theirs)
    choose(widget, "other")
    assert (cells.ticked, find.message) == ([], "")


def test_how_large_found_cells_are_is_said_for_the_voxel_size_they_were_found_with(
    make_widget, with_image, spin, monkeypatch
):
    labels = np.zeros(with_image.layers["cell"].data.shape, np.int32)
    labels[5:12, 5:15, 5:15] = 1
    found = CellsFound(labels, 2.0, False, (SimpleNamespace(size=1.0, cells=2),))
    monkeypatch.setattr(find_cells_button, "look", lambda *given: found)
    widget = make_widget()
    find = widget.seeds.find_cells
    find.click()
    spin(lambda: find.message == "Found 1 cell of about 2 µm.")
    widget.doc.image.rescale(np.multiply(SIZE, (1, 0.5, 0.5)))
    assert find.message == "Found 1 cell, with another voxel size."
    assert not find.others
    widget.doc.image.rescale(SIZE)
    assert find.message == "Found 1 cell of about 2 µm."
    assert find.others == [(1.0, 2)]


def test_cells_found_in_another_region_come_in_the_place_of_those_before(
    make_widget, with_image, spin, monkeypatch
):
    def look(read, voxel_size, size):
        return CellsFound(np.ones(read().shape, np.int32), 2.0, False)

    monkeypatch.setattr(find_cells_button, "look", look)
    widget = make_widget()
    widget.seeds.find_cells.click()
    spin(lambda: "found cells" in with_image.layers)
    widget.doc.image.take_region(((0, 20), (2, 23), (2, 24)))
    widget.seeds.find_cells.click()
    spin(lambda: "cell: found cells" in with_image.layers)
    assert widget.doc.cells.ticked == [with_image.layers["cell: found cells"]]
    assert not with_image.layers["found cells"].visible


def test_why_no_cells_were_looked_for_goes_with_the_next_image(app, viewer, spin, pixels):
    viewer.add_image(pixels[0], name="flat")
    widget = FitWidget(viewer)
    widget.seeds.find_cells.click()
    assert "single plane" in widget.seeds.find_cells.message
    viewer.add_image(pixels, name="cell", scale=SIZE)
    assert not widget.seeds.find_cells.message
    assert widget.seeds.note.text().startswith("Press 'Find cells'")
    widget.close_links()


def test_why_no_cells_were_found_goes_with_the_image(make_widget, spin, other, monkeypatch):
    def fail(*arguments):
        raise InputError("nothing but noise")

    monkeypatch.setattr(find_cells_button, "look", fail)
    widget = make_widget()
    widget.seeds.find_cells.click()
    spin(lambda: widget.seeds.find_cells.message == "Nothing but noise.")
    assert "noise" in widget.seeds.note.text()
    other()
    choose(widget, "other")
    assert not widget.seeds.find_cells.message
    assert "noise" not in widget.seeds.note.text()


def test_lengths_are_in_voxels_where_nobody_knows_their_size(app, viewer, spin, monkeypatch):
    pixels = np.random.default_rng(0).poisson(100, (20, 24, 24)).astype(np.float32)
    labels = np.zeros(pixels.shape, np.int32)
    labels[5:12, 5:15, 5:15] = 1
    found = CellsFound(labels, 9.0, False, (SimpleNamespace(size=3.0, cells=2),))
    monkeypatch.setattr(find_cells_button, "look", lambda *given: found)
    viewer.add_image(pixels, name="cell")
    widget = FitWidget(viewer)
    widget.seeds.find_cells.click()
    spin(lambda: "Found 1 cell" in widget.seeds.find_cells.message)
    assert widget.seeds.find_cells.message == "Found 1 cell of about 9 voxels."
    spin(lambda: "voxels" in widget.seeds.note.text())
    assert "2 cells of 3 voxels</a>" in widget.seeds.note.text()
    frame, size = widget.doc.image.frame(), widget.seeds.find_cells.cell_size
    assert frame.length == "voxels"
    assert widget.seeds._form.labelForField(size).text() == "size, voxels"
    widget.doc.image.rescale((0.3, 0.2, 0.2))
    assert widget.doc.image.frame().length == "µm"
    spin(lambda: widget.seeds._form.labelForField(size).text() == "size, µm")
    widget.close_links()


def test_nuclei_found_in_one_channel_mark_the_cells_of_another(
    make_widget, with_image, spin, monkeypatch, tmp_path, pixels
):
    path, names = tmp_path / "two.ome.tif", ["nuclei", "membranes"]
    told = {"axes": "ZCYX", "Channel": {"Name": names}}
    tifffile.imwrite(path, np.stack([pixels, pixels], 1), ome=True, metadata=told)
    labels = np.zeros(pixels.shape, np.int32)
    labels[8:12, 9:14, 9:14] = 1
    monkeypatch.setattr(find_cells_button, "look", lambda *given: CellsFound(labels, 1.0, False))
    with layer_source(path=str(path)):
        for name in (*names, "neither"):
            with_image.add_image(pixels, name=name)
    widget = make_widget()
    choose(widget, "nuclei")
    widget.seeds.find_cells.click()
    spin(lambda: "Found 1 cell" in widget.seeds.note.text())
    choose(widget, "membranes")
    assert with_image.layers["found cells"] in widget.seeds.cells.ticked
    assert widget.seeds.find_cells.message == "Found 1 cell of about 1 voxels."  # nobody told
    assert not widget.seeds.find_cells.others
    choose(widget, "neither")  # of its channels
    assert with_image.layers["found cells"] not in widget.seeds.cells.ticked


def test_the_fields_of_the_voxel_size_are_closed_for_the_next_image(
    make_widget, with_image, pixels, other
):
    panel = make_widget().image
    panel.edit_size.setChecked(True)
    panel.voxel_size._boxes[0].setValue(0.4)
    assert panel.edit_size.isChecked(), "it is the same image"
    other()
    with_image.layers.remove("cell")
    assert not panel.edit_size.isChecked()
    assert panel.voxel_size.isHidden()
    with_image.add_image(pixels, name="no size")
    with_image.layers.remove("other")
    assert panel.edit_size.isChecked(), "nobody knows it"


def test_recommendations_are_of_their_image(seeded, spin, other, monkeypatch):
    monkeypatch.setattr(
        effects_panel, "recommend_for", lambda *a, **k: recommendation(FADING, HALO)
    )
    seeded.doc.settings.show_fit(FitSettings(max_iterations=2))
    seeded.settings.effects.button.start()
    spin(lambda: not seeded.settings.effects.button.busy)
    view = seeded.settings.effects
    assert view.summary() == "none; dimmer with depth recommended"
    other()
    choose(seeded, "other")
    assert "recommended" not in view.summary()
    assert view.take_button.isHidden()
    assert row_of(view, "attenuation")["evidence"] == ""
    assert "another image" in view.progress.text()
    choose(seeded, "cell")
    assert view.summary() == "none; dimmer with depth recommended"


def test_the_psf_of_a_session_is_of_its_image(seeded, spin, tmp_path, reopened, pixels):
    path = tmp_path / "one.deltamic"
    save(fitted(seeded, spin), path, spin)
    viewer, widget = reopened(path)
    assert widget.settings.sigma.value() == (0.4, 0.25, 0.23)
    viewer.add_image(pixels, name="other", scale=(1, 0.5, 0.5), units=("um",) * 3)
    choose(widget, "other")
    assert widget.settings.sigma.value() == pytest.approx((1.2, 0.6, 0.6))
    assert widget.settings.optics.picture._wanted.sigma_um == pytest.approx((1.2, 0.6, 0.6))
    assert widget.results.isHidden()


def test_what_the_user_typed_stays(make_widget, other):
    widget = make_widget()
    widget.settings.sigma._boxes[0].setValue(0.5)
    other()
    choose(widget, "other")
    assert widget.settings.sigma.value()[0] == 0.5


def test_a_fit_of_a_region_that_fails_leaves_the_result_where_it_was(seeded, spin, monkeypatch):
    seeded.settings.max_iterations.setValue(2)
    seeded.start()
    spin(lambda: not seeded.doc.run.running)
    link, mesh = seeded.doc.link, seeded.doc.result.state.mesh

    def fail(*arguments):
        raise InputError("nothing can be made of this")

    seeded.doc.image.take_region(((0, 20), (2, 23), (2, 24)))
    with monkeypatch.context() as patch:
        patch.setattr(put_together, "assemble", fail)
        seeded.start()
        spin(lambda: not seeded.doc.run.running)
    assert "Nothing can be made of this" in seeded.footer.reason.text()
    assert (seeded.doc.link, seeded.doc.link.mesh) == (link, mesh)
    assert session.capture(seeded.parts)[0].result is None, "it is of another region"
    seeded.start()
    spin(lambda: not seeded.doc.run.running)
    assert seeded.doc.link.frame == seeded.doc.image.frame()
    assert session.capture(seeded.parts)[0].result is not None


@pytest.mark.parametrize("what", ["region", "voxel size"])
def test_a_fit_of_another_region_or_size_leaves_no_old_contours(seeded, with_image, spin, what):
    def fit():
        seeded.start()
        spin(lambda: not seeded.doc.run.running)
        return seeded.doc.link.contours.layer, seeded.doc.link.surface

    def of_fits():
        return [layer for layer in with_image.layers if layer.name.startswith("cell: ")]

    seeded.settings.max_iterations.setValue(2)
    before = fit()
    assert set(of_fits()) == set(before)
    if what == "region":
        seeded.doc.image.take_region(((0, 20), (2, 23), (2, 24)))
        seeded.doc.cells.choose(before[1])  # the next fit starts from it
    else:
        seeded.doc.image.rescale(np.multiply(SIZE, 1.1))
    after = fit()
    kept = {before[1]} if what == "region" else set()
    assert set(of_fits()) == {*after, *kept}
    assert not set(after) & set(before)


def wait_for_grade(widget, spin):
    spin(lambda: not widget.doc.run.running and widget.doc.record.judged is not None)


@pytest.mark.usefixtures("judged")
@pytest.mark.parametrize("by_field", [True, False])
def test_a_result_is_not_graded_for_another_voxel_size(
    seeded, with_image, spin, tmp_path, told, by_field
):
    seeded.settings.max_iterations.setValue(3)
    seeded.start()
    wait_for_grade(seeded, spin)
    running, results = seeded.running, seeded.results
    go_on, grade = running.history.go_on_button, running.grade.text()

    def resize(size):
        if by_field:
            seeded.doc.image.rescale(size)
        else:  # as scripts do
            with_image.layers["cell"].scale = size

    assert grade
    assert running.other_image.isHidden()
    assert go_on.isEnabled()
    resize(np.multiply(SIZE, (1, 0.5, 0.5)))
    assert running.other_image.text() == (
        "Fitted with voxels of 0.3 x 0.2 x 0.2 µm, but its voxel size is now different: fit again "
        "for a grade."
    )
    assert (running.grade.text(), running.strays) == ("", ())
    assert running.worst.isHidden()
    assert running.again.isHidden()
    assert not go_on.isEnabled()
    assert "0.3 x 0.2 x 0.2 µm" in go_on.toolTip()
    with pytest.raises(InputError, match="no longer has"):
        running.history.go_on()
    assert "with voxels of 0.3 x 0.2 x 0.2 µm" in results.valid_for.text()
    results.save_table(str(tmp_path / "cells.csv"))
    assert "fitted with voxels of 0.3 x 0.2 x 0.2" in told[-1]
    resize(SIZE)
    assert running.other_image.isHidden()
    assert results.valid_for.isHidden()
    assert running.grade.text() == grade
    assert go_on.isEnabled()
    assert go_on.toolTip() == "<qt>Start a fit from the state shown, with little blur.</qt>"


@pytest.mark.usefixtures("judged")
def test_without_an_image_nothing_is_known_and_nothing_is_shown(seeded, with_image, spin, told):
    seeded.settings.max_iterations.setValue(3)
    seeded.start()
    wait_for_grade(seeded, spin)
    assert not seeded.running.grade.isHidden()
    told.clear()
    with_image.layers.clear()
    assert (seeded.doc.record, seeded.doc.records) == (None, {})
    assert seeded.running.isHidden()
    assert seeded.running.grade.isHidden()
    assert seeded.results.isHidden()
    for view in ("residual", "rendered", "image"):
        seeded.running.view.setCurrentText(view)
        spin(seconds=0.05, must=False)
        assert len(with_image.layers) == 0
    assert told == []


@pytest.mark.usefixtures("judged")
def test_what_is_found_after_the_image_went_is_not_shown(seeded, with_image, spin, monkeypatch):
    asked = []
    monkeypatch.setattr(seeded.judging.background, "ask", lambda *what: asked.append(what))
    seeded.settings.max_iterations.setValue(3)
    seeded.start()
    spin(lambda: not seeded.doc.run.running and asked)
    seeded.doc.look("residual")
    with_image.layers.clear()
    work, take = asked[-1]
    take(work())
    assert len(with_image.layers) == 0


@pytest.mark.parametrize("fitted_before", [False, True])
def test_a_fit_whose_image_goes_can_be_saved_though_another_one_is_open(
    begun, with_image, spin, other, told, tmp_path, fitted_before
):
    doc, running, results = begun.doc, begun.running, begun.results
    path = tmp_path / "cells.csv"
    other()
    if fitted_before:
        begun.stop()
        spin(done(begun))
        choose(begun, "other")
        begun.start()
        spin(lambda: doc.begun and len(doc.run.history.loss) > 3)
    name, left = ("other", "cell") if fitted_before else ("cell", "other")
    record = doc.record
    with_image.layers.remove(name)
    spin(done(begun))
    assert "its result can still be saved" in told[-1]
    assert doc.image.layer.name == left
    assert doc.result is record
    assert "goes on" not in running.note.text()
    assert running.rescued.text().startswith(f"Of '{name}', which was removed: export")
    assert running.history.isHidden()
    assert results.valid_for.text() == f"Of '{name}', which was removed."
    results.save_table(str(path))
    assert path.exists()
    saved, remark = session.capture(begun.parts)
    assert (saved.result is not None) == fitted_before
    assert f"'{name}'" in remark or fitted_before
    running.let_go.click()
    assert running.rescued_row.isHidden()
    assert record not in doc.records.values()
    assert (doc.result is not None) == fitted_before
    assert results.isHidden() != fitted_before
    assert f"{name}: contours" not in with_image.layers


@pytest.mark.usefixtures("judged")
@pytest.mark.parametrize("seen", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_fit_whose_layers_all_go_can_be_saved_but_is_not_shown(
    begun, with_image, spin, tmp_path, seen
):
    begun.doc.look("residual")
    if seen:
        spin(lambda: "cell: residual" in with_image.layers)
    with_image.layers.clear()
    wait_for_grade(begun, spin)
    spin(seconds=0.1, must=False)
    assert not any(isinstance(layer, Image) for layer in with_image.layers)
    assert begun.running.grade.isHidden()
    assert not begun.running.view.isVisibleTo(begun.running)
    assert begun.results.isEnabled()
    begun.results.save_meshes(str(tmp_path / "a.ply"))
    assert (tmp_path / "a.ply").exists()
