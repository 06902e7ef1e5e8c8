"""Spheres drawn with the mouse: press at the centre, drag to the rim, release."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError

_CLICK = 5.0  # canvas pixels: less is a click, for which napari itself adds a point


class SphereDrawing:
    """Lets the mouse draw spheres on Points layers in add mode.

    A drag that begins beside the image still turns or moves the view.

    Parameters
    ----------
    wanted : whether points are to be spheres now.
    image_layer : gives the image layer, or None.
    um_per_data : gives the um in one unit of a Points layer's data, along Z, Y, X.
    limits : gives the smallest and the largest radius, um.
    drawn : called with the layer when a sphere is finished, and its radius, um.
    """

    def __init__(
        self,
        wanted: Callable[[], bool],
        image_layer: Callable[[], Any],
        um_per_data: Callable[[Any], NDArray[np.float64]],
        limits: Callable[[], tuple[float, float]],
        drawn: Callable[[Any, float], None],
    ) -> None:
        self._wanted, self._image_layer, self._um = wanted, image_layer, um_per_data
        self._limits, self._drawn = limits, drawn
        self._layers: list[Any] = []

    def attach(self, layers: list[Any]) -> None:
        """Listen to the mouse on these layers, and on no others."""
        for layer in self._layers:
            if layer not in layers and self.on_drag in layer.mouse_drag_callbacks:
                layer.mouse_drag_callbacks.remove(self.on_drag)
        for layer in layers:
            if self.on_drag not in layer.mouse_drag_callbacks:
                layer.mouse_drag_callbacks.append(self.on_drag)
        self._layers = list(layers)

    def on_drag(self, layer: Any, event: Any) -> Iterator[None]:
        """One press, what follows it, and its release; napari calls it."""
        adding = str(layer.mode) == "add" and event.button == 1 and not event.modifiers
        if not (adding and self._wanted() and self._over_image(event)):
            return
        try:
            um = self._um(layer)
        except InputError:
            return  # said when the fit starts
        panned, layer.mouse_pan = layer.mouse_pan, False  # the view stays
        try:
            yield from self._draw(layer, event, um)
        finally:
            if str(layer.mode) == "add":
                layer.mouse_pan = panned

    def _draw(self, layer: Any, event: Any, um: NDArray[np.float64]) -> Iterator[None]:
        pressed, centre = np.array(event.pos), np.array(layer.world_to_data(event.position))
        index = None
        yield
        while event.type == "mouse_move":
            if index is None and np.linalg.norm(event.pos - pressed) >= _CLICK:
                layer.add(centre)
                index = len(layer.data) - 1
            if index is not None and index < len(layer.data):
                self._size(layer, index, self._radius(layer, event, centre, um), um)
            yield
        if index is None or index >= len(layer.data):
            return
        if np.linalg.norm(event.pos - pressed) < _CLICK:
            # Back at the centre: no more than a click, for which napari adds a point.
            layer.selected_data = {index}
            layer.remove_selected()
            return
        radius = self._radius(layer, event, centre, um)
        self._size(layer, index, radius, um)
        self._drawn(layer, radius)

    def _radius(self, layer: Any, event: Any, centre: Any, um: NDArray[np.float64]) -> float:
        rim = np.array(layer.world_to_data(event.position))
        low, high = self._limits()
        return float(np.clip(np.linalg.norm((rim - centre)[-3:] * um), low, high))

    @staticmethod
    def _size(layer: Any, index: int, radius: float, um: NDArray[np.float64]) -> None:
        sizes = np.array(layer.size, float)
        sizes[index] = 2 * radius / float(np.mean(um))
        layer.size = sizes

    def _over_image(self, event: Any) -> bool:
        image = self._image_layer()
        if image is None:
            return False
        if len(event.dims_displayed) < 3:
            return True
        near, _ = image.get_ray_intersections(
            event.position, event.view_direction, list(event.dims_displayed)
        )
        return near is not None
