"""Layers of the plugin's own: they lie on an image, and leave the sliders to it.

napari moves its sliders by the smallest step of all layers, from where the first of them begins. A
mesh in um would turn the steps of an image with thick slices into steps of 1 um, and one that
reaches out of the image would renumber its slices. The classes have the names of napari's, as
napari tells kinds of layers by them.
"""

from __future__ import annotations

import weakref
from functools import cache
from typing import Any

import numpy as np
from napari import layers


class _OnImage:
    """Mixin for layers that report the image's extent as their own, once ``lie_on`` was called."""

    _image: Any = None  # a weak reference: layers outlive the image that they were made for

    def lie_on(self, image_layer: Any) -> Any:
        """Leave the sliders to an image layer; returns the layer itself, for convenience."""
        self._image = weakref.ref(image_layer)
        return self

    @property
    def extent(self) -> Any:
        """The extent of the layer as the sliders should see it."""
        own = super().extent  # type: ignore[misc]
        image = self._image() if self._image is not None else None
        if image is None or tuple(image.units[-own.world.shape[1] :]) != tuple(own.units):
            return own
        n = own.world.shape[1]
        there = image.extent
        if n > there.world.shape[1] or not np.isfinite(there.world).all():
            return own
        return own._replace(world=there.world[:, -n:], step=there.step[-n:])

    @extent.deleter
    def extent(self) -> None:
        self.__dict__.pop("extent", None)  # napari's cache of it


class Surface(_OnImage, layers.Surface):  # type: ignore[misc]
    """napari's, on an image."""


class Vectors(_OnImage, layers.Vectors):  # type: ignore[misc]
    """napari's, on an image."""


class Points(_OnImage, layers.Points):  # type: ignore[misc]
    """napari's, on an image."""


class Tracks(_OnImage, layers.Tracks):  # type: ignore[misc]
    """napari's, on an image."""


_CUT = {"projection_mode": "rescale_spherical"}


@cache
def cut_by_slices() -> dict[str, Any]:
    """Options of Points that are spheres: each slice shows their sections."""
    try:
        layers.Points(**_CUT)
    except ValueError:  # napari before 0.8 says it in other words
        return {"out_of_slice_display": True}
    return dict(_CUT)


def known_here(options: dict[str, Any]) -> dict[str, Any]:
    """Options of Points, perhaps saved by another version of napari, as this one needs them."""
    if options.items() >= _CUT.items():
        others = {name: value for name, value in options.items() if name not in _CUT}
        return {**others, **cut_by_slices()}
    return options


def lie_on(layer: Any, image_layer: Any) -> None:
    """Leave the sliders to an image layer, where a layer is one of these."""
    if isinstance(layer, _OnImage):
        layer.lie_on(image_layer)
