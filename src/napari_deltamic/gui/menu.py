"""Entries of napari's menus and of its command palette that are no widgets."""

from __future__ import annotations

from typing import Any

from napari.viewer import Viewer

from .settings.preferences import PLUGIN


def open_session(viewer: Viewer) -> None:
    """Ask for a session file and open it, in the widget of the plugin."""
    fit_widget(viewer).sessions.open_action.trigger()


def find_cells(viewer: Viewer) -> None:
    """Find the cells of the image chosen."""
    fit_widget(viewer).seeds.find_cells.start()


def fit_or_stop(viewer: Viewer) -> None:
    """Start a fit of what is chosen, or end what runs."""
    fit_widget(viewer).start_or_stop()


def pause_or_resume(viewer: Viewer) -> None:
    """Let the fit wait, or go on."""
    fit_widget(viewer).footer.pause_button.click()


def go_to_worst(viewer: Viewer) -> None:
    """Go to where the image differs most from the rendered one."""
    fit_widget(viewer).running.go_to_worst()


def next_view(viewer: Viewer) -> None:
    """Look at the image, the rendered image, the residual, or both images, in turn."""
    fit_widget(viewer).doc.look_further()


def fit_widget(viewer: Viewer) -> Any:
    """The widget of the plugin in a viewer's window, docked if there is none yet."""
    from .fit_widget import FitWidget

    # Someone may have docked it without napari's menus, which then know nothing of it.
    docked = [one for one in viewer.window.dock_widgets.values() if isinstance(one, FitWidget)]
    return docked[0] if docked else viewer.window.add_plugin_dock_widget(PLUGIN)[1]
