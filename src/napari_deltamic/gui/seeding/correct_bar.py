"""One row of tools that correct labels by clicks."""

from __future__ import annotations

from typing import Any, Literal

from qtpy.QtWidgets import QPushButton, QVBoxLayout, QWidget

from ..qt import Signal
from ..widgets import Note, ToolButtons

Tool = Literal["split", "merge", "remove"]
_TITLES: dict[Tool, str] = {"split": "Split / add", "merge": "Merge", "remove": "Remove"}
_HINTS: dict[Tool, str] = {
    "split": "Click in the middle of a cell: one that is part of a larger label is cut off, "
    "one that was missed is added.",
    "merge": "Click both halves of a cell, one after the other, to merge them.",
    "remove": "Click on what is no cell.",
}
_IN_3D = " Cells that were missed are added on slices only."


class CorrectBar(QWidget):
    """Buttons for the tools, of which one or none is in use; undo."""

    tool_chosen = Signal(object)  # a tool, or None
    undo = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._ndisplay = 2
        drags = "Dragging still moves the view."
        self.tools = ToolButtons({t: (_TITLES[t], f"{_HINTS[t]} {drags}") for t in _TITLES}, self)
        self.buttons, self.use = self.tools.buttons, self.tools.use
        self.undo_button = QPushButton("↶", self)
        self.undo_button.setToolTip("Undo the last correction, or stroke of the brush (Ctrl+Z).")
        self.undo_button.setFixedWidth(30)
        self.undo_button.setStyleSheet("padding: 2px; font-size: 15px;")
        self.tools.row.addWidget(self.undo_button)
        self.hint, self.count = Note(self), Note(self)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(2)
        layout.addWidget(self.tools)
        layout.addWidget(self.hint)
        layout.addWidget(self.count)
        self.tools.chosen.connect(self._told)
        self.undo_button.clicked.connect(self.undo)

    @property
    def tool(self) -> Tool | None:
        """The tool in use."""
        tool: Any = self.tools.tool
        return tool

    def show_dimensions(self, ndisplay: int) -> None:
        """Whether the view is 2D or 3D."""
        self._ndisplay = ndisplay
        self.explain()

    def show_count(self, cells: int) -> None:
        """How many cells there are."""
        self.count.say(f"{cells} {'cell' if cells == 1 else 'cells'}" if self.tool else "")

    def say(self, text: str) -> None:
        """What a click did not do, or what it waits for."""
        self.hint.say(text)

    def explain(self) -> None:
        """What the tool in use does."""
        tool = self.tool
        text = "" if tool is None else _HINTS[tool]
        self.hint.say(text + _IN_3D * (tool == "split" and self._ndisplay == 3))

    def _told(self, tool: Tool | None) -> None:
        self.explain()
        self.tool_chosen.emit(tool)
