"""What the user looks at stays: slice and zoom when voxels change, the slider's steps in a fit."""

import os

import numpy as np
import pytest
import tifffile
from napari.layers._source import layer_source

from napari_deltamic.gui import fit_widget
from napari_deltamic.images.stacks import write_image

from .conftest import CENTER, SHAPE, SIZE


def camera(viewer):
    return getattr(viewer, "scene", viewer).camera


def look(viewer, slice_):
    """At a slice, closely, beside the middle."""
    viewer.dims.set_current_step(0, slice_)
    camera(viewer).center, camera(viewer).zoom = (0, 7.0, 9.0), 30.0


def seen(viewer, layer):
    """Slice, and the voxels in the middle of the canvas and 100 pixels away from it."""
    center, zoom = np.array(camera(viewer).center)[-2:], camera(viewer).zoom
    places = [(viewer.dims.point[0], *(center + away / zoom)) for away in (0, 100)]
    return viewer.dims.current_step[0], [np.round(layer.world_to_data(p), 6) for p in places]


@pytest.fixture
def unscaled(app, viewer, pixels):
    layer = viewer.add_image(pixels, name="cell")
    widget = fit_widget.FitWidget(viewer)
    yield widget, viewer, layer
    widget.close_links()


def test_the_view_stays_when_the_voxel_size_is_typed(unscaled):
    widget, viewer, layer = unscaled
    look(viewer, 6)
    before = seen(viewer, layer)
    for box, size in zip(widget.image.voxel_size._boxes, (0.3, 0.2, 0.2), strict=True):
        box.setValue(size)
    assert tuple(layer.scale) == (0.3, 0.2, 0.2)
    after = seen(viewer, layer)
    assert after[0] == before[0] == 6
    np.testing.assert_allclose(after[1], before[1], atol=1e-4)


def test_the_slice_stays_with_labels_on_the_image(unscaled):
    """napari keeps the number of the step where the finest one changes, and clips it."""
    widget, viewer, layer = unscaled
    labels = viewer.add_labels(np.zeros(layer.data.shape, np.uint8), scale=layer.scale)
    look(viewer, 6)
    for size in ((1.2, 0.2, 0.2), (0.3, 0.2, 0.2)):
        widget.doc.image.rescale(size)
        assert tuple(labels.scale) == tuple(layer.scale) == size
        assert viewer.dims.current_step[0] == 6


def units(layer):
    return {str(unit) for unit in layer.units[-3:]}


def test_a_size_that_is_typed_is_in_um(unscaled):
    """For napari as well: its scale bar said "2 pixel"."""
    widget, viewer, layer = unscaled
    widget.seeds.place.click()
    viewer.layers["seeds"].add((3, 4, 5))
    labels = viewer.add_labels(np.ones(SHAPE, int), name="labels")
    assert units(layer) == {"pixel"}
    widget.image.voxel_size._boxes[0].setValue(0.3)
    for one in (layer, labels, viewer.layers["seeds"]):
        assert units(one) == {"micrometer"}
    assert viewer.layers.extent.units is not None  # they are all alike
    widget.image.voxel_size._boxes[2].setValue(0.2)
    assert tuple(layer.scale) == tuple(labels.scale) == (0.3, 1, 0.2)
    assert widget.image.voxel_size.value() == (0.3, 1, 0.2)


@pytest.fixture
def movie(tmp_path, pixels):
    """The file of a series that notes its voxel size, as an image of ImageJ; and its voxels."""
    path, frames = tmp_path / "movie.tif", np.stack([pixels, pixels + 1])
    resolution = (1 / SIZE[2], 1 / SIZE[1])
    metadata = {"axes": "TZYX", "spacing": SIZE[0], "unit": "um"}
    tifffile.imwrite(path, frames, imagej=True, resolution=resolution, metadata=metadata)
    return str(path), frames


def test_a_series_has_the_voxel_size_of_its_file(app, viewer, movie):
    path, frames = movie
    with layer_source(path=path):
        layer = viewer.add_image(frames, scale=(5, 1, 1, 1), name="movie")
    widget = fit_widget.FitWidget(viewer)
    assert tuple(layer.scale) == pytest.approx((5, *SIZE))
    assert units(layer) == {"micrometer"}
    assert str(layer.units[0]) == "pixel"
    assert widget.image.voxel_size.value() == pytest.approx(SIZE)
    widget.close_links()


