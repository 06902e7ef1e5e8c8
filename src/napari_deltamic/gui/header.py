"""The first row of the dock: help, and a menu of what is rarely wanted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from qtpy.QtCore import QUrl
from qtpy.QtGui import QDesktopServices
from qtpy.QtWidgets import QHBoxLayout, QMenu, QPushButton, QWidget

from .qt import Signal

DOCS = "https://github.com/napari-deltamic/napari-deltamic/blob/main/docs/napari.md"


class Header(QWidget):
    """A menu button and a button for the docs."""

    copy_command = Signal()
    run_folder = Signal()
    simulate = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.more = QPushButton("More", self)
        self.more.setToolTip("<qt>Sessions, the command of a run, simulated cells.</qt>")
        self.menu = QMenu(self.more)
        self.more.setMenu(self.menu)
        self.help = QPushButton("?", self)
        self.help.setToolTip("<qt>Open the page of the docs about this window.</qt>")
        self.help.setAccessibleName("help")
        self.help.setFixedWidth(30)
        self.copy_action = self._action("Copy as command", self.copy_command)
        self.folder_action = self._action("Run on a folder...", self.run_folder)
        self.folder_action.setToolTip(
            "Writes batch.toml with these settings beside the stacks, and copies its command."
        )
        self.simulate_action = self._action("Simulate cells...", self.simulate)
        self.copy_action.setToolTip("The command that repeats this run without a window.")
        self.menu.setToolTipsVisible(True)
        layout = QHBoxLayout(self)
        layout.setContentsMargins(0, 2, 4, 0)
        layout.addStretch()
        layout.addWidget(self.more)
        layout.addWidget(self.help)
        self.help.clicked.connect(self._open_docs)

    def offer(self, actions: Sequence[Any]) -> None:
        """Put further actions first in the menu."""
        before = self.menu.actions()[0]
        for action in actions:
            self.menu.insertAction(before, action)
        self.menu.insertSeparator(before)

    def _action(self, title: str, signal: Any) -> Any:
        action: Any = self.menu.addAction(title)
        action.triggered.connect(lambda checked=False: signal.emit())
        return action

    def _open_docs(self) -> None:
        QDesktopServices.openUrl(QUrl(DOCS))
