"""The layers that show a fit, when layers of the user go meanwhile."""

import numpy as np
import pytest

from napari_deltamic.geometry import sphere
from napari_deltamic.gui.viewing.frame import Frame, camera_of
from napari_deltamic.gui.viewing.viewer_link import ViewerLink, limits_of

from .conftest import SIZE


def test_the_rendered_image_is_shown_though_the_measured_one_was_removed(viewer):
    pixels = np.zeros((6, 7, 8))
    layer = viewer.add_image(pixels, name="cell")
    link = ViewerLink(viewer, layer, Frame.of(layer))
    link.show_mesh(sphere((3, 3, 3), 2, edge_length=1))
    viewer.layers.remove(layer)
    link.take_images(pixels, pixels)
    for view in ("rendered", "residual"):
        link.look(view)
    link.close()
    assert {"cell: rendered", "cell: residual"} <= {one.name for one in viewer.layers}


@pytest.mark.parametrize("view", ["rendered", "residual"])
def test_each_image_is_there_once_though_it_alone_makes_the_slices(viewer, view):
    """Without another layer, adding it moves the slices, which asks for it anew."""
    pixels = np.zeros((6, 7, 8))
    layer = viewer.add_image(pixels, scale=SIZE, name="cell", units=("um",) * 3)
    link = ViewerLink(viewer, layer, Frame.of(layer))
    link.show_mesh(sphere((0.9, 0.7, 0.8), 0.4, edge_length=0.2))
    link.take_images(pixels, pixels)
    viewer.layers.clear()
    link.look(view)
    assert [one.name for one in viewer.layers] == [f"cell: {view}"]
    link.close()


def test_a_residual_that_is_large_in_many_places_is_not_saturated_there(viewer):
    noise = np.random.default_rng(0).normal(size=(6, 7, 8))
    assert limits_of(noise) == (-5, 5)
    assert limits_of(noise - 30) == (-31, 31)
    assert limits_of(np.full((2, 2, 2), np.nan)) == (-5, 5)
    layer = viewer.add_image(np.zeros((6, 7, 8)), name="cell")
    link = ViewerLink(viewer, layer, Frame.of(layer))
    link.take_images(noise, noise - 30)
    link.look("residual")
    shown = viewer.layers["cell: residual"]
    assert shown.contrast_limits == [-31, 31]
    link.take_images(noise, noise)
    assert shown.contrast_limits == [-5, 5]
    shown.contrast_limits = (-2, 2)
    link.take_images(noise, noise - 30)
    assert shown.contrast_limits == [-2, 2], "the user chose them"
    link.close()


def test_both_images_are_seen_side_by_side_and_then_what_was_seen_before(viewer):
    pixels = np.zeros((6, 70, 80))
    layer = viewer.add_image(pixels, name="cell")
    link = ViewerLink(viewer, layer, Frame.of(layer))
    link.take_images(pixels, pixels)
    camera = camera_of(viewer)
    camera.center, camera.zoom = (3, 20, 30), 8.0
    link.look("side by side")
    both = viewer.layers.extent.world[:, 2]
    assert camera.center[2] == pytest.approx(both.mean(), abs=1)
    assert camera.zoom < 8
    link.look("image")
    assert camera.center == (3, 20, 30)
    assert camera.zoom == 8
    link.look("side by side")
    viewer.dims.order = (1, 0, 2)
    wide = camera.zoom
    link.look("image")
    assert camera.zoom == wide, "what was seen before is another slice"
    link.close()


def test_an_image_that_was_removed_is_there_again_when_it_is_asked_for(viewer):
    pixels = np.zeros((6, 7, 8))
    layer = viewer.add_image(pixels, name="cell")
    link = ViewerLink(viewer, layer, Frame.of(layer))
    link.take_images(pixels, pixels)
    for view in ("rendered", "residual"):
        link.look(view)
        viewer.layers.remove(f"cell: {view}")
        link.take_images(pixels, pixels)
        assert f"cell: {view}" not in viewer.layers
        link.look("image")
        link.look(view)
        assert viewer.layers[f"cell: {view}"].visible
    link.close()
