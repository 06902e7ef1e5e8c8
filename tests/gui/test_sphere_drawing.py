"""Spheres drawn with the mouse on a Points layer."""

import numpy as np
import pytest
from napari.layers import Image, Points
from napari.utils.interactions import (
    mouse_move_callbacks,
    mouse_press_callbacks,
    mouse_release_callbacks,
)

from napari_deltamic.gui.seeding.sphere_drawing import SphereDrawing
from napari_deltamic.gui.viewing import own_layers
from napari_deltamic.gui.viewing.frame import Frame

from .conftest import CENTER, SHAPE, SIZE


@pytest.fixture
def frame():
    layer = Image(np.zeros(SHAPE), scale=SIZE, translate=(1, 2, 3), units=("um",) * 3)
    return Frame.of(layer)


class Mouse:
    """What napari hands to callbacks; it goes straight on: one pixel is 0.05 in the world."""

    def __init__(self, layer, start, axes, view=None, modifiers=()):
        self.layer, self.start, self.axes = layer, np.array(start, float), axes
        self.pos, self.type, self.button = np.zeros(2), "mouse_press", 1
        self.modifiers, self.handled = list(modifiers), False
        self.panned = False  # whether napari's camera was free to move meanwhile
        self.is_dragging, self.up_direction = False, None
        self.view_direction = view
        self.dims_displayed = [0, 1, 2] if view is not None else list(axes)

    @property
    def position(self):
        world = self.start.copy()
        world[list(self.axes)] += 0.05 * self.pos
        return tuple(world)

    def drag(self, *pixels):
        mouse_press_callbacks(self.layer, self)
        for pos in pixels:
            self.pos, self.type, self.is_dragging = np.array(pos, float), "mouse_move", True
            mouse_move_callbacks(self.layer, self)
            self.panned |= self.layer.mouse_pan
        self.type = "mouse_release"
        mouse_release_callbacks(self.layer, self)


@pytest.fixture
def drawn(frame):
    """A Points layer in add mode on which spheres can be drawn, and the radii told."""
    layer = Points(np.zeros((0, 3)), ndim=3, size=1.0, **frame.layer_options())
    image = Image(np.zeros(SHAPE), scale=SIZE, translate=(1, 2, 3), units=("um",) * 3)
    layer.mode = "add"
    told = []
    drawing = SphereDrawing(
        lambda: layer.name != "membrane",
        lambda: image,
        lambda one: frame.data_to_um(one)[0],
        lambda: (0.2, 3.0),
        lambda one, radius: told.append(radius),
    )
    drawing.attach([layer])
    drawing.attach([layer])
    return layer, told, drawing


def test_a_drag_in_a_slice_draws_a_sphere(drawn):
    layer, told, _ = drawn
    mouse = Mouse(layer, np.add(CENTER, (1, 2, 3)), (1, 2))
    mouse.drag((3, 0), (12, 0), (12, 16))
    assert not mouse.panned, "the view stays"
    assert layer.mouse_pan
    np.testing.assert_allclose(layer.data, [CENTER])
    np.testing.assert_allclose(layer.size, [2.0], rtol=1e-6)  # 20 pixels are 1 um
    assert told == pytest.approx([1.0])
    assert layer.selected_data == {0}


def test_a_drag_in_3d_draws_a_sphere_only_on_the_image(drawn):
    layer, told, _ = drawn
    view = np.array([1.0, 0, 0])
    Mouse(layer, np.add(CENTER, (1, 2, 3)), (1, 2), view).drag((10, 0), (0, 18))
    np.testing.assert_allclose(layer.data, [CENTER])
    assert told == pytest.approx([0.9])
    beside = Mouse(layer, (0, -5, -5), (1, 2), view)
    beside.drag((10, 0), (0, 18))
    assert beside.panned, "it turns the view"
    assert len(layer.data) == 1


def test_spheres_have_limits(drawn):
    layer, told, _ = drawn
    Mouse(layer, np.add(CENTER, (1, 2, 3)), (1, 2)).drag((10, 0), (400, 0))
    assert told == pytest.approx([3.0])


def test_clicks_still_add_a_point_each(drawn):
    layer, told, _ = drawn
    start = np.add(CENTER, (1, 2, 3))
    Mouse(layer, start, (1, 2)).drag()
    Mouse(layer, start, (1, 2)).drag((2, 2))
    Mouse(layer, start, (1, 2)).drag((30, 0), (1, 1))  # to the rim and back
    assert len(layer.data) == 3
    np.testing.assert_allclose(layer.size, 1.0)
    assert told == []


def test_other_modes_and_keys_are_left_alone(drawn):
    layer, told, drawing = drawn
    start = np.add(CENTER, (1, 2, 3))
    Mouse(layer, start, (1, 2), modifiers=["Shift"]).drag((20, 0), (30, 0))
    layer.name = "membrane"  # no spheres are wanted
    Mouse(layer, start, (1, 2)).drag((20, 0), (30, 0))
    layer.name = "spheres"
    layer.mode = "pan_zoom"
    Mouse(layer, start, (1, 2)).drag((20, 0), (30, 0))
    layer.mode = "add"
    drawing.attach([])
    Mouse(layer, start, (1, 2)).drag((20, 0), (30, 0))
    assert len(layer.data) == 0
    assert told == []


def test_a_sphere_whose_point_is_deleted_meanwhile(drawn):
    layer, told, _ = drawn
    mouse = Mouse(layer, np.add(CENTER, (1, 2, 3)), (1, 2))
    mouse_press_callbacks(layer, mouse)
    mouse.pos, mouse.type, mouse.is_dragging = np.array([20.0, 0]), "mouse_move", True
    mouse_move_callbacks(layer, mouse)
    layer.data = np.zeros((0, 3))
    mouse_move_callbacks(layer, mouse)
    mouse.type = "mouse_release"
    mouse_release_callbacks(layer, mouse)
    assert len(layer.data) == 0
    assert told == []


@pytest.mark.filterwarnings("ignore:out_of_slice_display")  # in newer ones
def test_seeds_are_drawn_by_an_older_napari_too(panel, with_image, monkeypatch):
    """napari 0.7 does not know the projection that shows spheres as a slice cuts them."""

    def points(*data, projection_mode="none", **options):
        if projection_mode != "none":
            raise ValueError(f"'{projection_mode}' is not a valid PointsProjectionMode")
        return Points(*data, **options)

    saved = {"opacity": 0.5, **own_layers.cut_by_slices()}
    assert own_layers.known_here(saved) == saved
    monkeypatch.setattr(own_layers.layers, "Points", points)
    own_layers.cut_by_slices.cache_clear()
    try:
        panel.place.click()
        found = own_layers.known_here({"opacity": 0.5, "projection_mode": "rescale_spherical"})
    finally:
        own_layers.cut_by_slices.cache_clear()
    assert with_image.layers["seeds"].out_of_slice_display
    assert found == {"opacity": 0.5, "out_of_slice_display": True}