def test_a_large_file_is_asked_for_its_voxel_size_too(app, viewer, movie):
    path, frames = movie
    os.truncate(path, 300_000_000)  # which takes no room on the disk
    with layer_source(path=path):
        viewer.add_image(frames, name="movie")
    widget = fit_widget.FitWidget(viewer)
    assert widget.image.voxel_size.value() == pytest.approx(SIZE)
    widget.close_links()


def test_the_view_stays_when_the_size_is_read(app, viewer, pixels, tmp_path):
    write_image(tmp_path / "cell.tif", pixels, SIZE)
    with layer_source(path=str(tmp_path / "cell.tif")):
        layer = viewer.add_image(pixels, name="cell")
    look(viewer, 6)
    before = seen(viewer, layer)
    widget = fit_widget.FitWidget(viewer)
    assert tuple(layer.scale) == pytest.approx(SIZE)
    after = seen(viewer, layer)
    assert after[0] == before[0]
    np.testing.assert_allclose(after[1], before[1], atol=1e-4)
    widget.close_links()


def test_an_image_that_is_opened_beside_the_widget_is_shown_whole(app, viewer, pixels, tmp_path):
    write_image(tmp_path / "cell.tif", pixels, SIZE)
    widget = fit_widget.FitWidget(viewer)
    with layer_source(path=str(tmp_path / "cell.tif")):
        layer = viewer.add_image(pixels, name="cell")
    assert tuple(layer.scale) == pytest.approx(SIZE)
    assert viewer.dims.current_step[0] == (SHAPE[0] - 1) // 2
    found = camera(viewer).center, camera(viewer).zoom
    viewer.reset_view()
    assert found == (pytest.approx(camera(viewer).center), pytest.approx(camera(viewer).zoom))
    widget.close_links()


@pytest.mark.parametrize("thick", [1.0, pytest.param(15.0, marks=pytest.mark.slow)])
def test_the_slider_keeps_the_steps_of_the_image(app, viewer, pixels, spin, thick):
    size = np.multiply(SIZE, thick)
    layer = viewer.add_image(pixels, scale=size, name="cell")
    viewer.dims.set_current_step(0, 4)
    before = viewer.dims.range, viewer.dims.current_step
    widget = fit_widget.FitWidget(viewer)
    widget.seeds.place.click()
    viewer.layers["seeds"].add(np.multiply(CENTER, thick))
    assert (viewer.dims.range, viewer.dims.current_step) == before
    widget.settings.max_iterations.setValue(3)
    widget.seeds.shape.setCurrentText("a sphere")
    # One that reaches out of the image.
    viewer.layers["seeds"].size = 2.2 * CENTER[0] * thick
    widget.start()
    spin(lambda: not widget.doc.run.running)
    assert "cell: surfaces" in viewer.layers
    assert (viewer.dims.range, viewer.dims.current_step) == before
    # They follow the image, and are as before for themselves.
    layer.scale = 2 * size
    assert viewer.dims.range[0].step == pytest.approx(2 * size[0])
    viewer.layers["cell: surfaces"].translate = (1, 1, 1)
    viewer.layers.remove(layer)
    assert np.isfinite(viewer.dims.range).all()
    widget.close_links()


def test_the_box_of_the_slices_shows_how_the_viewer_was_turned(make_widget, with_image):
    box, dims = make_widget().running.slice, with_image.dims
    for order, name in (((2, 0, 1), "YZ"), ((1, 2, 0), "XZ"), ((0, 2, 1), "XY"), ((1, 0, 2), "XZ")):
        dims.order = order
        assert box.currentText() == name
    with_image.add_image(np.zeros((2, 4, 5, 6)))
    dims.order = (0, 3, 1, 2)
    assert box.currentText() == "YZ"
    dims.order = (1, 0, 2, 3)
    assert box.currentText() == "XY"
    dims.order = (3, 2, 1, 0)
    assert box.currentText() == "", "the slices are across time"
