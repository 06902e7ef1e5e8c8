"""Images that are no stack of one channel: what to do is said, and channels can be chosen."""

import shlex
import zipfile

import numpy as np
import pytest
import tifffile
from napari.layers._source import layer_source

from napari_deltamic.cli import build_parser
from napari_deltamic.cli.inputs import gather
from napari_deltamic.cli.messages import Notes
from napari_deltamic.errors import InputError
from napari_deltamic.gui import fit_widget
from napari_deltamic.gui.results import more_actions
from napari_deltamic.gui.viewing.frame import camera_of
from napari_deltamic.runs.settings import RunSettings

from .conftest import CENTER, SHAPE, SIZE
from .sessions import save


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
    assert widget.image.channels.currentText() == named  # and another one may be chosen
    if not series:
        widget.seeds.place.click()
        viewer.layers["seeds"].add(CENTER)
        widget.settings.max_iterations.setValue(2)
        widget.start()
        spin(lambda: not widget.doc.run.running)
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


# ---- channels that the file of the image tells ---------------------------------------------------


NAMES = ["DAPI", "membrane"]


@pytest.fixture
def from_file(viewer, pixels, tmp_path):
    """Adds the image as a reader does that knows no channels, from a file that tells them."""

    def add(axes="ZCYX", **options):
        path = tmp_path / "both.ome.tif"
        data = np.stack([np.full_like(pixels, 7), pixels], axis=axes.index("C") - axes.count("T"))
        if axes[0] == "T":
            data = np.stack([data, data + 1])
        metadata = {"axes": axes, "Channel": {"Name": NAMES}}
        for name, side in zip("ZYX", SIZE, strict=True):
            metadata |= {f"PhysicalSize{name}": side, f"PhysicalSize{name}Unit": "µm"}
        tifffile.imwrite(path, data, ome=True, photometric="minisblack", metadata=metadata)
        with layer_source(path=str(path)):
            viewer.add_image(data, name="both", **options)
        return path

    return add


@pytest.mark.parametrize("axes", ["ZCYX", "CZYX", "TCZYX"])
def test_the_file_says_which_channels_there_are(widget, viewer, pixels, from_file, axes, told):
    from_file(axes)
    words = "'both' has 2 channels (1 DAPI, 2 membrane): choose the one that shows the membranes"
    assert widget.image.note.text().startswith(words)
    widget.start()
    assert words in told[-1]
    assert channels(widget)[1:] == ["1 of 2, DAPI", "2 of 2, membrane"]
    choose(widget, "2 of 2, membrane")
    assert widget.doc.image.layer.name == "both, channel 2, membrane"
    np.testing.assert_array_equal(widget.doc.image.stack(), pixels)
    assert widget.image.voxel_size.value() == pytest.approx(SIZE)


def test_another_channel_can_be_chosen_after_the_first(widget, viewer, from_file):
    from_file()
    choose(widget, "1 of 2, DAPI")
    assert channels(widget)[1:] == ["1 of 2, DAPI", "2 of 2, membrane"]
    assert widget.image.channels.currentText() == "1 of 2, DAPI"
    camera = camera_of(viewer)
    zoom = camera.zoom
    choose(widget, "2 of 2, membrane")
    nuclei, membranes = (viewer.layers[f"both, channel {k}"] for k in ("1, DAPI", "2, membrane"))
    assert widget.doc.image.layer is membranes
    np.testing.assert_array_equal(membranes.scale, nuclei.scale)
    assert camera.zoom == zoom
    assert (nuclei.visible, membranes.visible) == (False, True)
    choose(widget, "1 of 2, DAPI")  # the same layer again
    assert widget.doc.image.layer is nuclei
    assert len(viewer.layers) == 3
    assert (nuclei.visible, membranes.visible) == (True, False)
    viewer.layers.remove("both")
    assert channels(widget)[1:] == []
    assert widget.doc.image.layer is nuclei


def command_of(widget, spin):
    widget.commands.copy_action.trigger()
    spin(lambda: not widget.commands.background.busy)
    return shlex.split(more_actions.QApplication.clipboard().text())[1:]


def test_the_channel_ends_in_the_command(
    widget, viewer, pixels, from_file, spin, tmp_path, monkeypatch
):
    monkeypatch.setattr(more_actions.QFileDialog, "getExistingDirectory", lambda *a: str(tmp_path))
    path = from_file()
    choose(widget, "2 of 2, membrane")
    viewer.add_points([CENTER], name="seeds", ndim=3)
    widget.seeds.cells.choose(viewer.layers["seeds"])
    words = command_of(widget, spin)
    assert words[1] == str(path)
    assert words[words.index("--channel") + 1] == "2"
    np.testing.assert_array_equal(gather(build_parser().parse_args(words), Notes()).image, pixels)
    # Edited voxels are in no file, nor is a channel of it.
    widget.doc.image.layer.data = pixels + 1
    words = command_of(widget, spin)
    assert words[1] == str(tmp_path / "image.tif")
    assert "--channel" not in words
    found = gather(build_parser().parse_args(words), Notes()).image
    np.testing.assert_array_equal(found, pixels + 1)


def test_a_session_can_be_run_again(widget, viewer, pixels, from_file, spin, tmp_path):
    path = from_file()
    choose(widget, "2 of 2, membrane")
    save(widget, tmp_path / "a.deltamic", spin)
    with zipfile.ZipFile(tmp_path / "a.deltamic") as archive:
        (tmp_path / "run.toml").write_bytes(archive.read("run.toml"))
    saved = RunSettings.from_toml(tmp_path / "run.toml")
    assert (saved.image, saved.channel) == (str(path), "2")
    words = ["fit", "--settings", tmp_path / "run.toml", "--seeds", "auto", "-o", tmp_path / "out"]
    job = gather(build_parser().parse_args([str(word) for word in words]), Notes())
    np.testing.assert_array_equal(job.image, pixels)
    assert job.settings.channel == "2"


@pytest.mark.parametrize(("name", "channel"), [("membrane", "2"), ("both [1]", None)])
def test_a_reader_that_splits_channels_names_them(widget, viewer, pixels, from_file, name, channel):
    path = from_file()
    viewer.layers.clear()
    with layer_source(path=str(path)):
        viewer.add_image(pixels, name=name)
    assert widget.doc.image.file()[1] == channel
    assert widget.doc.image.file()[0] == (str(path) if channel else "")


def test_tracking_says_the_channel(widget, viewer, from_file):
    path = from_file("TCZYX")
    choose(widget, "2 of 2, membrane")
    widget.image.voxel_size.set_value(SIZE)
    widget.doc.image.rescale(SIZE)
    viewer.add_points([CENTER], name="seeds", ndim=3)
    widget.seeds.cells.choose(viewer.layers["seeds"])
    seeds = widget.doc.cells.seeds(widget.doc.image.frame())
    settings = widget.tracking._settings(seeds, 0, 1.0)
    assert (settings.image, settings.channel) == (str(path), "2")


def test_a_second_view_names_no_file_of_several_channels(widget, viewer, pixels, from_file):
    from_file()
    choose(widget, "2 of 2, membrane")
    image = widget.doc.image.layer
    viewer.add_image(pixels, scale=image.scale, name="other")
    widget.doc.image.choose(viewer.layers["other"])
    second = widget.doc.second
    second.choose(image)
    assert second.view().image == ""
