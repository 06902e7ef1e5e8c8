"""*Copy as command*: puts together, in the background, the call that repeats a run."""

from __future__ import annotations

from functools import partial
from typing import Any

from qtpy.QtWidgets import QApplication, QFileDialog, QWidget

from ...runs.batch import write_batch
from ...runs.run_files import Chosen, needs_folder
from ..document import Document
from ..qt import action


class CommandCopy:
    """Asks for a folder where image or seeds are in no files, writes them, copies the command."""

    def __init__(self, doc: Document, parent: QWidget) -> None:
        self._doc = doc
        self._parent = parent
        # Image files are compared, and meshes of seeds are computed: it may take seconds.
        self._checking = doc.background(self._checked, doc.refuse)
        self._writing = doc.background(self._done, doc.refuse)
        tip = "The command that repeats this run without a window."
        self.copy_action = action("Copy as command", tip, partial(doc.guarded, self.copy), parent)
        tip = "Writes batch.toml with these settings beside the stacks, and copies its command."
        slot = partial(doc.guarded, self._run_folder)
        self.folder_action = action("Run on a folder...", tip, slot, parent)

    @property
    def busy(self) -> bool:
        return self._checking.busy or self._writing.busy

    def copy(self) -> None:
        """Put the command together of what is chosen. InputError where something is missing."""
        doc = self._doc
        frame, pixels = doc.image.frame(), doc.image.stack()
        seeds = doc.cells.seeds(frame)
        settings, second = doc.run_settings(seeds), doc.second.pixels()
        doc.noted.emit("putting the command together ...")
        chosen = Chosen(settings, pixels, frame.grid(pixels.shape), seeds, second)
        self._checking.ask(chosen.compared)

    def _run_folder(self) -> None:
        folder = QFileDialog.getExistingDirectory(self._parent, "Folder of stacks")
        if folder:
            self._done(write_batch(folder, self._doc.run_settings()))

    def _checked(self, chosen: Chosen) -> None:
        folder = ""
        if needs_folder(chosen.settings):
            self._doc.noted.emit("")
            title = "Folder for the image and the seeds, which are not in files yet"
            folder = str(QFileDialog.getExistingDirectory(self._parent, title))
            if not folder:
                return
        self._writing.ask(partial(chosen.command, folder))

    def _done(self, text: str) -> None:
        self._doc.noted.emit("")
        clipboard: Any = QApplication.clipboard()
        clipboard.setText(text)
        self._doc.told.emit(f"copied: {text}")
