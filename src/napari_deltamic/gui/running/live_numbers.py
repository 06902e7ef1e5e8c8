"""The numbers of the PSF and of the effects that a fit moves: at its start, and now."""

from __future__ import annotations

from qtpy.QtWidgets import QLabel, QWidget

from ...fitting import FitState
from ...fitting.job import FitInput
from ...results.moved_numbers import MovedNumber, moved_numbers
from ..widgets import Fold


class LiveNumbers(Fold):
    """A row for each number; hidden where there is none."""

    def __init__(self, parent: QWidget | None = None) -> None:
        self.table = QLabel()
        super().__init__("Numbers that the fit moved", self.table, parent)
        self.show_numbers([])

    def show_fit(self, state: FitState, job: FitInput) -> None:
        """Show the numbers of a state of a fit."""
        self.show_numbers(moved_numbers(state, job))

    def show_numbers(self, numbers: list[MovedNumber]) -> None:
        """Show numbers."""
        self._numbers = numbers
        rows = [("", "start", "now"), *self.texts()]
        cells = ("".join(f"<td align=right>&nbsp; {text}</td>" for text in row) for row in rows)
        self.table.setText(f"<table>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>")
        self.setVisible(bool(numbers))

    def texts(self) -> list[tuple[str, str, str]]:
        """What the rows say."""
        return [number.texts for number in self._numbers]
