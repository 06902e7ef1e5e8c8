"""The first row of the dock: help, and a menu of what is rarely wanted."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from qtpy.QtCore import QUrl
from qtpy.QtGui import QDesktopServices
from qtpy.QtWidgets import QHBoxLayout, QMenu, QPushButton, QWidget

DOCS = "https://github.com/napari-deltamic/napari-deltamic/blob/main/docs/napari.md"


class Header(QWidget):
    """A menu of actions, in groups, and a button for the docs."""

    def __init__(self, groups: Sequence[Sequence[Any]], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        more, helps = QPushButton("More", self), QPushButton("?", self)
        more.setToolTip("<qt>Sessions, the command of a run, simulated cells.</qt>")
        self.menu = QMenu(more)
        self.menu.setToolTipsVisible(True)
        for group in groups:
            self.menu.addSeparator()  # the first of a menu is not shown
            self.menu.addActions(group)
        more.setMenu(self.menu)
        helps.setToolTip("<qt>Open the page of the docs about this window.</qt>")
        helps.setAccessibleName("help")
        helps.setFixedWidth(30)
        helps.clicked.connect(partial(QDesktopServices.openUrl, QUrl(DOCS)))
        layout = QHBoxLayout(self)
        layout.setContentsMargins(0, 2, 4, 0)
        layout.addStretch()
        layout.addWidget(more)
        layout.addWidget(helps)
