"""Images that are no stack of one channel: what to do is said, and channels can be chosen."""

import numpy as np
import pytest

from napari_deltamic.errors import InputError
from napari_deltamic.gui import fit_widget

from .conftest import CENTER, SHAPE, SIZE


@pytest.fixture
def widget(app, viewer):
    widget = fit_widget.FitWidget(viewer)
    yield widget
    widget.close_links()


@pytest.mark.parametrize(
    ("shape", "options", "words"),
    [
        ((20, 30), {}, "'picture' is a single plane: open a stack"),
        ((9, 20, 30, 3), {"rgb": True}, "'picture' is a colour image: right-click it"),
        ((7, 8, 9, 20, 30), {}, "'picture' has 5 axes: keep Z, Y, X"),
        ((7, 2, 9, 20, 30), {}, "'picture' has 5 axes: choose the channel"),
    ],
)
def test_what_to_do_is_one_sentence(widget, viewer, told, shape, options, words):
    viewer.add_image(np.zeros(shape, np.uint8), name="picture", **options)
    assert widget.image.note.text().startswith(words)
    widget.start()
    assert words in told[-1]
    widget.seeds.place.click()
    assert words in widget.seeds.note.text()
    with pytest.raises(InputError, match="picture"):
        widget.doc.image.stack()
    viewer.layers.clear()
    assert widget.image.note.text().startswith("Open a 3D image")


def channels(widget):
    box = widget.image.channels
    return [] if box.isHidden() else [box.itemText(k) for k in range(box.count())]


def choose(widget, text):
    box = widget.image.channels
    index = box.findText(text)
    box.setCurrentIndex(index)
    box.activated.emit(index)


@pytest.mark.parametrize(("axis", "series"), [(1, False), (0, False), (1, True), (2, True)])
def test_a_channel_becomes_a_layer(widget, viewer, pixels, axis, series, spin):
    other = np.zeros_like(pixels)
    data = np.stack([other, pixels], axis=axis - (axis > 0 and series))
    scale = list(SIZE)
    scale.insert(axis - (axis > 0 and series), 1.0)
    if series:
        data, scale = np.stack([data] * 7), [1.0, *scale]
    units = ["pixel" if s == 1.0 else "um" for s in scale]
    viewer.add_image(data, name="both", scale=scale, units=units)
    named = f"2 of 2, along axis {axis + 1 - (axis > 0 and series) + series}"
    assert named in channels(widget)
    choose(widget, named)
    layer = widget.doc.image.layer
    assert layer.name == "both, channel 2"
    assert widget.image.voxel_size.value() == pytest.approx(SIZE)
    np.testing.assert_array_equal(widget.doc.image.stack(), pixels)
    assert not viewer.layers["both"].visible
    assert not channels(widget)
    if not series:
        widget.seeds.place.click()
        viewer.layers["seeds"].add(CENTER)
        widget.settings.max_iterations.setValue(2)
        widget.start()
        spin(lambda: not widget.run.running)
        assert widget.results.table.rowCount() == 1


@pytest.mark.parametrize(
    "options",
    [{"units": ("s", "um", "um", "um")}, {"axis_labels": ("time", "z", "y", "x")}],
)
def test_a_series_is_no_channels(widget, viewer, options):
    viewer.add_image(np.zeros((4, *SHAPE)), scale=(1, *SIZE), **options)
    assert channels(widget) == []


def test_what_may_be_channels_is_said(widget, viewer):
    viewer.add_image(np.zeros((12, 2, 20, 24)), axis_labels=("z", "c", "y", "x"), name="both")
    assert channels(widget)[1:] == ["1 of 2, along axis 2", "2 of 2, along axis 2"]
    assert "12 times of 2 planes; if it has channels, choose one" in widget.image.note.text()
