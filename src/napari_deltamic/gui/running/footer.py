"""Fit, pause and stop, and how far it is: always in sight, under what scrolls."""

from __future__ import annotations

from qtpy.QtWidgets import QHBoxLayout, QProgressBar, QPushButton, QVBoxLayout, QWidget

from ..qt import Signal
from ..widgets import Note


class Footer(QWidget):
    """Three buttons, a bar and a line."""

    run = Signal()
    pause = Signal(bool)
    stop = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.run_button = QPushButton("Fit", self)
        self.run_button.setToolTip("<qt>Fit the surfaces of the cells to the image.</qt>")
        self.run_button.setStyleSheet("font-weight: bold;")
        self.pause_button = QPushButton("Pause", self)
        self.pause_button.setToolTip("<qt>Pause. You can edit the cells while paused.</qt>")
        self.pause_button.setCheckable(True)
        self.stop_button = QPushButton("Stop", self)
        self.stop_button.setToolTip("<qt>End the fit; what it reached is kept.</qt>")
        self.progress = QProgressBar(self)
        self.progress.setTextVisible(True)
        self.message = Note(self)
        buttons = QHBoxLayout()
        buttons.setSpacing(4)
        buttons.addWidget(self.run_button, 2)
        buttons.addWidget(self.pause_button, 1)
        buttons.addWidget(self.stop_button, 1)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(4, 4, 4, 4)
        layout.setSpacing(4)
        layout.addLayout(buttons)
        layout.addWidget(self.progress)
        layout.addWidget(self.message)
        self.run_button.clicked.connect(self.run)
        self.pause_button.toggled.connect(self._pause)
        self.stop_button.clicked.connect(self.stop)
        self.set_running(False)

    def set_running(self, running: bool) -> None:
        """Which buttons can be pressed."""
        self.run_button.setEnabled(not running)
        self.pause_button.setEnabled(running)
        self.stop_button.setEnabled(running)
        self.progress.setVisible(running)
        if running:
            self.progress.setRange(0, 0)
        else:
            self.pause_button.setChecked(False)

    def show_level(self, level: int, levels: int) -> None:
        """How many levels of the fit are behind it."""
        self.progress.setRange(0, levels)
        self.progress.setValue(level - 1)
        self.progress.setFormat(f"level {level} of {levels}")

    def _pause(self, paused: bool) -> None:
        self.pause_button.setText("Resume" if paused else "Pause")
        self.pause.emit(paused)
