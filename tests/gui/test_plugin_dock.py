"""The widget as napari opens it, with a proxy of the viewer: all of it works."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest

from napari_deltamic.gui import fit_widget

from .conftest import CENTER, SIZE
from .mouse import Mouse
from .seeding import PLACE


@pytest.fixture
def opened(window, pixels, ball_labels):
    """The widget in a dock that napari made, with labels to correct."""
    import npe2

    window.add_image(pixels, name="cell", **PLACE)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        npe2.PluginManager.instance().discover()
        _, widget = window.window.add_plugin_dock_widget("napari-deltamic")
    labels = window.add_labels(ball_labels.astype(np.int32), name="labels", **PLACE)
    yield widget, labels
    widget.close_links()


def click(window, widget, tool, place, spin):
    widget.seeds.corrections.bar.use(tool)
    window.dims.set_point(0, 1 + place[0])
    Mouse(window, SimpleNamespace(frame=widget.doc.image.frame())).drag(place)
    spin(lambda: not widget.seeds.corrections.busy)


def test_the_tools_that_correct_labels_work(window, opened, spin):
    widget, labels = opened
    assert isinstance(widget, fit_widget.FitWidget)
    click(window, widget, "remove", (1.5, 1.2, 1.2), spin)
    assert not labels.data.any()
    click(window, widget, "split", CENTER, spin)  # one that was missed
    assert labels.data[tuple(np.round(np.divide(CENTER, SIZE)).astype(int))] > 0
    widget.seeds.corrections.undo()
    assert not labels.data.any()


def test_a_fit_runs_and_its_cells_can_be_chosen(window, opened, spin):
    widget, labels = opened
    window.layers.remove(labels)
    widget.seeds.place.click()
    window.layers["seeds"].add(CENTER)
    widget.start()
    spin(lambda: not widget.doc.run.running)
    assert widget.results.table.rowCount() == 1
    assert widget.doc.link.image_layer is window.layers["cell"]
    window.dims.set_point(0, 1 + CENTER[0])
    Mouse(window, widget.doc.link).drag(CENTER)
    assert widget.results.table.chosen_regions() == (1,)
