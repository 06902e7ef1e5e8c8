"""*Copy as command*: puts together, in the background, the call that repeats a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...images.stacks import holds_image
from ...runs.command import command
from ...runs.seeds import Seeds
from ...runs.settings import RunSettings
from ...scene import Grid
from ..background import Background
from .run_files import needs_folder, with_files, with_second_file


@dataclass(frozen=True, eq=False)
class Wanted:
    """A run that a command is to repeat; ``second`` is the image of its second view, if any."""

    settings: RunSettings
    pixels: NDArray[Any]
    grid: Grid
    seeds: Seeds
    second: NDArray[Any] | None = None


class CommandCopy:
    """Asks for a folder where image or seeds are in no files, writes them, and gives the command.

    Parameters
    ----------
    ask_folder : asks the user for a folder; '' for none.
    done : called with the command.
    warn : called with a sentence where it fails.
    """

    def __init__(
        self,
        ask_folder: Callable[[], str],
        done: Callable[[str], None],
        warn: Callable[[str], None],
    ) -> None:
        self._ask_folder: Callable[[], str] | None = ask_folder
        # Image files are compared, and meshes of seeds are computed: it may take seconds.
        self._checking = Background(self._checked, warn)
        self._writing = Background(done, warn)

    @property
    def busy(self) -> bool:
        """Whether a command is still to come."""
        return self._checking.busy or self._writing.busy

    def copy(self, wanted: Wanted) -> None:
        """Put the command together."""
        self._checking.ask(partial(checked, wanted))

    def close_links(self) -> None:
        """Call nobody any more."""
        self._checking.close()
        self._writing.close()
        self._ask_folder = None

    def _checked(self, wanted: Wanted) -> None:
        folder = ""
        if needs_folder(wanted.settings):
            folder = self._ask_folder() if self._ask_folder is not None else ""
            if not folder:
                return
        self._writing.ask(partial(written, wanted, folder))


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
