"""Run, pause and stop, and how the fit is getting on."""

from __future__ import annotations

from collections.abc import Sequence

from qtpy.QtWidgets import (
    QCheckBox,
    QGridLayout,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from ...results.report import History
from ...results.timeline import Moment
from ..editing.edit_bar import EditBar
from ..editing.history_bar import HistoryBar
from ..panels.fields import note_label
from ..panels.fold import Fold
from ..qt import Signal
from .curves import ExplainedCurve, SigmaCurve
from .live_numbers import LiveNumbers

_COLOURS = {"converged": "#3fae6b", "ended": "#d99a1c", "stopped": "#d99a1c", "failed": "#e0564f"}


class RunPanel(QGroupBox):
    """Buttons, progress, PSF and what is explained; signals for what the user asks for."""

    run = Signal()
    pause = Signal(bool)
    stop = Signal()
    copy_command = Signal()
    rendered_toggled = Signal(bool)
    residual_toggled = Signal(bool)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__("Run", parent)
        self.run_button = QPushButton("Run", self)
        self.run_button.setToolTip("Fit from the seeds that are ticked, with the settings above.")
        self.pause_button = QPushButton("Pause", self)
        self.pause_button.setToolTip("Let the fit wait, and go on; it can be edited meanwhile.")
        self.pause_button.setCheckable(True)
        self.stop_button = QPushButton("Stop", self)
        self.stop_button.setToolTip("End the fit; what it reached is kept.")
        self.progress = QProgressBar(self)
        self.progress.setTextVisible(True)
        self.message = note_label()
        self.verdict = QLabel(self)
        self.verdict.setWordWrap(True)
        self.remarks = RemarkList(self)
        self.note = note_label()
        self.edit = EditBar(self)
        self.history = HistoryBar(self)
        self.curve = ExplainedCurve(self)
        self.sigmas = SigmaCurve(self)
        self.psf = PsfTable(self)
        self.numbers = LiveNumbers(self)
        self.rendered = QCheckBox("rendered image", self)
        self.rendered.setToolTip("Show what the microscope would see of the present meshes.")
        self.residual = QCheckBox("residual", self)
        self.residual.setToolTip(
            "<qt>Show measured minus rendered image, in standard deviations of the noise: green is "
            "brighter than the model, magenta darker. After a fit the table tells how well each "
            "cell is explained.</qt>"
        )
        self.command_button = QPushButton("Copy as command", self)
        self.command_button.setToolTip("The command that repeats this run without a window.")
        self._lay_out()
        self.run_button.clicked.connect(self.run)
        self.pause_button.toggled.connect(self._pause)
        self.stop_button.clicked.connect(self.stop)
        self.command_button.clicked.connect(self.copy_command)
        self.rendered.toggled.connect(self.rendered_toggled)
        self.residual.toggled.connect(self.residual_toggled)
        self.set_running(False)
        self.sigmas.hide()
        # Until there is something to see, to edit, and to go back to.
        self._of_a_fit = (self.curve, self.psf, self._shown, self.edit, self.history)
        for row in self._of_a_fit:
            row.hide()
        self.say("")
        self.tell("")
        self.show_verdict("", "")

    def set_running(self, running: bool) -> None:
        """Which buttons can be pressed."""
        self.run_button.setEnabled(not running)
        self.pause_button.setEnabled(running)
        self.stop_button.setEnabled(running)
        self.progress.setVisible(running)
        if running:
            self.progress.setRange(0, 0)
            self.show_verdict("", "")
            self.tell("")
            self.curve.show_losses([], [])
        else:
            self.pause_button.setChecked(False)

    def show_fit(self, shown: bool = True) -> None:
        """There is a fit: show all that belongs to one, or hide it, as it is of another image."""
        for row in self._of_a_fit:
            row.setVisible(shown)
        self.sigmas.setVisible(shown and self.sigmas.varies)
        self.numbers.setVisible(shown and bool(self.numbers.texts()))

    def say(self, text: str) -> None:
        """What is going on, in a line."""
        self.message.setText(text)
        self.message.setVisible(bool(text))

    def tell(self, text: str) -> None:
        """What came of something that the user did, in a line."""
        self.note.setText(text)
        self.note.setVisible(bool(text))

    def show_progress(
        self,
        history: History,
        level: int,
        levels: int,
        rate: float,
        remaining: float | None = None,
    ) -> None:
        """Where the fit is: iterations a second and, where it is known, s that remain."""
        self.progress.setRange(0, levels)
        self.progress.setValue(level - 1)
        self.progress.setFormat(f"level {level} of {levels}")
        self.say(progress_text(len(history.loss), rate, remaining))
        self.curve.show_losses(history.loss, history.level, history.first)

    def show_verdict(self, verdict: str, text: str) -> None:
        """How it ended, in the first line of a text; those after it are remarks, in a list."""
        self.last_verdict = (verdict, text)
        said, *remarks = text.split("\n")
        self.verdict.setStyleSheet(f"color: {_COLOURS.get(verdict, '')}; font-weight: bold;")
        self.verdict.setText(said)
        self.verdict.setVisible(bool(said))
        self.remarks.show_remarks(remarks)

    def show_sigmas(self, moments: Sequence[Moment]) -> None:
        """The widths of the PSF over the fit; nothing where they never changed."""
        self.sigmas.show_moments(moments)
        self.sigmas.setVisible(self.sigmas.varies)

    def _pause(self, paused: bool) -> None:
        self.pause_button.setText("Go on" if paused else "Pause")
        self.pause.emit(paused)

    def _lay_out(self) -> None:
        buttons = QHBoxLayout()
        for button in (self.run_button, self.pause_button, self.stop_button):
            buttons.addWidget(button)
        self._shown = QWidget(self)
        shown = QHBoxLayout(self._shown)
        shown.setContentsMargins(0, 0, 0, 0)
        for box in (QLabel("show", self), self.rendered, self.residual):
            shown.addWidget(box)
        shown.addStretch()
        plots = QHBoxLayout()
        for plot in (self.curve, self.sigmas):
            plots.addWidget(plot)
        layout = QVBoxLayout(self)
        layout.addLayout(buttons)
        parts: tuple[QWidget, ...] = (
            self.progress,
            self.message,
            self.verdict,
            self.remarks,
            self.note,
        )
        for widget in parts:
            layout.addWidget(widget)
        layout.addLayout(plots)
        for widget in (self.history, self.edit, self.psf, self.numbers):
            layout.addWidget(widget)
        layout.addWidget(self._shown)
        layout.addWidget(self.command_button)


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
