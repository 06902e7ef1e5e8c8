"""Entries of napari's menus and of its command palette that are not widgets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from napari.viewer import Viewer

from .settings.preferences import PLUGIN


def fit_widget(viewer: Viewer) -> Any:
    """The widget of the plugin in a viewer's window, docked if there is none yet."""
    from .fit_widget import FitWidget

    # Someone may have docked it without napari's menus, which then know nothing of it.
    docked = [one for one in viewer.window.dock_widgets.values() if isinstance(one, FitWidget)]
    return docked[0] if docked else viewer.window.add_plugin_dock_widget(PLUGIN)[1]


def _command(press: Callable[[Any], None]) -> Callable[[Viewer], None]:
    """A function that napari calls with a viewer, and that presses something in the widget."""

    def command(viewer: Viewer) -> None:
        press(fit_widget(viewer))

    return command


open_session = _command(lambda widget: widget.sessions.open_action.trigger())
find_cells = _command(lambda widget: widget.seeds.find_cells.start())
fit_or_stop = _command(lambda widget: widget.start_or_stop())
pause_or_resume = _command(lambda widget: widget.footer.pause_button.click())
go_to_worst = _command(lambda widget: widget.running.go_to_worst())
next_view = _command(lambda widget: widget.doc.look_further())
