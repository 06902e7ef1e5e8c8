"""*Copy as command*: puts together, in the background, the call that repeats a run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtWidgets import QApplication, QFileDialog, QWidget

from ...images.stacks import holds_image
from ...runs.command import command
from ...runs.run_files import needs_folder, with_files, with_second_file
from ...runs.seeds import Seeds
from ...runs.settings import RunSettings
from ...scene import Grid
from ..document import Document
from ..work import Background
from .folder_run import write_batch


@dataclass(frozen=True, eq=False)
class Wanted:
    """A run that a command is to repeat; ``second`` is the image of its second view, if any."""

    settings: RunSettings
    pixels: NDArray[Any]
    grid: Grid
    seeds: Seeds
    second: NDArray[Any] | None = None


class CommandCopy:
    """Asks for a folder where image or seeds are in no files, writes them, copies the command.

    Parameters
    ----------
    doc : the document.
    parent : Qt's, over which the folder is asked for.
    """

    def __init__(self, doc: Document, parent: QWidget) -> None:
        self._doc = doc
        self._parent: QWidget | None = parent
        # Image files are compared, and meshes of seeds are computed: it may take seconds.
        self._checking = Background(self._checked, doc.refuse)
        self._writing = Background(self._done, doc.refuse)
        doc.parts.append(self)

    @property
    def busy(self) -> bool:
        """Whether a command is still to come."""
        return self._checking.busy or self._writing.busy

    def copy(self) -> None:
        """Put the command together of what is chosen."""
        self._doc.guarded(self._copy)

    def run_folder(self) -> None:
        """Write a batch file with these settings beside the stacks of a folder."""
        self._doc.guarded(self._run_folder)

    def close_links(self) -> None:
        """Call nobody any more."""
        self._checking.close()
        self._writing.close()
        self._parent = None

    def _copy(self) -> None:
        doc = self._doc
        frame, pixels = doc.image.frame(), doc.image.stack()
        seeds = doc.cells.seeds(frame)
        settings, second = doc.run_settings(seeds), doc.settings.effects.second.pixels()
        doc.noted.emit("putting the command together ...")
        wanted = Wanted(settings, pixels, frame.grid(pixels.shape), seeds, second)
        self._checking.ask(partial(checked, wanted))

    def _run_folder(self) -> None:
        folder = QFileDialog.getExistingDirectory(self._parent, "Folder of stacks")
        if folder:
            self._done(write_batch(folder, self._doc.run_settings()))

    def _checked(self, wanted: Wanted) -> None:
        folder = ""
        if needs_folder(wanted.settings):
            self._doc.noted.emit("")
            title = "Folder for the image and the seeds, which are not in files yet"
            folder = str(QFileDialog.getExistingDirectory(self._parent, title))
            if not folder:
                return
        self._writing.ask(partial(written, wanted, folder))

    def _done(self, text: str) -> None:
        self._doc.noted.emit("")
        clipboard: Any = QApplication.clipboard()
        clipboard.setText(text)
        self._doc.told.emit(f"copied: {text}")


def checked(wanted: Wanted) -> Wanted:
    """The same, without the files of images that were edited since they were opened."""
    settings, view = wanted.settings, wanted.settings.scene.effects.second_view
    if settings.image and not holds_image(settings.image, wanted.pixels):
        settings = settings.model_copy(update={"image": ""})
    second = wanted.second
    if view and view.image and second is not None and not holds_image(view.image, second):
        settings = with_second_file(settings, "")
    return replace(wanted, settings=settings)


def written(wanted: Wanted, folder: str) -> str:
    """The command; what is in no file yet is written into the folder."""
    settings, pixels = wanted.settings, wanted.pixels
    if folder:
        settings = with_files(
            settings, pixels, wanted.grid, wanted.seeds, Path(folder), wanted.second
        )
    output = str(Path(settings.seeds).with_name("result"))
    missing = bool(np.isnan(pixels).any()) if pixels.dtype.kind == "f" else False
    return command(settings, output, missing=missing)
