"""Closing the dock while something runs in it: the user is asked first."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any

from qtpy.QtWidgets import QDockWidget, QMessageBox, QWidget


def ask_before_closing(widget: QWidget, busy: Callable[[], str]) -> None:
    """Let the close button of the dock that a widget lies in ask, while something runs.

    Whoever takes the widget out of its dock by other means, as scripts do, is not asked.

    busy : what runs, in a sentence; '' for nothing. It must not hold the widget.
    """
    dock: Any = widget.parent()
    # What napari's button calls; no public way leads there. Where it is missing, nobody is asked.
    close = getattr(dock, "destroyOnClose", None)
    if not isinstance(dock, QDockWidget) or close is None:
        return
    own, docked = weakref.ref(widget), weakref.ref(dock)

    def closed() -> None:
        shown: QWidget | None = own()
        found: Any = docked()
        if found is None:
            return
        text = busy() if shown is not None and found.widget() is shown else ""
        if shown is None or not text or agreed(shown, text):
            type(found).destroyOnClose(found)

    dock.destroyOnClose = closed  # type: ignore[attr-defined]


def agreed(widget: QWidget, text: str) -> bool:
    """Whether the user wants to close the dock although something runs."""
    box = QMessageBox(QMessageBox.Icon.Question, "Close deltaMic?", text, parent=widget)
    end = box.addButton("End it and close", QMessageBox.ButtonRole.DestructiveRole)
    keep = box.addButton("Keep it open", QMessageBox.ButtonRole.RejectRole)
    box.setDefaultButton(keep)
    box.setEscapeButton(keep)
    box.exec()
    return box.clickedButton() is end
