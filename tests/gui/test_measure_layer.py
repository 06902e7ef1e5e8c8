"""Measuring a Surface layer from napari's menu."""

import csv
import time

import numpy as np
import pytest
from benchmarks.double_bubble import DoubleBubble
from napari.layers import Image, Layer, Surface

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.gui import small_widgets
from napari_deltamic.gui.small_widgets import measure_surface, measure_widget
from napari_deltamic.gui.viewing.frame import OWN
from napari_deltamic.gui.widgets import Note

UM = {"units": ("um",) * 3}


def measured(app, *arguments, **options):
    """What the worker comes back with; it ends before the test does."""
    found = []
    worker = measure_surface(*arguments, **options)
    worker.returned.connect(found.append)
    until = time.monotonic() + 60
    while not found and time.monotonic() < until:
        app.processEvents()
        time.sleep(0.01)
    return [Layer.create(*each) for each in found[0]]


@pytest.fixture(scope="module")
def mesh():
    return DoubleBubble(2.0, (1.0, 0.9, 1.2)).mesh(0.5).translated((5, 6, 7))


@pytest.fixture
def surface(mesh):
    """In nanometres, beside an image that does not begin at the origin."""
    return Surface(
        (mesh.translated((1, 2, 3)).vertices_numpy() * 1000, mesh.faces),
        scale=(1e-3,) * 3, metadata={OWN: {"regions": mesh.regions}}, name="bubble", **UM,
    )  # fmt: skip


@pytest.fixture
def image():
    return Image(np.zeros((40, 48, 52)), scale=(0.25,) * 3, translate=(1, 2, 3), name="i", **UM)


def test_it_has_a_field_for_each_argument(app):
    widget = measure_widget()
    assert widget.image.value is None
    assert widget.folder.value is None
    assert not widget.folder.line_edit.value, "not '.', which would be a folder"
    widget.close()


@pytest.fixture
def warned(monkeypatch):
    """What the user is told."""
    texts = []
    monkeypatch.setattr(small_widgets, "show_warning", texts.append)
    return texts


def test_mistakes_are_told_in_a_sentence(app, surface, warned, tmp_path):
    widget = measure_widget()
    widget.call_button.changed.emit(True)
    assert warned == ["there is no Surface layer to measure"]
    said = widget.native.findChild(Note)
    assert said.text() == "There is no Surface layer to measure."
    widget.surface.choices = [surface]
    assert said.text() == ""
    widget.call_button.changed.emit(True)
    assert warned[1:] == ["choose a folder for the tables, or an image for a layer with them"]
    (tmp_path / "cells.csv").touch()
    widget.folder.value = tmp_path
    widget.call_button.changed.emit(True)
    assert "choose another folder" in warned[2]
    assert len(warned) == 3
    assert widget.call_button.enabled
    widget.close()


def test_what_fails_in_the_thread_is_told_too(app, surface, warned, spin, tmp_path):
    (tmp_path / "file").touch()
    widget = measure_widget()
    widget.surface.choices = [surface]
    widget.folder.value = tmp_path / "file" / "out"
    widget.call_button.changed.emit(True)
    spin(lambda: warned)
    assert "Traceback" not in warned[0]
    assert "out" in warned[0]
    widget.close()


def test_cells_become_labels_with_features_on_the_voxels_of_the_image(app, mesh, surface, image):
    (labels,) = measured(app, surface, image)
    assert labels.name == "bubble: cells"
    np.testing.assert_allclose(labels.scale, image.scale)
    np.testing.assert_allclose(labels.translate, image.translate)
    assert labels.data.shape == image.data.shape
    volumes = list(mesh.volumes().values())
    np.testing.assert_allclose(labels.features["volume_um3"], volumes)
    assert list(labels.features["index"]) == [1, 2]
    assert list(labels.features["cut_by_border"]) == ["no", "no"]
    counted = np.bincount(labels.data.ravel())[1:] * 0.25**3
    np.testing.assert_allclose(counted, volumes, rtol=0.03)


def test_tables_in_a_folder(app, surface, tmp_path):
    assert measured(app, surface, folder=tmp_path / "out") == []
    with (tmp_path / "out" / "cells.csv").open() as stream:
        assert [row["neighbours"] for row in csv.DictReader(stream)] == ["2", "1"]
    with pytest.raises(nd.InputError, match="another folder"):
        measure_surface(surface, folder=tmp_path / "out")


def test_what_cannot_be_measured(app, surface, image):
    with pytest.raises(nd.InputError, match="no Surface layer"):
        measure_surface(None, image)
    with pytest.raises(nd.InputError, match="choose a folder"):
        measure_surface(surface)
    ball = sphere((1, 1, 1), 1.0)
    turned = Surface((ball.vertices_numpy(), ball.faces), rotate=(0, 0, 30), name="t", **UM)
    with pytest.raises(nd.InputError, match="rotated"):
        measure_surface(turned, image)
