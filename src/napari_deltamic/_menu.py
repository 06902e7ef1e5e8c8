"""Entries of napari's menus that are no widgets."""

from __future__ import annotations

from napari.viewer import Viewer

from .gui.panels.preferences import PLUGIN


def open_session(viewer: Viewer) -> None:
    """Ask for a session file and open it, in the widget of the plugin."""
    _, widget = viewer.window.add_plugin_dock_widget(PLUGIN)
    widget.sessions.open_button.click()
