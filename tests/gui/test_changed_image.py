"""The image has other pixels, or lies elsewhere, than when it was fitted: it is told."""

import numpy as np
import pytest

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.labels.bright_cells import CellsFound
from napari_deltamic.gui.seeding import find_cells_button

from .sessions import done

OTHER_PIXELS = "Fitted to other pixels than the image has now: fit again for a grade."
ELSEWHERE = "Fitted where the image no longer lies: move it back, or fit again for a grade."


@pytest.fixture
def graded(seeded, spin):
    seeded.settings.max_iterations.setValue(3)
    seeded.start()
    spin(lambda: not seeded.running.grade.isHidden())
    return seeded


@pytest.mark.usefixtures("judged")
@pytest.mark.parametrize("what", ["data", "translate"])
def test_a_result_is_not_graded_for_an_image_that_has_changed(
    graded, with_image, what, tmp_path, told
):
    running, results, layer = graded.running, graded.results, with_image.layers["cell"]
    go_on, grade, before = running.history.go_on_button, running.grade.text(), getattr(layer, what)
    other = np.roll(before, 5) if what == "data" else np.add(before, 0.5)
    assert running.other_image.isHidden()
    setattr(layer, what, other)
    assert running.other_image.text() == (OTHER_PIXELS if what == "data" else ELSEWHERE)
    assert (running.grade.text(), running.strays) == ("", ())
    assert running.worst.isHidden()
    assert not go_on.isEnabled()
    with pytest.raises(InputError, match="no longer"):
        running.history.go_on()
    assert not results.valid_for.isHidden()
    results.save_table(str(tmp_path / "cells.csv"))
    assert ("earlier pixels" in told[-1]) == (what == "data")
    setattr(layer, what, before)
    assert running.other_image.isHidden()
    assert results.valid_for.isHidden()
    assert running.grade.text() == grade
    assert go_on.isEnabled()


@pytest.mark.usefixtures("judged")
def test_a_new_fit_is_one_of_the_new_pixels(graded, with_image, pixels, spin):
    with_image.layers["cell"].data = pixels + 1
    graded.start()
    spin(done(graded))
    spin(lambda: not graded.running.grade.isHidden())
    assert graded.running.other_image.isHidden()


@pytest.mark.usefixtures("judged")
def test_a_fit_goes_on_with_the_pixels_that_it_has(begun, with_image, pixels, spin):
    with_image.layers["cell"].data = np.roll(pixels, 5, 2)
    told = begun.running.other_image
    assert told.text().startswith("The fit goes on with the earlier pixels of the image")
    begun.stop()
    spin(done(begun))
    spin(lambda: not begun.judging.background.busy)
    assert told.text() == OTHER_PIXELS
    assert begun.running.grade.isHidden()


def test_a_fit_within_a_region_still_lies_on_its_image(seeded, with_image, spin):
    seeded.doc.image.take_region(((0, 20), (2, 24), (2, 24)))
    seeded.settings.max_iterations.setValue(2)
    seeded.start()
    spin(done(seeded))
    assert seeded.doc.other == ""
    layer, contours = with_image.layers["cell"], with_image.layers["cell: contours"]
    place, scale = tuple(layer.translate), tuple(layer.scale)
    assert contours.visible
    layer.translate = (1, 2, 3.5)
    assert seeded.doc.other == "place"
    assert not contours.visible, "they would lie beside the cells"
    layer.translate = place
    assert contours.visible
    layer.scale = (0.6, 0.3, 0.3)
    assert not contours.visible
    layer.scale = scale
    assert contours.visible


def test_cells_that_were_found_in_other_pixels_are_told_to_be(
    make_widget, with_image, pixels, spin, monkeypatch
):
    labels = np.zeros(pixels.shape, np.int32)
    labels[5:12, 5:15, 5:15] = 1
    monkeypatch.setattr(
        find_cells_button, "look", lambda *arguments: CellsFound(labels, 2.0, False)
    )
    widget, layer = make_widget(), with_image.layers["cell"]
    widget.seeds.find_cells.click()
    spin(lambda: "Found 1 cell of about" in widget.seeds.note.text())
    layer.data = pixels + 1
    assert widget.seeds.note.text().startswith("Found 1 cell, in other pixels than")
    layer.data = pixels
    assert "Found 1 cell of about" in widget.seeds.note.text()


def test_why_no_fit_started_goes_when_the_layer_is_moved_back(seeded, with_image, pixels, spin):
    mine, reason = with_image.layers["cell"], seeded.footer.reason
    with_image.layers.remove("seeds")
    place = {"scale": mine.scale, "translate": mine.translate, "units": mine.units}
    with_image.add_labels((pixels > 300).astype(np.int32), name="labels", **place)
    for layer in ("cell", "labels"):
        before = with_image.layers[layer].translate
        with_image.layers[layer].translate = before + 3
        seeded.start()
        spin(lambda: not reason.isHidden())
        assert "does not lie on the voxels of the image" in reason.text()
        with_image.layers[layer].translate = before
        spin(reason.isHidden)
