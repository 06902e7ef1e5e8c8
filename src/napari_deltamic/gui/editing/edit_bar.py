"""One row of tools that change the surface by hand; the rest shows only while one is in use."""

from __future__ import annotations

from typing import Any, Literal

from qtpy.QtCore import QSignalBlocker, Qt
from qtpy.QtWidgets import QLabel, QPushButton, QVBoxLayout, QWidget
from superqt import QLabeledDoubleSlider

from ..qt import Signal
from ..widgets import Note, ToolButtons

Tool = Literal["nudge", "push", "pin"]
_TIPS: dict[str, str] = {
    "nudge": "Drag a part of the surface, in the plane of the slice or of the view.",
    "push": "Drag over the surface to push it outward; with Shift, inward.",
    "pin": "Drag over the surface: the fit leaves it where it is; with Shift, frees it again.",
}
_PLACES = {2: "near a contour", 3: "on a surface"}


class EditBar(QWidget):
    """Buttons for the tools, and the size of the brush."""

    tool_chosen = Signal(object)  # a tool, or None
    free_all = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._ndisplay = 2
        self.tools = ToolButtons({t: (t.capitalize(), tip) for t, tip in _TIPS.items()}, self)
        self.tools.row.insertWidget(0, QLabel("edit", self))
        self.buttons, self.use = self.tools.buttons, self.tools.use
        self.pins = QPushButton(self)
        self.pins.setToolTip("Free all pinned vertices.")
        self.radius = QLabeledDoubleSlider(Qt.Orientation.Horizontal, self)
        self.radius.setToolTip("Radius of the brush, µm; the effect fades towards its rim.")
        self.hint = Note(self)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        for widget in (self.tools, self.radius, self.hint, self.pins):
            layout.addWidget(widget)
        self.pins.clicked.connect(self.free_all)
        self.tools.chosen.connect(self._chosen)
        self.show_pins(0)
        self._show()

    @property
    def tool(self) -> Tool | None:
        """The tool in use."""
        tool: Any = self.tools.tool
        return tool

    def set_scale(self, size: float) -> None:
        """Fit the brush to a mesh of a size, um."""
        blocker = QSignalBlocker(self.radius)
        self.radius.setRange(size / 100, size / 2)
        self.radius.setValue(size / 8)
        blocker.unblock()

    def show_pins(self, n: int) -> None:
        """How many vertices are pinned."""
        self.pins.setText(f"Free {n} pinned {'vertex' if n == 1 else 'vertices'}")
        self.pins.setVisible(n > 0)

    def show_dimensions(self, ndisplay: int) -> None:
        """Whether the view is 2D or 3D."""
        self._ndisplay = ndisplay
        self._show()

    def say(self, text: str) -> None:
        """Why a tool did nothing."""
        self.hint.say(text)

    def _chosen(self, tool: str | None) -> None:
        self._show()
        self.tool_chosen.emit(tool)

    def _show(self) -> None:
        tool = self.tool
        self.radius.setVisible(tool is not None)
        place = _PLACES[self._ndisplay]
        start = f"Start {place}; elsewhere the mouse moves the view."
        self.hint.say("" if tool is None else f"{_TIPS[tool]} {start}")
