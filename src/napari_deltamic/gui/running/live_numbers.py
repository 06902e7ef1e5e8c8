"""The numbers of the PSF and of the effects that a fit moves: at its start, and now."""

from __future__ import annotations

from dataclasses import dataclass

from qtpy.QtCore import Qt
from qtpy.QtWidgets import QGridLayout, QLabel, QWidget

from ...fitting import FitState
from ...fitting.job import FitInput
from ...optics import GaussianPSF
from ...results.report import effects_found
from ..widgets import Fold


@dataclass(frozen=True)
class MovedNumber:
    """A number that a fit moves; ``start`` is None where it had none."""

    name: str
    unit: str
    start: float | None
    now: float


class LiveNumbers(Fold):
    """The numbers in its title, and a row for each when unfolded; hidden where there is none."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__("", QWidget(), parent)
        self._grid = QGridLayout(self.content)
        self._grid.setContentsMargins(0, 0, 0, 0)
        self._grid.setVerticalSpacing(1)
        self._grid.setColumnStretch(0, 1)
        self._cells: list[tuple[QLabel, QLabel, QLabel]] = []
        self._row("fitted", "start", "now")
        self.show_numbers([])

    def show_fit(self, state: FitState, job: FitInput) -> None:
        """Show the numbers of a state of a fit."""
        self.show_numbers(moved_numbers(state, job))

    def show_numbers(self, numbers: list[MovedNumber]) -> None:
        """Show numbers."""
        while len(self._cells) <= len(numbers):
            self._row("", "", "")
        for k, cells in enumerate(self._cells[1:]):
            for cell in cells:
                cell.setVisible(k < len(numbers))
        for cells, number in zip(self._cells[1:], numbers, strict=False):
            texts = (
                number.name,
                "-" if number.start is None else f"{number.start:.4g}",
                f"{number.now:.4g} {number.unit}".strip(),
            )
            for cell, text in zip(cells, texts, strict=True):
                cell.setText(text)
        now = ", ".join(f"{name} {now}" for name, _, now in self.texts())
        self.set_title(f"Fitted: {now}")
        self.setVisible(bool(numbers))

    def texts(self) -> list[tuple[str, str, str]]:
        """What the rows say."""
        shown = [cells for cells in self._cells[1:] if not cells[0].isHidden()]
        return [(a.text(), b.text(), c.text()) for a, b, c in shown]

    def _row(self, *texts: str) -> None:
        row = len(self._cells)
        name, start, now = (QLabel(text, self.content) for text in texts)
        for column, label in enumerate((name, start, now)):
            label.setAlignment(
                Qt.AlignmentFlag.AlignRight if column else Qt.AlignmentFlag.AlignLeft
            )
            self._grid.addWidget(label, row, column)
        self._cells.append((name, start, now))


def moved_numbers(state: FitState, job: FitInput) -> list[MovedNumber]:
    """Numbers that the fit of a job moves, but for the widths of a Gaussian PSF."""
    found = []
    if job.settings.fit.fit_psf and not isinstance(state.optics, GaussianPSF):
        before = {p.name: p.value for p in job.optics.described()}
        found += [
            MovedNumber(p.name.replace("_", " "), p.unit, before.get(p.name), p.value)
            for p in state.optics.described()
            if p.fitted
        ]
    for effect in effects_found(job.settings.scene.effects, state.effects):
        title = str(effect["name"]).replace("_", " ")
        numbers = effect["numbers"] if effect["fitted"] else []
        for number in numbers:
            name = f"{title}: {str(number['name']).replace('_', ' ')}"
            unit = "" if number["unit"] == "1" else str(number["unit"])
            found.append(MovedNumber(name, unit, number["start"], number["value"]))
    return found
