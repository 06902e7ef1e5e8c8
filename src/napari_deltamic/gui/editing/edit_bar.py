"""One row of tools that change the surface by hand; the rest shows only while one is in use."""

from __future__ import annotations

from typing import Literal

from qtpy.QtCore import QSignalBlocker, Qt
from qtpy.QtWidgets import QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget
from superqt import QLabeledDoubleSlider

from ..qt import Signal
from ..widgets import note_label

Tool = Literal["nudge", "push", "pin"]
TOOLS: tuple[Tool, ...] = ("nudge", "push", "pin")
_TIPS = {
    "nudge": "Drag a part of the surface, in the plane of the slice or of the view.",
    "push": "Drag over the surface to push it outward; with Shift, inward.",
    "pin": "Drag over the surface: the fit leaves it where it is; with Shift, frees it again.",
}
_PLACES = {2: "near a contour", 3: "on a surface"}


class EditBar(QWidget):
    """Buttons for the tools, of which one or none is in use, and the size of the brush."""

    tool_chosen = Signal(object)  # a tool, or None
    free_all = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.buttons: dict[Tool, QPushButton] = {}
        self._ndisplay = 2
        row = QHBoxLayout()
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(QLabel("edit", self))
        for tool in TOOLS:
            button = QPushButton(tool.capitalize(), self)
            button.setCheckable(True)
            button.setToolTip(f"<qt>{_TIPS[tool]}</qt>")
            button.clicked.connect(self._clicked)
            row.addWidget(button)
            self.buttons[tool] = button
        self.pins = QPushButton(self)
        self.pins.setToolTip("Free all pinned vertices.")
        self.pins.clicked.connect(self.free_all)
        self.radius = QLabeledDoubleSlider(Qt.Orientation.Horizontal, self)
        self.radius.setToolTip("Radius of the brush, um; the effect fades towards its rim.")
        self._brush = QWidget(self)
        brush = QHBoxLayout(self._brush)
        brush.setContentsMargins(0, 0, 0, 0)
        brush.addWidget(QLabel("brush, um", self))
        brush.addWidget(self.radius)
        self.hint = note_label()
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addLayout(row)
        layout.addWidget(self._brush)
        layout.addWidget(self.hint)
        layout.addWidget(self.pins)
        self.show_pins(0)
        self._show()

    @property
    def tool(self) -> Tool | None:
        """The tool in use."""
        return next((tool for tool, button in self.buttons.items() if button.isChecked()), None)

    def use(self, tool: Tool | None) -> None:
        """Take up a tool, or lay it down."""
        if tool == self.tool:
            return
        for name, button in self.buttons.items():
            button.setChecked(name == tool)
        self._show()
        self.tool_chosen.emit(tool)

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
        self.hint.setText(text)

    def _clicked(self, checked: bool) -> None:
        sender = self.sender()
        for button in self.buttons.values():
            if button is not sender:
                button.setChecked(False)
        self._show()
        self.tool_chosen.emit(self.tool)

    def _show(self) -> None:
        tool = self.tool
        self._brush.setVisible(tool is not None)
        self.hint.setVisible(tool is not None)
        if tool is not None:
            place = _PLACES[self._ndisplay]
            self.hint.setText(f"{_TIPS[tool]} Start {place}; elsewhere the mouse moves the view.")
