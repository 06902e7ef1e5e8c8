"""How a fit went: its verdict, its course, what is shown of it, and what can be mended."""

from __future__ import annotations

from collections.abc import Sequence

from qtpy.QtWidgets import (
    QCheckBox,
    QGridLayout,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from ...results.report import History
from ...results.timeline import Moment
from ..editing.edit_bar import EditBar
from ..editing.history_bar import HistoryBar
from ..qt import Signal
from ..widgets import Fold, Note, note_label
from .curves import ExplainedCurve, SigmaCurve
from .footer import Footer
from .live_numbers import LiveNumbers

_GREEN, _AMBER, _RED = "#3fae6b", "#d99a1c", "#e0564f"
_COLOURS = {
    "ended": _AMBER,
    "stopped": _AMBER,
    "failed": _RED,
    "good": _GREEN,
    "fair": _AMBER,
    "poor": _RED,
}


class RunPanel(QGroupBox):
    """What became of a fit, and what can be done with it; ``footer`` is shown elsewhere."""

    rendered_toggled = Signal(bool)
    residual_toggled = Signal(bool)
    go_to_worst = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__("4  Check", parent)
        self.footer = footer = Footer(parent)
        self.run, self.pause, self.stop = footer.run, footer.pause, footer.stop
        self.run_button, self.pause_button = footer.run_button, footer.pause_button
        self.stop_button, self.progress = footer.stop_button, footer.progress
        self.message = footer.message
        self.last_verdict = ("", "")
        self._of_a_fit: tuple[QWidget, ...] = ()
        self._all_estimated = False
        self.verdict = QLabel(self)
        self.verdict.setWordWrap(True)
        self.grade = Note(self)
        self.worst = QPushButton("Worst place", self)
        self.worst.setToolTip("<qt>Go to where the image differs most from the model.</qt>")
        self.again = QPushButton("Fit again: estimate PSF and brightness", self)
        self.again.setToolTip(
            "<qt>Fit once more from these cells, and let the fit find how wide the PSF is and how "
            "bright each part of the membranes is.</qt>"
        )
        self.again.hide()
        self.remarks = RemarkList(self)
        self.note = Note(self)
        self.edit = EditBar(self)
        self.history = HistoryBar(self)
        self.curve = ExplainedCurve(self)
        self.sigmas = SigmaCurve(self)
        self.psf = PsfTable(self)
        self.numbers = LiveNumbers(self)
        self.rendered = QCheckBox("model", self)
        self.rendered.setToolTip(
            "<qt>Show what the microscope would see of the present surfaces.</qt>"
        )
        self.residual = QCheckBox("difference", self)
        self.residual.setToolTip(
            "<qt>Show measured minus rendered image, in standard deviations of the noise: green is "
            "brighter than the model, magenta darker. After a fit the table tells how well each "
            "cell is explained.</qt>"
        )
        self._lay_out()
        self.rendered.toggled.connect(self.rendered_toggled)
        self.residual.toggled.connect(self.residual_toggled)
        self.worst.clicked.connect(self.go_to_worst)
        self.set_running(False)
        self.sigmas.hide()
        # Until there is something to see, to edit, and to go back to.
        self._of_a_fit = (self.curve, self.course, self.psf, self._shown, self.edit, self.history)
        for row in self._of_a_fit:
            row.hide()
        self.say("")
        self.tell("")
        self.show_verdict("", "")
        self.show_grade("", "")

    def set_running(self, running: bool) -> None:
        """Which buttons can be pressed."""
        self.footer.set_running(running)
        if running:
            self.show_verdict("", "")
            self.show_grade("", "")
            self.tell("")
            self.curve.show_losses([], [])

    def show_fit(self, shown: bool = True) -> None:
        """There is a fit: show all that belongs to one, or hide it, as it is of another image."""
        for row in self._of_a_fit:
            row.setVisible(shown)
        self.sigmas.setVisible(shown and self.sigmas.varies)
        self.numbers.setVisible(shown and bool(self.numbers.texts()))
        self._show_some()

    def say(self, text: str) -> None:
        """What is going on, in a line."""
        self.message.say(text)

    def tell(self, text: str) -> None:
        """What came of something that the user did, in a line."""
        self.note.say(text)
        self._show_some()

    def show_progress(
        self,
        history: History,
        level: int,
        levels: int,
        rate: float,
        remaining: float | None = None,
    ) -> None:
        """Where the fit is: iterations a second and, where it is known, s that remain."""
        self.footer.show_level(level, levels)
        self.say(progress_text(len(history.loss), rate, remaining))
        self.curve.show_losses(history.loss, history.level, history.first)
        self.curve.show()
        self._show_some()

    def show_verdict(self, verdict: str, text: str) -> None:
        """How it ended, in the first line of a text; those after it are remarks, in a list."""
        self.last_verdict = (verdict, text)
        said, *remarks = text.split("\n")
        self.verdict.setStyleSheet(f"color: {_COLOURS.get(verdict, '')};")
        self.verdict.setText(said)
        self.verdict.setVisible(bool(said))
        self.remarks.show_remarks(remarks)
        self._show_some()

    def show_grade(self, grade: str, text: str, worst: bool = False) -> None:
        """How well the shapes explain the image, in a sentence; '' for what is not known.

        worst : whether there is a worst place to go to.
        """
        colour = _COLOURS.get(grade, "")
        self.grade.setStyleSheet(f"color: {colour}; font-weight: bold;")
        self.grade.say(text)
        self.worst.setVisible(worst)
        self.again.setVisible(grade in ("fair", "poor") and not self._all_estimated)
        self._show_some()

    def estimates_all(self, yes: bool) -> None:
        """Whether the fit estimated all that it can."""
        self._all_estimated = yes

    def show_sigmas(self, moments: Sequence[Moment]) -> None:
        """The widths of the PSF over the fit; nothing where they never changed."""
        self.sigmas.show_moments(moments)
        self.sigmas.setVisible(self.sigmas.varies)

    def _show_some(self) -> None:
        """The panel is there as long as it has something to say."""
        parts = (*self._of_a_fit, self.verdict, self.note)
        self.setHidden(all(part.isHidden() for part in parts))

    def _lay_out(self) -> None:
        self._shown = QWidget(self)
        shown = QHBoxLayout(self._shown)
        shown.setContentsMargins(0, 0, 0, 0)
        for box in (QLabel("show", self), self.rendered, self.residual):
            shown.addWidget(box)
        shown.addStretch()
        shown.addWidget(self.worst)
        plots = QHBoxLayout()
        for plot in (self.curve, self.sigmas):
            plots.addWidget(plot)
        inner = QWidget(self)
        numbers = QVBoxLayout(inner)
        numbers.setContentsMargins(8, 0, 0, 0)
        numbers.addWidget(self.psf)
        numbers.addWidget(self.numbers)
        self.course = Fold("Numbers that the fit moved", inner, self)
        layout = QVBoxLayout(self)
        layout.addWidget(self.grade)
        layout.addWidget(self.again)
        layout.addWidget(self.verdict)
        rest: tuple[QWidget, ...] = (self.note, self.remarks)
        for widget in rest:
            layout.addWidget(widget)
        layout.addLayout(plots)
        for widget in (self._shown, self.history, self.edit, self.course):
            layout.addWidget(widget)


def progress_text(iterations: int, rate: float, remaining: float | None) -> str:
    """Iterations done, how many a second, and the time that remains, in words."""
    text = f"{iterations} iterations, {rate:.{0 if rate >= 2 else 1}f} a second"
    return text if remaining is None else f"{text}, {duration(remaining)} left"


def duration(seconds: float) -> str:
    """About how long, in words; never more exact than a forecast can be."""
    if seconds < 1.5:
        return "a second"
    for size, name in ((1, "s"), (60, "min"), (3600, "h")):
        if seconds < 90 * size or name == "h":
            return f"about {seconds / size:.0f} {name}"
    return ""


class RemarkList(Fold):
    """What was remarked on the way: how much in its title, all of it when unfolded."""

    def __init__(self, parent: QWidget | None = None) -> None:
        self.label = note_label()
        super().__init__("", self.label, parent)
        self.hide()

    def show_remarks(self, remarks: Sequence[str]) -> None:
        """Show remarks; hidden where there are none."""
        self.set_title(f"{len(remarks)} {'remark' if len(remarks) == 1 else 'remarks'}")
        self.label.setText("\n".join(remarks))
        self.unfold(False)
        self.setVisible(bool(remarks))


class PsfTable(QWidget):
    """Widths of the PSF: at the start, and now."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        layout = QGridLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setVerticalSpacing(1)
        for column, name in enumerate(("PSF sigma, um", "Z", "Y", "X")):
            layout.addWidget(QLabel(name, self), 0, column)
        self._rows = {}
        for row, name in enumerate(("start", "now"), 1):
            layout.addWidget(QLabel(name, self), row, 0)
            self._rows[name] = [QLabel("-", self) for _ in range(3)]
            for column, label in enumerate(self._rows[name], 1):
                layout.addWidget(label, row, column)

    def show_sigma(self, row: str, sigma: Sequence[float]) -> None:
        """Fill the row 'start' or 'now', um, Z, Y, X."""
        for label, value in zip(self._rows[row], sigma, strict=True):
            label.setText(f"{value:.3f}")

    def shown(self, row: str) -> list[str]:
        """What a row says."""
        return [label.text() for label in self._rows[row]]
