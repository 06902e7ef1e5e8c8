"""Seeds in the widget: the preview of where a fit starts, and what may be wrong with points."""

import gc
import weakref

import numpy as np
import pytest

from napari_deltamic.gui import fit_widget
from napari_deltamic.gui.seeding import preview

from .conftest import CENTER, SHAPE, SIZE
from .seeding import FRAME, MEMBRANE, PLACE, SPHERE, add_points, texts

# Preview --------------------------------------------------------------------------------------


def test_a_click_is_followed_by_contours_and_a_surface(panel, with_image, spin):
    seeds = add_points(panel, with_image, CENTER)
    with_image.dims.set_point(0, 1 + CENTER[0])
    spin(lambda: "cell: start contours" in with_image.layers)
    contours = with_image.layers["cell: start contours"]
    assert len(contours.data) > 10
    assert with_image.layers.selection.active is seeds, "so that clicks go on"
    assert str(seeds.mode) == "add"
    assert [layer.name for layer in panel.cells.ticked] == ["seeds"]
    assert panel.chooser.count() == 1, "what the plugin shows is no source"
    assert not with_image.layers["cell: start"].visible, "only of use in 3D"
    with_image.dims.ndisplay = 3
    surface = with_image.layers["cell: start"]
    world = np.asarray(surface.data[0]) * surface.scale + surface.translate
    assert world.mean(axis=0) == pytest.approx(np.add(CENTER, (1, 2, 3)), abs=0.15)
    assert surface.visible
    with_image.dims.ndisplay = 2
    assert not surface.visible
    assert texts(panel) == []


def test_the_preview_goes_with_spheres_with_the_points_and_with_a_run(panel, with_image, spin):
    seeds = add_points(panel, with_image, CENTER)
    for hide, again in (
        (lambda: panel.shape.setCurrentIndex(SPHERE), lambda: panel.shape.setCurrentIndex(0)),
        (lambda: setattr(seeds, "data", np.zeros((0, 3))), lambda: seeds.add(CENTER)),
        (lambda: panel.preview.click(), lambda: panel.preview.click()),
        (lambda: panel.finish_placing(), lambda: seeds.add((1.5, 1.2, 1.2))),
    ):
        spin(lambda: panel.preview.mesh is not None)
        hide()
        spin(lambda: panel.preview.mesh is None)
        assert "cell: start contours" not in with_image.layers
        again()


def test_of_several_previews_the_latest_is_shown(panel, with_image, spin, held):
    gate, calls = held
    seeds = add_points(panel, with_image, CENTER)
    spin(lambda: calls == [1])
    assert "Looking for the membranes" in panel.remarks.text()
    seeds.add((50, 50, 50))  # outside: the preview goes on without it
    spin(lambda: panel.preview.background._waiting.isActive())
    spin(lambda: not panel.preview.background._waiting.isActive())
    assert calls == [1], "one thread at a time"
    gate.set()
    spin(lambda: panel.preview.mesh is not None)
    assert calls == [1, 2]
    assert panel.preview.mesh.region_ids().tolist() == [1]


def test_a_preview_that_is_removed_is_off(panel, with_image, spin):
    add_points(panel, with_image, CENTER)
    spin(lambda: "cell: start contours" in with_image.layers)
    del with_image.layers["cell: start contours"]
    assert not panel.preview.isChecked()
    spin(seconds=0.6, must=False)
    assert "cell: start contours" not in with_image.layers


def test_an_engine_that_fails_is_a_note(panel, with_image, spin, monkeypatch):
    def broken(*arguments):
        raise RuntimeError("something of scipy")

    monkeypatch.setattr(preview, "find", broken)
    add_points(panel, with_image, CENTER)
    spin(lambda: texts(panel))
    assert "something of scipy" in texts(panel)[0]
    assert "Traceback" not in texts(panel)[0]


def test_large_images_have_no_preview_until_it_is_wanted(panel):
    panel.preview.suit((60, 512, 512), SIZE)
    assert not panel.preview.isChecked()
    panel.preview.suit((29, 150, 150), (0.34, 0.133, 0.133))
    assert panel.preview.isChecked()
    panel.preview.click()
    panel.preview.suit(SHAPE, SIZE)
    assert not panel.preview.isChecked(), "the user has chosen"


