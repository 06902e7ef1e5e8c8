"""The panel of five steps: few controls in sight, and those of a fit always."""

import numpy as np
import pytest
from qtpy.QtCore import QPoint, QRect
from qtpy.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QAbstractSlider,
    QAbstractSpinBox,
    QComboBox,
    QLineEdit,
    QScrollBar,
    QWidget,
)

from napari_deltamic.geometry.labels.bright_cells import CellsFound
from napari_deltamic.gui.fit_widget import FitWidget
from napari_deltamic.gui.widgets import Fold

from .seeding import PLACE

CONTROLS = (
    QAbstractButton,
    QComboBox,
    QAbstractSpinBox,
    QAbstractSlider,
    QLineEdit,
    QAbstractItemView,
)
MOST = 20


@pytest.fixture
def shown(make_widget, spin):
    """The widget as large as its dock is in a window of 1280 x 800."""
    widget = make_widget()
    widget.resize(390, 700)
    widget.show()
    spin(seconds=0.2, must=False)
    return widget


def in_sight(widget):
    """The controls that a user meets, with those below, to which one would scroll."""
    found = []
    for control in widget.findChildren(QWidget):
        if not isinstance(control, CONTROLS) or isinstance(control, QScrollBar):
            continue
        around = control.parentWidget()
        while around is not widget and not isinstance(around, CONTROLS):
            around = around.parentWidget()
        # A part of another control, such as the line of a spin box, is none of its own.
        if around is widget and not type(control.parentWidget()).__name__.startswith("QLabeled"):
            found.append(control)
    return [control for control in found if control.isVisible()]


def seen(widget, window):
    """Whether all of a widget lies in the window, and nothing hides it."""
    whole = QRect(widget.mapTo(window, QPoint(0, 0)), widget.size())
    return (
        widget.isVisible()
        and window.rect().contains(whole)
        and widget.visibleRegion().boundingRect() == widget.rect()
    )


def test_few_controls_are_in_sight_before_a_fit(shown, with_image, ball_labels, spin):
    assert 10 < len(in_sight(shown)) <= MOST
    # The most: cells were found, and may be corrected.
    finder = shown.seeds.find_cells
    found = CellsFound(ball_labels.astype(np.int32), 1.0, False)
    finder._show(with_image.layers["cell"], shown.doc.image.frame(), 1.0, found)
    spin(seconds=0.3, must=False)
    assert shown.seeds.corrections.bar.isVisible()
    names = [type(control).__name__ for control in in_sight(shown)]
    assert len(names) <= MOST, names


def test_fit_stop_and_progress_are_always_in_sight(shown, with_image, ball_labels, spin, endless):
    with_image.add_labels(ball_labels, **PLACE)
    footer = shown.footer
    shown.start()
    spin(lambda: len(shown.doc.timeline.moments) > 2)
    for fold in shown.findChildren(Fold):
        fold.unfold()
    shown.image.edit_size.setChecked(True)
    spin(seconds=0.3, must=False)
    assert shown.height() <= 700
    for part in (footer.run_button, footer.pause_button, footer.stop_button, footer.progress):
        assert seen(part, shown)
    shown.stop()
    spin(lambda: not shown.doc.run.running)
    spin(lambda: shown.results.isVisible())
    assert seen(footer.run_button, shown)


def test_steps_are_numbered_in_their_order(shown):
    panels = (shown.image, shown.seeds, shown.settings, shown.running, shown.results)
    assert [panel.title()[0] for panel in panels] == list("12345")
    assert shown.running.isHidden()
    assert shown.results.isHidden()
    assert shown.settings.advanced.content.isHidden()


def test_what_is_rare_is_in_the_menu(shown):
    titles = [action.text() for action in shown.header.menu.actions() if action.text()]
    assert titles == [
        "Open session...",
        "Save session...",
        "Copy as command",
        "Prepare a batch...",
        "Simulate cells...",
    ]


def test_without_an_image_no_width_is_made_up(app, viewer, spin):
    widget = FitWidget(viewer)
    told = "PSF: as wide as the blur of the image, then fitted with the shapes"
    assert widget.settings.psf_line.text() == told
    viewer.add_image(np.zeros((4, 8, 8)), scale=(0.5, 0.2, 0.2), units=("um",) * 3)
    assert widget.settings.psf_line.text() == told
    assert widget.doc.settings.scene_settings().sigma == pytest.approx((0.6, 0.24, 0.24))
    assert widget.doc.settings.psf_is_open
    widget.settings.sigma._boxes[0].setValue(0.7)
    told = "PSF: Gaussian 0.70 (z), 0.24 (yx) µm, then fitted with the shapes"
    assert widget.settings.psf_line.text() == told
    widget.close_links()


def test_the_psf_can_be_changed_from_its_line(shown, spin):
    shown.settings.psf_button.click()
    spin(seconds=0.1, must=False)
    assert shown.settings.optics.isVisible()
