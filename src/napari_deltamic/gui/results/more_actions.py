"""What the menu *More* offers: sessions, the command of a run, runs on a folder."""

from __future__ import annotations

from collections.abc import Generator
from functools import partial
from pathlib import Path
from typing import Any

from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QApplication, QFileDialog, QWidget

from ...errors import InputError
from ...results.session_file import EXTENSION, load_session, save_session
from ...results.session_parts import Session
from ...runs.batch import write_batch
from ...runs.run_files import Chosen, needs_folder
from ..calm import Calm
from ..document import Document
from ..widgets import action
from .session import Parts, capture, restore


class CommandCopy:
    """Copies the command; asks for a folder first if image or seeds must be written to files."""

    def __init__(self, doc: Document, parent: QWidget) -> None:
        self._doc = doc
        self._parent = parent
        # Image files are compared, and meshes of seeds are computed: it may take seconds.
        self.background = doc.background(self._failed)
        tip = "The command that repeats this run without a window."
        self.copy_action = action("Copy as command", tip, partial(doc.attempt, self.copy), parent)
        tip = (
            "Writes batch.toml into a folder of stacks, to fit them all with these settings, and "
            "copies the command that runs it. Nothing is started, and no cells are needed here: "
            "each stack's seeds are files beside it, or are found."
        )
        slot = partial(doc.attempt, self._prepare_batch)
        self.folder_action = action("Prepare a batch...", tip, slot, parent)

    def copy(self) -> None:
        """Copy the command for what is chosen. InputError if something is missing."""
        doc = self._doc
        frame, pixels = doc.image.frame(), doc.image.stack()
        seeds = doc.cells.seeds(frame)
        settings, second = doc.run_settings(seeds.path), doc.second.pixels()
        doc.noted.emit("putting the command together ...")
        chosen = Chosen(settings, pixels, frame.grid(pixels.shape), seeds, second)
        self.background.ask(chosen.compared, self._checked)

    def _prepare_batch(self) -> None:
        doc = self._doc
        fit = doc.settings.fit_of_any_image()
        settings = doc.run_settings().model_copy(
            update={"fit": fit}
        )  # what is missing is told first
        folder = QFileDialog.getExistingDirectory(self._parent, "Folder of stacks")
        if folder:
            _copy(write_batch(folder, settings))
            doc.told.emit(
                "nothing runs yet: paste the command, which was copied, into a terminal. "
                f"batch.toml was written to {folder}"
            )

    def _failed(self, reason: str) -> None:
        """Tell why it failed, which has nothing to do with the fit that is shown."""
        self._doc.noted.emit("")
        self._doc.warned.emit(reason)

    def _checked(self, chosen: Chosen) -> None:
        folder = ""
        if needs_folder(chosen.settings):
            self._doc.noted.emit("")
            title = "Folder for the image and the seeds, which are not in files yet"
            folder = str(QFileDialog.getExistingDirectory(self._parent, title))
            if not folder:
                return
        self.background.ask(partial(chosen.command, folder), self._done)

    def _done(self, text: str) -> None:
        self._doc.noted.emit("")
        _copy(text)
        self._doc.told.emit(f"copied: {text}")


def _copy(text: str) -> None:
    clipboard: Any = QApplication.clipboard()
    clipboard.setText(text)


_OPEN, _SAVE = ("Open session...", "Opening ..."), ("Save session...", "Saving ...")
_KIND = f"deltaMic session (*{EXTENSION})"


class SessionBar:
    """*Open session...* and *Save session...*."""

    def __init__(self, parts: Parts, parent: QWidget) -> None:
        self._parts, self._shown_in = parts, parent
        self._doc = doc = parts.doc
        doc.at_end(self._forget)
        tip = (
            "Open a .deltamic file: image, cells, settings, meshes, table and history come back "
            "as they were."
        )
        self.open_action = action(_OPEN[0], tip, self._ask_open, parent)
        tip = (
            "Save image, cells, settings, meshes and history in one file. Of a 4D image, only the "
            "time point that is fitted, or all of them where cells were tracked."
        )
        self.save_action = action(_SAVE[0], tip, self._ask_save, parent)
        self._saving, self._opening = (doc.background(self._failed) for _ in range(2))
        self._steps: Generator[None] | None = None  # that are left of showing a session
        self._calm = Calm()

    @property
    def busy(self) -> bool:
        return self._saving.busy or self._opening.busy or self._steps is not None

    def save(self, path: str) -> None:
        """Save what is shown now. InputError if there is nothing to save."""
        session, remark = capture(self._parts)
        if remark:
            self._doc.warned.emit(remark)
        record = self._doc.records.get(self._doc.image.layer)
        # While a fit runs, its newest state is saved instead of the result.
        held = None if record is None or self._doc.running else record.reached
        tracked = self._parts.tracking.results if session.tracks is not None else []

        def saved(written: None) -> None:
            if record is not None and session.result is not None:
                self._doc.note_saved(record, held)
            self._parts.tracking.note_saved(tracked)
            self._show()
            self._doc.told.emit(f"saved {path}")

        self._saving.ask(partial(save_session, path, session), saved)
        self._show()

    def open(self, path: str) -> None:
        """Open a session; it is shown when it has been read."""
        self._calm.begin()
        self._opening.ask(partial(load_session, path), self._opened)
        self._show()

    def _forget(self) -> None:
        """The window is closed: stop opening; a file being written is completed."""
        self._steps = None
        self._calm.end()

    def _failed(self, text: str) -> None:
        """A file could not be written, or read."""
        self._show()
        self._doc.warned.emit(text)

    def _opened(self, session: Session) -> None:
        self._steps = restore(self._parts, session)
        self._go_on()

    def _go_on(self) -> None:
        """Do the next step of opening; then the window has its turn."""
        steps, self._steps = self._steps, None
        if steps is None:
            return
        self._doc.attempt(partial(self._take_step, steps))
        self._show()

    def _take_step(self, steps: Generator[None]) -> None:
        for _ in steps:
            self._steps = steps
            QTimer.singleShot(0, self._go_on)
            break

    def _ask_open(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self._shown_in, "Open session", "", _KIND)
        if path:
            self._doc.attempt(partial(self.open, path))

    def _ask_save(self) -> None:
        path, _ = QFileDialog.getSaveFileName(
            self._shown_in, "Save session", f"session{EXTENSION}", _KIND
        )
        if path:
            self._doc.attempt(partial(self._save_as, path))

    def _save_as(self, path: str) -> None:
        if Path(path).suffix.lower() != EXTENSION:
            path += EXTENSION
            if Path(path).exists():  # of which the dialog did not warn
                raise InputError(f"{path} is there already: choose it, or another name")
        self.save(path)

    def _show(self) -> None:
        """Show on the actions what is under way."""
        opening = self._opening.busy or self._steps is not None
        if not opening:
            self._calm.end()
        for one, busy, words in (
            (self.open_action, opening, _OPEN),
            (self.save_action, self._saving.busy, _SAVE),
        ):
            one.setEnabled(not busy)
            one.setText(words[busy])
