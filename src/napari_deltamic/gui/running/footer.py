"""Fit, pause, stop and progress: always visible, below the part that scrolls."""

from __future__ import annotations

import time
from typing import Any

from qtpy.QtWidgets import QProgressBar, QWidget

from ...common.words import counted, duration, sentence
from ...errors import InputError
from ..document import Document
from ..widgets import Note, button, column, row
from .worker import FitRun, Snapshot

# An iteration takes long after so many seconds, and so many times the usual one: then a forecast
# says nothing; chosen.
_LONG, _USUAL = 4.0, 5.0


class Footer(QWidget):
    """Three buttons, a bar and a line, for whatever work is under way."""

    def __init__(self, doc: Document, control: Any, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._doc = doc
        self._of: tuple[Any, ...] = ()  # the image that the reason is about
        self._iterations, self._since = 0, 0.0  # that were shown, and since when
        self._long = _LONG
        tip = "Fit the surfaces of the cells to the image."
        self.run_button = button("Fit", tip, control.start, self)
        self.run_button.setStyleSheet("font-weight: bold;")
        tip = "Pause. You can edit the cells while paused."
        self.pause_button = button("Pause", tip, None, self)
        self.pause_button.setCheckable(True)
        tip = "Stop what is running; what it has reached is kept."
        self.stop_button = button("Stop", tip, doc.work.stop, self)
        self.progress = QProgressBar(self)
        self.progress.setTextVisible(True)
        self.message = Note(self)
        self.reason = Note(self, verdict="failed")  # why a fit of the image chosen did not start
        buttons = (self.run_button, 2), (self.pause_button, 1), (self.stop_button, 1)
        parts = row(*buttons, spacing=4), self.reason, self.progress, self.message
        column(*parts, of=self, spacing=4).setContentsMargins(4, 4, 4, 4)
        self.pause_button.toggled.connect(self._pause)
        doc.said.connect(self._say)
        doc.failed.connect(self._show_reason)
        changes = doc.cells_changed, doc.settings.changed, doc.image.changed, doc.image.looked
        for signal in changes:
            signal.connect(self._look_again)
        doc.shown.connect(self._show_fit)
        doc.work.changed.connect(self._work_changed)
        doc.work.looked.connect(self._looked)
        self._work_changed()

    def _say(self, text: str) -> None:
        """Show the progress, naming the image of the fit if another one is chosen."""
        name = self._doc.name_of_other(self._doc.record) if self._doc.running else ""
        self.message.say(f"Fit of {name}: {text}" if name and text else text)

    def _work_changed(self) -> None:
        task, self._iterations = self._doc.work.task, 0
        self.run_button.setEnabled(not self._doc.work.occupied)
        self.pause_button.setEnabled(isinstance(task, FitRun))
        self.stop_button.setEnabled(task is not None)
        self.progress.setVisible(task is not None)
        if task is not None:
            self._since = time.monotonic()
            self._advance(0, 0)
            self.reason.say("")
        else:
            self.message.say("")
            self.pause_button.setChecked(False)

    def _show_reason(self, text: str) -> None:
        self._of = self._doc.image.key()
        self.reason.say(sentence(text))

    def _look_again(self, by_user: bool = False) -> None:
        """Something has changed: clear a reason that no longer holds, or replace it."""
        if self.reason.text():
            same = self._of == self._doc.image.key()
            self.reason.say(sentence(self._missing()) if same else "")

    def _missing(self) -> str:
        """Why no fit can start now, as far as is known without reading voxels; '' if one can."""
        doc = self._doc
        try:
            doc.cells.seeds(doc.image.frame(), copied=False)
            doc.run_settings()
        except InputError as error:
            return str(error)
        return ""

    def _looked(self) -> None:
        """Show what a task is doing; a fit that iterates shows more, unless that takes long."""
        task: Any = self._doc.work.task
        if task is not None and task.stopping:  # by a key, as well
            self.message.say("stopping ...")
        elif isinstance(task, FitRun):
            waited = time.monotonic() - self._since
            if task.state is None:
                so_far = f": {waited:.0f} s so far" if waited > _LONG else " ..."
                waits = "pauses as soon as the fit has begun; " if task.paused else ""
                self._say(f"{waits}{task.stage}{so_far}")
            elif self._iterations and waited > self._long and not task.paused:
                doing = "the next step takes longer" if task.stage == "fitting" else task.stage
                so_far = f"{waited:.0f} s so far; {counted(self._iterations, 'iteration')}"
                self._say(f"{doing}: {so_far}")
        elif task is not None:
            self.message.say(f"{task.stage} ...")
            if task.share is not None:
                self._advance(round(100 * task.share), 100)

    def _show_fit(self, snapshot: Snapshot) -> None:
        run, state, left = self._doc.run, snapshot.state, snapshot.remaining
        if run.stopping:
            return
        text = f"level {state.level} of {state.levels}"
        if left is not None and run.seconds + left > 0:
            # Never back: a forecast that grows stands still.
            share = round(100 * run.seconds / (run.seconds + left))
            share = max(share, self.progress.value() if self.progress.maximum() == 100 else 0)
            self._advance(min(share, 99), 100, f"{text}, %p%")
        elif self.progress.maximum() == 100:  # it is known no more
            self._advance(self.progress.value(), 100, text)
        else:
            self._advance(state.level - 1, state.levels, text)
        done, rate = len(run.history.loss), snapshot.iterations_per_second
        self._iterations, self._since = done, time.monotonic()
        self._long = max(_LONG, _USUAL / rate if rate > 0 else 0.0)
        stands = f"paused after {counted(done, 'iteration')}"
        self._say(stands if run.paused else progress_text(done, rate, left))

    def _advance(self, done: int, of: int, text: str = "%p%") -> None:
        """Set the bar without painting it at once: Qt would paint all of the window, and wait."""
        bar = self.progress
        bar.setUpdatesEnabled(False)
        bar.setRange(0, of)
        bar.setValue(done)
        bar.setFormat(text)
        bar.setUpdatesEnabled(True)

    def _pause(self, paused: bool) -> None:
        self.pause_button.setText("Resume" if paused else "Pause")
        self._since = time.monotonic()
        self._doc.work.pause(paused)


def progress_text(iterations: int, rate: float, remaining: float | None) -> str:
    """Iterations done, iterations per second, and the remaining time in words."""
    text = f"{counted(iterations, 'iteration')}, {rate:.{0 if rate >= 2 else 1}f} a second"
    return text if remaining is None else f"{forecast_text(remaining)} left; {text}"


def forecast_text(seconds: float) -> str:
    """An approximate time in words."""
    return "a second" if seconds < 1.5 else f"about {duration(seconds, whole=True)}"
