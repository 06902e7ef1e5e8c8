"""napari's objects without the wrapper in which it hands them to plugins."""

from __future__ import annotations

from typing import Any


def unwrapped(viewer: Any) -> Any:
    """The viewer itself, where napari hands over a ``PublicOnlyProxy`` of it.

    It does so for docks that ``napari -w`` or ``add_plugin_dock_widget`` open. Whatever is asked of
    such a proxy is wrapped anew: no layer *is* the one that was found a moment ago, and none is of
    the type that it seems to be.
    """
    return getattr(viewer, "__wrapped__", viewer)
