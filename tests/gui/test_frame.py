"""Layers and um: scale, translation, units, time points."""

import numpy as np
import pytest
from napari.layers import Image, Labels, Points, Surface

from napari_deltamic.errors import InputError
from napari_deltamic.geometry import sphere
from napari_deltamic.gui.cell_source import mesh_of_surface, seeds_from_layer
from napari_deltamic.gui.viewing.contours import Contours, sliced_axis
from napari_deltamic.gui.viewing.frame import OWN, Frame, camera_of, is_stack, stack_of
from napari_deltamic.gui.viewing.viewer_link import ViewerLink
from napari_deltamic.measure import section
from napari_deltamic.scene.effects import Effects

SHAPE = (6, 8, 10)


def image(**options):
    return Image(np.zeros(SHAPE, np.float32), **options)


def test_units_become_um():
    frame = Frame.of(image(scale=(300, 200, 100), units=("nm",) * 3, translate=(1000, 0, 0)))
    assert frame.voxel_size == pytest.approx((0.3, 0.2, 0.1))
    np.testing.assert_allclose(frame.to_um([[1300, 200, 0]]), [[0.3, 0.2, 0]])
    np.testing.assert_allclose(frame.to_world([[0.3, 0.2, 0]]), [[1300, 200, 0]])


def test_layers_without_units_are_taken_as_um():
    assert Frame.of(image(scale=(0.3, 0.2, 0.1))).voxel_size == (0.3, 0.2, 0.1)


def test_layers_that_are_turned_are_refused():
    with pytest.raises(InputError, match="rotated"):
        Frame.of(image(rotate=(0, 0, 30)))
    with pytest.raises(InputError, match="affine"):
        Frame.of(image(affine=np.diag([2, 1, 1, 1])))


def test_which_layers_can_be_fitted():
    assert is_stack(image())
    assert not is_stack(image(metadata={OWN: {"fit": True}}))
    assert not is_stack(Image(np.zeros((5, 6))))
    assert not is_stack(Image(np.zeros((5, 6, 7, 3)), rgb=True))
    assert not is_stack(Labels(np.zeros(SHAPE, int)))


def test_of_a_series_the_time_shown_is_taken():
    data = np.arange(3 * 4 * 5 * 6, dtype=float).reshape(3, 4, 5, 6)
    layer = Image(data, scale=(1, 0.3, 0.2, 0.2))
    assert is_stack(layer)
    np.testing.assert_array_equal(stack_of(layer, (2, 0, 0, 0)), data[2])
    assert Frame.of(layer).voxel_size == (0.3, 0.2, 0.2)


def test_points_of_another_scale_land_at_the_same_place():
    frame = Frame.of(image(scale=(300, 200, 100), units=("nm",) * 3, translate=(1000, 0, 0)))
    voxels = Points([[1, 2, 3]], scale=(300, 200, 100), translate=(1000, 0, 0), units=("nm",) * 3)
    um = Points([[0.3, 0.4, 0.3]], size=1.0, **frame.layer_options())
    for layer in (voxels, um):
        seeds = seeds_from_layer(layer, frame, (), spheres=False)
        np.testing.assert_allclose(seeds.points, [[0.3, 0.4, 0.3]], rtol=1e-6)
        assert seeds.radii is None
        assert seeds.kind == "image"
    spheres = seeds_from_layer(um, frame, (), spheres=True)
    np.testing.assert_allclose(spheres.radii, [0.5])
    assert spheres.kind == "rough"


def test_an_empty_points_layer_is_named():
    with pytest.raises(InputError, match="'seeds' has no points yet"):
        seeds_from_layer(Points(ndim=3, name="seeds"), Frame.of(image()), (), spheres=False)


def test_labels_must_lie_on_the_voxels():
    frame = Frame.of(image(scale=(0.3, 0.2, 0.2)))
    labels = np.zeros(SHAPE, int)
    labels[1:5, 1:7, 1:9] = 2
    good = seeds_from_layer(Labels(labels, scale=(0.3, 0.2, 0.2)), frame, (), spheres=False)
    mesh = good.make(np.zeros(SHAPE), frame.grid(SHAPE))
    assert mesh.region_ids().tolist() == [2]
    with pytest.raises(InputError, match="scale"):
        seeds_from_layer(Labels(labels), frame, (), spheres=False)


def test_a_surface_keeps_its_regions_and_its_place():
    frame = Frame.of(image(scale=(0.3, 0.2, 0.2), translate=(5, 0, 0)))
    ball = sphere((1, 1, 1), 0.5)
    regions = np.tile([4, 0], (len(ball.faces), 1))
    layer = Surface(
        (ball.vertices, ball.faces), metadata={OWN: {"regions": regions}}, **frame.layer_options()
    )
    mesh = mesh_of_surface(layer, frame)
    np.testing.assert_allclose(mesh.vertices_numpy(), ball.vertices, atol=1e-6)
    assert mesh.region_ids().tolist() == [4]


def test_a_surface_that_is_inside_out_is_turned():
    ball = sphere((1, 1, 1), 0.5)
    layer = Surface((ball.vertices, ball.faces[:, ::-1]))
    assert mesh_of_surface(layer, Frame.of(image())).region_volume(1) > 0


