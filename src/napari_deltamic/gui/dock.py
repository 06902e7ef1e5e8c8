"""What lies around the panels of the dock: its first row, what scrolls, its keys, its close button.

napari takes no keys of a viewer from a manifest.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from qtpy.QtCore import QEvent, QObject, Qt, QUrl
from qtpy.QtGui import QDesktopServices
from qtpy.QtWidgets import QDockWidget, QFrame, QMenu, QMessageBox, QScrollArea, QWidget

from .document import Document
from .widgets import button, row
from .work import one_shot

DOCS = "https://github.com/napari-deltamic/napari-deltamic/blob/main/docs/napari.md"


class Header(QWidget):
    """A menu of actions, in groups, and a button for the docs."""

    def __init__(self, groups: Sequence[Sequence[Any]], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        more = button("More", "Sessions, the command of a run, simulated cells.", None, self)
        self.menu = QMenu(more)
        self.menu.setToolTipsVisible(True)
        for group in groups:
            self.menu.addSeparator()  # the first of a menu is not shown
            self.menu.addActions(group)
        more.setMenu(self.menu)
        tip = "Open the page of the docs about this window."
        helps = button("?", tip, partial(QDesktopServices.openUrl, QUrl(DOCS)), self)
        helps.setAccessibleName("help")
        helps.setFixedWidth(30)
        row((QWidget(self), 1), more, helps, of=self).setContentsMargins(0, 2, 4, 0)


class Column(QScrollArea):
    """Scrolls up and down only, so it is never narrower than what it shows."""

    def __init__(self, shown: QWidget, parent: QWidget) -> None:
        super().__init__(parent)
        self.setWidget(shown)
        shown.installEventFilter(self)
        self.setWidgetResizable(True)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self._part: QWidget | None = None
        self._soon = one_shot(self, self._go)  # when what was just shown has its place

    def show_part(self, part: QWidget) -> None:
        """Scroll until a part of what it shows is seen."""
        self._part = part
        self._soon.start()

    def _go(self) -> None:
        if self._part is not None:
            self.ensureWidgetVisible(self._part, 0, 0)

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Qt's, of what it shows; the theme, which decides how wide things are, may come late."""
        kinds = (QEvent.Type.LayoutRequest, QEvent.Type.Resize)
        shown, bar = self.widget(), self.verticalScrollBar()
        if shown is not None and bar is not None and event is not None and event.type() in kinds:
            self.setMinimumWidth(shown.minimumSizeHint().width() + bar.sizeHint().width() + 2)
        return bool(super().eventFilter(watched, event))


def bind_keys(doc: Document, actions: Mapping[str, Callable[[], Any]]) -> None:
    """Bind keys of the viewer, as napari writes them, to actions until the window is closed."""
    for key, action in actions.items():
        doc.viewer.bind_key(key, lambda viewer, press=action: press(), overwrite=True)
        doc.at_end(partial(doc.viewer.bind_key, key, None, overwrite=True))


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
