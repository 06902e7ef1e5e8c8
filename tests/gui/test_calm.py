"""What a first user sees: a narrow column with what is needed now, and nothing over the meshes."""

import re

import numpy as np
import pytest
from qtpy.QtCore import Qt
from qtpy.QtGui import QAction
from qtpy.QtWidgets import QAbstractSpinBox, QCheckBox, QComboBox, QPushButton, QSlider, QWidget

from napari_deltamic.geometry.labels.bright_cells import CellsFound
from napari_deltamic.gui import fit_widget
from napari_deltamic.gui.fit_widget import Column
from napari_deltamic.gui.viewing.colours import region_colours

from .conftest import CENTER, SIZE
from .seeding import PLACE

NARROW = 300


@pytest.fixture
def docked(window, pixels):
    window.add_image(pixels, scale=SIZE, name="a long name of a series exported from somewhere")
    widget = fit_widget.FitWidget(window)
    dock = window.window.add_dock_widget(widget, name="deltaMic")
    return widget, dock


@pytest.mark.slow
@pytest.mark.usefixtures("judged")
def test_the_dock_may_be_narrow_whatever_it_shows(window, docked, spin):
    widget, dock = docked
    widget.seeds.place.click()
    window.layers["seeds"].add(CENTER)
    widget.start()
    spin(lambda: not widget.doc.run.running)
    settings = widget.settings
    for fold in (settings.more, settings.psf_fold, settings.effects_fold):
        fold.unfold()
    settings.optics.kind.setCurrentText("from the objective")
    settings.optics.objective.modality.setCurrentText("spinning disk")
    widget.running.edit.use("pin")
    for row in (widget.footer.pause_button, widget.running.history.live_button):
        row.show()
    spin(seconds=0.2, must=False)
    assert dock.minimumSizeHint().width() <= NARROW
    # Nothing in the column is cut off.
    column = widget.findChild(Column)
    needed = column.widget().minimumSizeHint().width()
    assert needed <= min(NARROW, column.viewport().width())


def test_the_voxel_size_can_be_read(docked, spin):
    widget, _ = docked
    widget.show()
    spin(seconds=0.2, must=False)
    for box in widget.image.voxel_size._boxes:
        assert box.lineEdit().width() > 35


def test_what_belongs_to_a_fit_is_hidden_until_there_is_one(seeded, spin):
    running = seeded.running
    parts = (running.curve, running.edit, running.history, seeded.results)
    assert all(part.isHidden() for part in parts)
    seeded.start()
    spin(lambda: not seeded.doc.run.running)
    assert not any(part.isHidden() for part in parts)


def test_settings_unfold(seeded):
    more = seeded.settings.more
    assert more.content.isHidden()
    more.button.click()
    assert not more.content.isHidden()
    more.button.click()
    assert more.content.isHidden()


def test_the_preview_stays_until_the_meshes_are_there(make_widget, with_image, spin):
    widget = make_widget()
    widget.seeds.place.click()
    with_image.layers["seeds"].add(CENTER)
    spin(lambda: widget.seeds.preview.mesh is not None)
    widget.start()
    assert "cell: start contours" in with_image.layers
    spin(lambda: widget.doc.link.mesh is not None)
    assert "cell: start contours" not in with_image.layers


def test_found_cells_make_room_and_have_the_colours_of_the_result(
    make_widget, with_image, ball_labels, spin
):
    widget = make_widget()
    finder = widget.seeds.find_cells
    assert finder.cell_size.isHidden()
    found = CellsFound(ball_labels.astype(np.int32), 1.0, False)
    finder._show(with_image.layers["cell"], widget.doc.image.frame(), 1.0, found)
    assert not finder.cell_size.isHidden()
    layer = with_image.layers["found cells"]
    np.testing.assert_allclose(layer.get_color(3), region_colours(3), atol=1e-6)
    # One that is added beside it, with a number that would have the same colour.
    moved = np.roll(ball_labels, 6, axis=2) == 3
    layer.data_setitem(np.nonzero(moved & (ball_labels == 0)), 3 + 8)
    assert np.abs(layer.get_color(3) - layer.get_color(11)).max() > 0.1
    other = with_image.add_labels(ball_labels, **PLACE)
    widget.seeds.cells.choose(other, False)
    widget.start()
    assert layer.visible
    spin(lambda: widget.doc.link is not None and widget.doc.link.mesh is not None)
    assert not layer.visible
    assert other.visible  # the user's own


def test_every_field_has_a_tooltip_and_takes_the_keyboard(make_widget):
    widget = make_widget()
    kinds = (QPushButton, QCheckBox, QComboBox, QAbstractSpinBox, QSlider)
    fields = [field for field in widget.findChildren(QWidget) if isinstance(field, kinds)]
    assert len(fields) > 60
    for field in fields:
        around = [field]
        while around[-1] is not widget:
            around.append(around[-1].parentWidget())
        assert any(one.toolTip() for one in around), field
        assert field.focusPolicy() != Qt.FocusPolicy.NoFocus, field
    actions, table = widget.findChildren(QAction), widget.results.table
    headers = [table.horizontalHeaderItem(number) for number in range(table.columnCount())]
    for one in (*widget.findChildren(QWidget), *actions, *headers):
        assert not re.search(r"\bum\b", one.toolTip()), one.toolTip()
