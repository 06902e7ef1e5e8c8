"""The widget that simulates cells: its fields, its layers, and what it refuses."""

import time

import numpy as np
import pytest
from napari.layers import Layer

import napari_deltamic as nd
from napari_deltamic.common.choices import IMMERSIONS
from napari_deltamic.common.description import described
from napari_deltamic.gui import small_widgets
from napari_deltamic.gui.small_widgets import simulate_cells, simulate_widget
from napari_deltamic.gui.viewing.frame import OWN
from napari_deltamic.runs.optics_settings import MicroscopeOptics

SMALL = {"cells": 2, "shape": (20, 24, 24), "kind": "vesicles"}


def layers(app, **options):
    """What the worker comes back with; it ends before the test does."""
    found = []
    worker = simulate_cells(**{**SMALL, **options})
    worker.returned.connect(found.append)
    until = time.monotonic() + 60
    while not found and time.monotonic() < until:
        app.processEvents()
        time.sleep(0.01)
    return [Layer.create(*each) for each in found[0]]


def test_every_argument_has_a_field(app):
    widget = simulate_widget()
    assert widget.cells.value == 4
    assert widget.voxel_size.value == pytest.approx((0.3, 0.2, 0.2))
    assert widget.kind.choices == ("foam", "vesicles")
    assert widget.effects.value == "none"
    assert (widget.na.value, widget.immersion.value) == (0.8, "water")
    said = described(MicroscopeOptics)
    assert widget.wavelength.tooltip == said["wavelength"].sentence
    assert widget.wavelength.label == "emission, µm"
    assert widget.immersion.choices == tuple(IMMERSIONS)
    widget.show()
    assert (widget.sigma.visible, widget.na.visible) == (True, False)
    widget.psf.value = "confocal"
    assert (widget.sigma.visible, widget.na.visible) == (False, True)
    widget.close()


def test_image_and_labels_lie_on_each_other(app):
    image, _, labels = layers(app, seed=3)
    assert image.data.shape == labels.data.shape == (20, 24, 24)
    np.testing.assert_allclose(image.scale, labels.scale)
    assert image.data.dtype == np.uint16
    assert set(np.unique(labels.data)) == {0, 1, 2}
    assert [str(u) for u in image.units] == ["micrometer"] * 3
    assert image.axis_labels == labels.axis_labels == ("z", "y", "x")
    again, *_ = layers(app, seed=3)
    np.testing.assert_array_equal(image.data, again.data)


def test_the_true_surfaces_are_those_of_the_labels(app):
    _, surface, labels = layers(app, seed=3)
    voxel = np.prod(labels.scale)
    vertices, faces, _ = surface.data
    mesh = nd.Mesh(vertices, faces, surface.metadata[OWN]["regions"])
    for region in (1, 2):
        counted = voxel * (labels.data == region).sum()
        assert mesh.volumes()[region] == pytest.approx(counted, rel=0.1)


def test_the_psf_may_be_that_of_a_microscope(app):
    image, *_ = layers(app, seed=3, psf="confocal", na=0.8)
    other, *_ = layers(app, seed=3)
    assert np.abs(image.data.astype(float) - other.data).mean() > 1


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"psf": "widefield", "na": 1.5}, "must be below"),
        ({"effects": "magic"}, "unknown effect"),
        ({"shape": (0, 9, 9)}, "three positive"),
    ],
)
def test_bad_input_is_refused_at_once(app, options, says):
    with pytest.raises(nd.InputError, match=says):
        simulate_cells(**{**SMALL, **options})


def test_a_mistake_is_told_in_a_sentence(app, monkeypatch):
    texts = []
    monkeypatch.setattr(small_widgets, "show_warning", texts.append)
    widget = simulate_widget()
    widget.effects.value = "foo"
    widget.call_button.changed.emit(True)
    (text,) = texts
    assert text.startswith("unknown effect")
    widget.close()