def test_contours_follow_the_slider(viewer):
    layer = image(scale=(300, 200, 200), units=("nm",) * 3, translate=(1000, 0, 0))
    viewer.add_layer(layer)
    frame = Frame.of(layer)
    contours = Contours(frame, "contours")
    viewer.add_layer(contours.layer)
    mesh = sphere((0.8, 0.8, 0.9), 0.55)
    for index in (1, 2, 3):
        viewer.dims.set_current_step(0, index)
        contours.update(mesh, viewer)
        segments, _ = section(mesh, 0, 0.3 * index)
        data = contours.layer.data
        assert len(data) == len(segments) > 0
        np.testing.assert_allclose(data[:, 0, 0], 0.3 * index, rtol=1e-5)
        np.testing.assert_allclose(data[:, 0, 1:], segments[:, 0], rtol=1e-4)
        np.testing.assert_allclose(data.sum(axis=1)[:, 1:], segments[:, 1], rtol=1e-4)
        assert len(contours.layer._view_data) == len(segments), "drawn on this slice"
    viewer.dims.ndisplay = 3
    contours.update(mesh, viewer)
    assert len(contours.layer.data) == 0


def test_contours_across_other_axes_and_in_time(viewer):
    data = np.zeros((2, *SHAPE))
    viewer.add_image(data, scale=(1, 0.3, 0.2, 0.2))
    mesh = sphere((0.8, 0.8, 0.9), 0.55)
    contours = Contours(Frame.of(viewer.layers[0]), "contours")
    viewer.dims.order = (0, 2, 1, 3)
    assert sliced_axis(viewer.dims) == 1
    viewer.dims.set_point(2, 0.8)
    contours.update(mesh, viewer)
    np.testing.assert_allclose(contours.layer.data[:, 0, 1], 0.8, rtol=1e-5)


def test_contours_between_tall_voxels_are_drawn(viewer):
    """The slider stands there once a surface reaches beyond the image."""
    layer = viewer.add_image(np.zeros((9, 30, 30)), scale=(4, 1, 1), units=("um",) * 3)
    link = ViewerLink(viewer, layer, Frame.of(layer))
    link.show_mesh(sphere((16, 15, 15), 12, subdivisions=2))
    viewer.add_points([[-6.92, 0, 0]])  # so does this
    viewer.dims.set_point(0, 17.08)
    lines = link.contours.layer
    assert abs(viewer.dims.point[0] - 16) > 0.5
    assert len(lines.data) > 20
    assert len(lines._view_data) == len(lines.data)
    link.close()


def test_effects_and_switches_reach_the_settings(make_widget):
    widget = make_widget()
    panel, chosen = widget.settings, widget.doc.settings
    assert chosen.scene_settings().effects.names == ()
    panel.effects.table.tick("pixel_integration")
    panel.fields["collisions"].setChecked(True)
    panel.fields["remesh"].setChecked(False)
    assert chosen.scene_settings().effects.names == ("pixel_integration",)
    assert (chosen.fit_settings().collisions, chosen.fit_settings().remesh) == (True, False)
    chosen.show_effects(Effects())
    assert chosen.scene_settings().effects.names == ()


def screen_width(contours, viewer):
    """Pixels of the canvas that a line is wide; its data are um."""
    per_um = camera_of(viewer).zoom * contours.layer.scale[-1]
    return float(contours.layer.edge_width * per_um)


@pytest.mark.parametrize("unit", ["um", "nm"])
def test_contours_keep_their_width_on_the_screen(viewer, unit):
    um = {"um": 1, "nm": 1000}[unit]
    size = np.multiply((0.3, 0.2, 0.2), um)
    layer = viewer.add_image(np.zeros((4, 8, 8)), scale=size, units=(unit,) * 3)
    link = ViewerLink(viewer, layer, Frame.of(layer))
    link.show_mesh(sphere((0.5, 0.8, 0.8), 0.5, subdivisions=2))
    contours = link.contours
    assert len(contours.layer.data)
    for zoom in (600, 3, 0.2, 60):
        camera_of(viewer).zoom = zoom / um
        assert screen_width(contours, viewer) == pytest.approx(2, rel=0.1)
    contours.layer.edge_width *= 3  # by the user
    for zoom in (3, 60):
        camera_of(viewer).zoom = zoom / um
        assert screen_width(contours, viewer) == pytest.approx(6, rel=0.11)
    viewer.dims.ndisplay = 3
    camera_of(viewer).zoom = 20 / um
    viewer.dims.ndisplay = 2
    assert screen_width(contours, viewer) == pytest.approx(6, rel=0.11)
    link.close()


def test_a_region_that_begins_where_the_image_does_is_found_in_all_of_it():
    whole = Labels(np.zeros((6, 8, 9), int))
    for first in (0, 2):
        box = ((0, 6), (first, first + 4), (0, 5))
        frame = Frame.of(Image(np.zeros((6, 8, 9)))).within(box)
        assert frame.region(whole, (6, 8, 9)) == tuple(slice(a, b) for a, b in box)
        own = Labels(np.zeros((6, 4, 5), int), translate=(0, first, 0))
        assert frame.region(own, (6, 4, 5)) == (slice(None),) * 3
