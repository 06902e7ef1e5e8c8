"""Folders for results, checked before any work."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from ..errors import InputError


def check_folder(
    folder: Path, names: Sequence[str], *, overwrite: bool = False, but: str | None = None
) -> None:
    """Refuse, before any work, a folder that cannot take results or holds others.

    Parameters
    ----------
    folder
        Need not exist; it is made later.
    names
        File names of results that would be lost.
    overwrite
        Whether these may be replaced.
    but
        A file that may be there all the same, such as the checkpoint that a run continues from.

    Raises
    ------
    InputError
        Saying which folder cannot be written to, or what it holds.
    """
    above = folder.absolute()
    while not above.exists() and above != above.parent:
        above = above.parent
    if not above.is_dir():
        raise InputError(f"{above} is a file, not a folder")
    if not os.access(above, os.W_OK | os.X_OK):
        raise InputError(f"{folder}: cannot be written: no permission for {above}")
    if overwrite:
        return
    for name in names:
        path = folder / name
        if path.exists() and not (but is not None and _same(path, Path(but))):
            raise InputError(f"{folder} holds {name}; --overwrite replaces what is there")


def check_kept(folder: Path, names: Sequence[str], *files: str | None) -> None:
    """Raise InputError if results would replace a file that they are made from."""
    for file in files:
        if file is not None and any(_same(folder / name, Path(file)) for name in names):
            raise InputError(f"{file} would be replaced by the results: choose another folder")


def _same(one: Path, other: Path) -> bool:
    return one.exists() and other.exists() and one.samefile(other)
