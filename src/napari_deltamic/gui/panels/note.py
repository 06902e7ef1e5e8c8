"""A line of text that takes no room while it says nothing."""

from __future__ import annotations

from qtpy.QtWidgets import QLabel, QSizePolicy, QWidget


class Note(QLabel):
    """A small line, wrapped, that is hidden while it is empty.

    Parameters
    ----------
    wrong : whether what it says is that something cannot be used.
    """

    def __init__(self, parent: QWidget | None = None, *, wrong: bool = False) -> None:
        super().__init__(parent)
        self.setWordWrap(True)
        self.setStyleSheet("font-size: 11px;" + " color: #e0564f;" * wrong)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Minimum)
        self.hide()

    def say(self, text: str) -> None:
        """Show a text, or nothing."""
        if text != self.text():
            self.setText(text)
            self.setVisible(bool(text))
