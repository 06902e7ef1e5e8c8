"""The numbers of the PSF and of the effects that a fit moves: at its start, and now."""

from __future__ import annotations

from qtpy.QtCore import Qt
from qtpy.QtWidgets import QGridLayout, QLabel, QWidget

from ...fitting import FitState
from ...fitting.job import FitInput
from ...results.moved_numbers import MovedNumber, moved_numbers
from ..widgets import Fold


class LiveNumbers(Fold):
    """A row for each number; hidden where there is none."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__("Numbers that the fit moved", QWidget(), parent)
        self._numbers: list[MovedNumber] = []
        self._grid = QGridLayout(self.content)
        self._grid.setContentsMargins(8, 0, 0, 0)
        self._grid.setVerticalSpacing(1)
        self._grid.setColumnStretch(0, 1)
        self._cells: list[list[QLabel]] = []
        self._row("", "start", "now")
        self.show_numbers([])

    def show_fit(self, state: FitState, job: FitInput) -> None:
        """Show the numbers of a state of a fit."""
        self.show_numbers(moved_numbers(state, job))

    def show_numbers(self, numbers: list[MovedNumber]) -> None:
        """Show numbers."""
        self._numbers = numbers
        while len(self._cells) <= len(numbers):
            self._row("", "", "")
        for k, cells in enumerate(self._cells[1:]):
            texts = numbers[k].texts if k < len(numbers) else ("", "", "")
            for cell, text in zip(cells, texts, strict=True):
                cell.setVisible(k < len(numbers))
                cell.setText(text)
        self.setVisible(bool(numbers))

    def texts(self) -> list[tuple[str, str, str]]:
        """What the rows say."""
        return [number.texts for number in self._numbers]

    def _row(self, *texts: str) -> None:
        cells = [QLabel(text, self.content) for text in texts]
        for column, label in enumerate(cells):
            side = Qt.AlignmentFlag.AlignRight if column else Qt.AlignmentFlag.AlignLeft
            label.setAlignment(side)
            self._grid.addWidget(label, len(self._cells), column)
        self._cells.append(cells)
