"""A part of a panel that is folded away until someone wants it."""

from __future__ import annotations

from qtpy.QtCore import Qt
from qtpy.QtGui import QResizeEvent
from qtpy.QtWidgets import QSizePolicy, QToolButton, QVBoxLayout, QWidget

_ARROW = 30  # px of the button that are not for its text


class Fold(QWidget):
    """A title with an arrow; a click on it shows the content, or hides it again.

    A title that is longer than the panel is wide is cut; its tooltip has all of it.
    """

    def __init__(self, title: str, content: QWidget, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.title = ""
        self.button = QToolButton(self)
        self.button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.button.setCheckable(True)
        # The text must not widen a narrow dock.
        self.button.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        # napari's style would draw it as one of its square icons.
        self.button.setStyleSheet(
            "QToolButton { border: none; background: transparent; padding: 2px; }"
        )
        self.content = content
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(4)
        layout.addWidget(self.button)
        layout.addWidget(content)
        self.button.toggled.connect(self.unfold)
        self.set_title(title)
        self.unfold(False)

    def set_title(self, title: str) -> None:
        """Show another title."""
        self.title = title
        self._cut()

    def unfold(self, shown: bool = True) -> None:
        """Show the content, or hide it."""
        self.button.setChecked(shown)
        arrow = Qt.ArrowType.DownArrow if shown else Qt.ArrowType.RightArrow
        self.button.setArrowType(arrow)
        self.content.setVisible(shown)

    def resizeEvent(self, event: QResizeEvent | None) -> None:
        """Qt's."""
        super().resizeEvent(event)
        self._cut()

    def _cut(self) -> None:
        room = self.width() - _ARROW
        metrics = self.button.fontMetrics()
        text = metrics.elidedText(self.title, Qt.TextElideMode.ElideRight, room)
        self.button.setText(text)
        self.button.setToolTip(self.title if text != self.title else "")
