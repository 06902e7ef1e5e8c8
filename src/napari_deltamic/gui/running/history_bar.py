"""A slider over the moments of a fit, and the actions from there."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from qtpy.QtCore import Qt
from qtpy.QtWidgets import QSlider, QWidget
from superqt.utils import signals_blocked

from ...common.words import sentence
from ...errors import InputError
from ...results.timeline import Moment
from ..document import Document
from ..widgets import Note, button, column, row, small
from ..window_words import as_tip
from .edits import OTHER_PSF, Edits, can_take

_EVERY = 0.2  # s between two updates of the slider
_UNABLE = f"{OTHER_PSF[0].upper()}{OTHER_PSF[1:]}: stop it to continue from here"


class HistoryBar(QWidget):
    """Undo, redo and the slider; at its right end the newest state is shown, as it comes.

    Parameters
    ----------
    control : shows other moments, and lets a fit go on from them.
    """

    def __init__(self, doc: Document, edits: Edits, control: Any, parent: QWidget) -> None:
        super().__init__(parent)
        self._doc, self._edits, self._control = doc, edits, control
        self._next = 0.0
        self._moments: tuple[Moment, ...] = ()
        self.undo_button = small(button("↶", "", partial(self._take_back, edits.undo), self))
        self.redo_button = small(button("↷", "", partial(self._take_back, edits.redo), self))
        self.slider = QSlider(Qt.Orientation.Horizontal, self)
        self.slider.setToolTip("Look at earlier moments; a fit that runs continues meanwhile.")
        self.slider.setMinimumWidth(60)
        tip = "Show the newest state again."
        self.live_button = button("Back to the end", tip, self.to_live, self)
        self.note = Note(self)
        go_on = partial(doc.guarded, self.go_on)
        self.go_on_button = button("Continue from here", "", go_on, self)
        moments = row(self.undo_button, self.redo_button, self.slider, spacing=4)
        column(moments, self.note, row(self.live_button, self.go_on_button), of=self)
        self.slider.valueChanged.connect(self._slid)
        doc.began.connect(self._began)
        doc.shown.connect(self._shown)
        for signal in (doc.ended, doc.result_changed):
            signal.connect(self.update_moments)
        doc.image.changed.connect(self._image_changed)
        doc.image.looked.connect(self._show)
        edits.changed.connect(self._show_undo)
        self._show_undo()
        self.update_moments()

    def update_moments(self) -> None:
        """Update the slider to the present moments; the one shown stays, or the nearest to it."""
        self._moments = tuple(self._doc.timeline.moments)
        last = max(len(self._moments) - 1, 0)
        with signals_blocked(self.slider):
            self.slider.setRange(0, last)
            self.slider.setEnabled(last > 0)
            chosen = self._doc.moment
            self.slider.setValue(last if chosen is None else self._index(chosen))
        self._show()

    def to_live(self) -> None:
        """Follow the newest state."""
        with signals_blocked(self.slider):
            self.slider.setValue(self.slider.maximum())
        self._choose(None)

    @property
    def _of_other_image(self) -> str:
        """Why no fit can continue from here, if the image is not as it was fitted; else ''."""
        doc = self._doc
        if doc.running or not doc.other:
            return ""
        return {
            "size": f"this was fitted with {doc.other_size}, which the image no longer has",
            "pixels": "this was fitted to other pixels, which the image no longer has",
            "place": "this was fitted where the image no longer lies: move it back",
        }[doc.other]

    def _image_changed(self) -> None:
        if not self._doc.running:  # the moments are those of another fit
            self._began()

    def _began(self, fresh: bool = True) -> None:
        self.to_live()
        self.update_moments()

    def _shown(self, snapshot: Any) -> None:
        now = time.monotonic()
        if now >= self._next:
            self._next = now + _EVERY
            self.update_moments()

    def go_on(self) -> None:
        """Let the fit continue from the moment shown, or start one there.

        InputError where it would not be one of the image as it is now.
        """
        if self._of_other_image:
            raise InputError(self._of_other_image)
        moment, present = self._doc.moment, self._doc.present()
        if moment is not None:
            note = f"back to iteration {moment.iteration}"
            self._edits.go_on_from(moment.mesh, moment.optics, note)
            self.to_live()
        elif present is not None and not present.running:
            self._edits.go_on_from(present.state.mesh, present.state.optics, "go on")

    def _take_back(self, action: Callable[[], None], checked: bool = False) -> None:
        self.to_live()
        self._doc.guarded(action)
        self.update_moments()

    def _show_undo(self) -> None:
        for one, word, what in (
            (self.undo_button, "Undo", self._edits.undo_note),
            (self.redo_button, "Redo", self._edits.redo_note),
        ):
            one.setEnabled(bool(what))
            one.setToolTip(f"{word}: {what}" if what else f"Nothing to {word.lower()}.")

    def _slid(self, index: int) -> None:
        at_end = index >= len(self._moments) - 1
        self._choose(None if at_end else self._moments[index])

    def _choose(self, moment: Moment | None) -> None:
        if moment is not self._doc.moment:
            self._doc.look_back(moment)
            self._show()
            if moment is None:
                self._control.let_go()
            else:
                self._control.hold(moment.mesh)

    def _index(self, moment: Moment) -> int:
        # By identity; a moment that was thinned out lies between two that stayed.
        for k, other in enumerate(self._moments):
            if other is moment:
                return k
        nearest = self._doc.timeline.nearest(moment.iteration) or 0
        return min(nearest, max(len(self._moments) - 2, 0))

    def _show(self) -> None:
        shown, running = self._doc.moment, self._doc.running
        looking = shown is not None
        self.live_button.setVisible(looking)
        self.go_on_button.setVisible(looking or (not running and bool(self._moments)))
        present, tip = self._doc.present(), "Start a fit from the state shown, with little blur."
        able = shown is None or present is None or can_take(shown.optics, present)
        if running:
            tip = "The fit goes on from the state shown."
        why = sentence(self._of_other_image or ("" if able else _UNABLE))
        self.go_on_button.setEnabled(not why)
        self.go_on_button.setToolTip(as_tip(why or tip))
        text = ""
        if shown is not None:
            text = f"iteration {shown.iteration}"
            if shown.note:
                text += f": {shown.note}"
            if not able:
                text += f". {_UNABLE}."
        self.note.say(text)
