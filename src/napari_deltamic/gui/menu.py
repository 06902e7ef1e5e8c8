"""Entries of napari's menus that are no widgets."""

from __future__ import annotations

from typing import Any

from napari.viewer import Viewer

from .panels.preferences import PLUGIN


def open_session(viewer: Viewer) -> None:
    """Ask for a session file and open it, in the widget of the plugin."""
    fit_widget(viewer).sessions.open_action.trigger()


def fit_widget(viewer: Viewer) -> Any:
    """The widget of the plugin in a viewer's window, docked if there is none yet."""
    from .fit_widget import FitWidget

    # Someone may have docked it without napari's menus, which then know nothing of it.
    docked = [one for one in viewer.window.dock_widgets.values() if isinstance(one, FitWidget)]
    return docked[0] if docked else viewer.window.add_plugin_dock_widget(PLUGIN)[1]