@pytest.mark.slow
def test_closing_releases_a_panel_whose_preview_is_under_way(window, pixels, spin, held):
    gate, calls = held
    window.add_image(pixels, scale=SIZE, name="cell")
    widget = fit_widget.FitWidget(window)
    window.window.add_dock_widget(widget, name="deltaMic")
    layer = add_points(widget.seeds, window, CENTER)
    widget.seeds.shape.setCurrentIndex(SPHERE)  # has listened to the mouse, too
    widget.seeds.shape.setCurrentIndex(MEMBRANE)
    spin(lambda: calls)
    panel = widget.seeds
    parts = (widget, panel, panel.chooser, panel.preview, panel.preview.background, panel.remarks)
    refs = [weakref.ref(part) for part in parts]
    window.window.remove_dock_widget(widget)
    del widget, panel, parts
    spin(seconds=0.2, must=False)
    gc.collect()
    assert [ref() for ref in refs] == [None] * len(refs), "while the thread still runs"
    gate.set()
    layer.add(CENTER)
    spin(seconds=0.7, must=False)
    assert len(calls) == 1
    assert "cell: start contours" not in window.layers


@pytest.mark.slow
def test_a_closed_panel_shows_nothing_more(panel, with_image, spin, held):
    gate, calls = held
    layer = add_points(panel, with_image, CENTER)
    spin(lambda: calls)
    panel._doc.close()
    gate.set()
    layer.add((1.5, 1.2, 1.2))
    spin(seconds=0.7, must=False)
    assert len(calls) == 1
    assert "cell: start contours" not in with_image.layers


@pytest.mark.slow
def test_closing_the_dock_takes_the_preview_away(window, pixels, spin):
    window.add_image(pixels, scale=SIZE, name="cell")
    widget = fit_widget.FitWidget(window)
    window.window.add_dock_widget(widget, name="deltaMic")
    add_points(widget.seeds, window, CENTER)
    spin(lambda: "cell: start contours" in window.layers)
    window.window.remove_dock_widget(widget)
    assert "cell: start contours" not in window.layers


# Warnings -------------------------------------------------------------------------------------


def test_points_outside_are_named_and_can_be_shown(panel, with_image, spin):
    layer = add_points(panel, with_image, CENTER, (50, 1, 1), (1, -2, 1))
    spin(lambda: texts(panel))
    assert texts(panel) == ["Points 2 and 3 lie outside the image: move or delete them"]
    panel.remarks.linkActivated.emit("0")
    assert layer.selected_data == {1, 2}
    assert str(layer.mode) == "select"
    layer.remove_selected()
    spin(lambda: not texts(panel))
    assert not panel.remarks.text() or "Looking" in panel.remarks.text()


def test_two_points_in_one_cell_are_told_by_the_preview(panel, with_image, spin):
    layer = add_points(panel, with_image, (50, 1, 1), CENTER, np.add(CENTER, (0, 0.2, 0.2)))
    spin(lambda: len(texts(panel)) == 2)
    assert texts(panel)[1] == "Points 2 and 3 are in the same cell: delete one"
    assert panel.preview.mesh is not None, "of the other"
    panel.remarks.show_points("1")
    assert layer.selected_data == {1, 2}
    assert with_image.dims.point[0] == pytest.approx(1 + CENTER[0], abs=SIZE[0] / 2)


def test_a_point_on_a_membrane_is_told_and_others_are_shown(panel, with_image, spin):
    add_points(panel, with_image, CENTER, (0.1, 0.1, 0.1))
    spin(lambda: texts(panel))
    assert texts(panel)[0].startswith("Point 2 ")
    assert panel.preview.mesh is not None


def test_two_spheres_in_one_cell(panel, with_image, spin):
    panel.shape.setCurrentIndex(SPHERE)
    panel.radius.setValue(0.9)
    layer = add_points(panel, with_image, CENTER, np.add(CENTER, (0, 0.5, 0.5)))
    spin(lambda: texts(panel))
    assert texts(panel) == ["Points 1 and 2 are in one sphere: are they in one cell?"]
    layer.selected_data = set()
    panel.radius.setValue(0.5)
    np.testing.assert_allclose(layer.size, 1.0, rtol=1e-2)
    spin(lambda: not texts(panel))


def test_a_point_in_a_label(panel, with_image, ball_labels, spin):
    labels = with_image.add_labels(ball_labels, name="found", **PLACE)
    add_points(panel, with_image, (1.5, 1.2, 1.2))
    panel.shape.setCurrentIndex(SPHERE)
    spin(lambda: texts(panel))
    assert texts(panel) == ["Point 1 lies in a label of 'found': two seeds in one cell"]
    labels.data_setitem(np.nonzero(ball_labels), 0)  # as the eraser does
    spin(lambda: not texts(panel))


def test_points_of_two_layers_are_told_apart(panel, with_image, spin):
    add_points(panel, with_image, CENTER)
    with_image.add_points([np.add(CENTER, (0, 0.2, 0.2))], name="more", **FRAME)
    spin(lambda: texts(panel))
    assert texts(panel) == ["Points 1 of 'seeds' and 1 of 'more' are in the same cell: delete one"]
