"""napari's objects, whatever its version, without the wrapper in which plugins get them."""

from __future__ import annotations

from typing import Any


def unwrapped(viewer: Any) -> Any:
    """The viewer itself, where napari hands over a ``PublicOnlyProxy`` of it.

    It does so for docks that ``napari -w`` or ``add_plugin_dock_widget`` open. Whatever is asked of
    such a proxy is wrapped anew: no layer *is* the one that was found a moment ago, and none is of
    the type that it seems to be.
    """
    return getattr(viewer, "__wrapped__", viewer)


def camera_of(viewer: Any) -> Any:
    """The camera of a viewer or its model; napari 0.9 has moved it."""
    return getattr(viewer, "scene", viewer).camera
