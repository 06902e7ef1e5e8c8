"""Seeds that somebody gives and nobody expects: they are sized, told, or refused in words."""

import numpy as np
import pytest
from napari.layers import Image, Points, Surface

from napari_deltamic.errors import InputError
from napari_deltamic.geometry import sphere
from napari_deltamic.gui.cell_source import mesh_of_surface, seeds_from_layer
from napari_deltamic.gui.viewing.frame import OWN, Frame

from .conftest import CENTER, SIZE
from .seeding import SPHERE, add_points, taken, texts

SHAPE = (6, 8, 10)


def test_points_that_become_spheres_all_have_the_radius(panel, with_image):
    add_points(panel, with_image, CENTER, (1.5, 1.2, 1.2), (4.0, 3.0, 3.0))
    assert with_image.layers["seeds"].selected_data == {2}  # napari's: what was added last
    panel.shape.setCurrentIndex(SPHERE)
    panel.radius.setValue(panel.radius.value())
    assert taken(panel).radii == pytest.approx([panel.radius.value()] * 3)


@pytest.mark.filterwarnings("ignore:invalid value")  # in napari's thumbnail
@pytest.mark.parametrize("kind", [0, SPHERE])
@pytest.mark.usefixtures("soon")
def test_a_point_without_a_place_is_named(panel, with_image, spin, kind, monkeypatch):
    errors = []
    monkeypatch.setattr("sys.excepthook", lambda *error: errors.append(error))
    panel.shape.setCurrentIndex(kind)
    seeds = add_points(panel, with_image, CENTER, (1.5, 1.2, 1.2))
    seeds.data = [CENTER, (1.5, np.nan, 1.2)]
    spin(lambda: any("has no position" in text for text in texts(panel)))
    assert any("Point 2 " in text for text in texts(panel))
    with pytest.raises(InputError, match="point 2 has no position"):
        taken(panel)
    seeds.data = [CENTER]
    spin(lambda: not texts(panel))
    assert not errors


def test_what_is_left_out_of_a_fit_is_told_until_the_cells_change(
    make_widget, with_image, ball_labels, spin, endless, told
):
    layer = with_image.layers["cell"]
    labels = with_image.add_labels(
        ball_labels, scale=SIZE, translate=layer.translate, units=layer.units
    )
    labels.data[15, 20, 20] = 8
    widget = make_widget()
    widget.start()
    spin(lambda: widget.doc.link is not None and widget.doc.link.mesh is not None)
    assert any("label 8" in text for text in told)
    widget.stop()
    spin(lambda: not widget.doc.running)
    assert texts(widget.seeds) == [
        "1 of 2 labels is left out: label 8 is too small for edges of 0.4 um"
    ]
    labels.data_setitem((np.array([15]), np.array([20]), np.array([20])), 0)
    spin(lambda: not texts(widget.seeds))


@pytest.mark.usefixtures("soon")
def test_an_image_that_is_removed_while_a_preview_is_computed(
    panel, with_image, pixels, spin, held, monkeypatch
):
    errors = []
    monkeypatch.setattr("sys.excepthook", lambda *error: errors.append(error))
    gate, calls = held
    add_points(panel, with_image, CENTER)
    spin(lambda: calls == [1])
    monkeypatch.setattr(
        panel._later, "soon", lambda *asked: None
    )  # the preview is not asked anew yet
    del with_image.layers["cell"]
    gate.set()
    spin(lambda: not panel.preview.background.busy)
    assert not errors
    assert panel.preview.mesh is None


def test_an_image_that_is_mirrored_is_refused(make_widget, with_image, told):
    widget = make_widget()
    with_image.layers["cell"].scale = (SIZE[0], -SIZE[1], SIZE[2])
    assert "mirrored" in widget.image.note.text()
    widget.start()
    assert "mirrored" in told[-1]
    assert widget.doc.run is None
    widget.image.voxel_size._boxes[1].setValue(0.21)
    assert "mirrored" not in widget.image.note.text()


def test_seeds_that_are_mirrored_lie_where_they_are_drawn():
    frame = Frame.of(Image(np.zeros(SHAPE), scale=SIZE))
    options = {"scale": (1, -1, 1), "translate": (0, 2, 0)}
    points = Points([[0.5, 0.4, 0.6]], **options)
    np.testing.assert_allclose(
        seeds_from_layer(points, frame, (), spheres=False).points, [[0.5, 1.6, 0.6]]
    )
    spheres = seeds_from_layer(
        Points([[0.5, 0.4, 0.6]], size=0.4, **options), frame, (), spheres=True
    )
    np.testing.assert_allclose(spheres.radii, [0.2])
    ball = sphere((1, 1.5, 1), 0.5)
    for regions in (None, np.tile([4, 0], (len(ball.faces), 1))):
        own = {} if regions is None else {OWN: {"regions": regions}}
        mesh = mesh_of_surface(Surface((ball.vertices, ball.faces), metadata=own, **options), frame)
        (region,) = mesh.region_ids()
        assert mesh.region_volume(region) > 0
        assert mesh.vertices_numpy().mean(axis=0) == pytest.approx((1, 0.5, 1), abs=1e-6)


def test_no_fit_starts_while_cells_are_tracked(series_widget, spin, slow_tracking, told):
    widget = series_widget
    widget.tracking.start()
    spin(lambda: widget.tracking.work.job is not None)
    widget.start()
    assert "being tracked" in told[-1]
    assert widget.doc.run is None
    widget.tracking.start()
    assert "being tracked" in told[-1]
    widget.stop()
    spin(lambda: not widget.tracking.work.running)
    widget.settings.max_iterations.setValue(2)
    widget.start()
    assert widget.doc.run is not None
    spin(lambda: not widget.doc.run.running)
