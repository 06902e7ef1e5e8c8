"""Checks of arguments that several commands share."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from ...common.accuracy_bounds import check_accuracy
from ...common.choices import is_auto
from ...errors import InputError
from ...runs.fit_settings import validated
from ...runs.scene_settings import RunFields
from ..flags import values_given


def check_files(arguments: argparse.Namespace, *names: str) -> None:
    """Raise InputError unless the files that these arguments name exist."""
    for name in names:
        path = getattr(arguments, name)
        asked = path is not None and not (name == "seeds" and is_auto(path))
        if asked and not Path(path).exists():
            raise InputError(f"{path}: there is no such file")


def check_file_to_write(path: Path, *, folder: bool = False) -> None:
    """Raise InputError unless a file (or, with ``folder``, a folder) can be written or replaced."""
    if path.is_dir() and not folder:
        raise InputError(f"{path} is a folder; name a file")
    if not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise InputError(
            f"{path.parent} does not exist or cannot be written to: choose another folder"
        )


def check_given_accuracy(arguments: argparse.Namespace) -> None:
    """Raise InputError if an accuracy is given that is not possible."""
    if arguments.accuracy is not None:
        check_accuracy(arguments.accuracy)


def check_channel(arguments: argparse.Namespace) -> None:
    """Raise InputError if a channel is given that is not possible, such as 0."""
    given = values_given(arguments, RunFields, ("channel",))
    validated(RunFields, {"image": "", "seeds": "", **given})
