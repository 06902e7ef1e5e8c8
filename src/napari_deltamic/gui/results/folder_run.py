"""*Run on a folder*: a batch file with the settings of the window, and the command that runs it."""

from __future__ import annotations

import shlex
from pathlib import Path

from ...common.writing import write_atomically
from ...errors import PROGRAM, InputError
from ...runs.batch import batch_for
from ...runs.settings import RunSettings

BATCH_FILE, RESULTS = "batch.toml", "results"


def write_batch(folder: str | Path, settings: RunSettings) -> str:
    """Write ``batch.toml`` into a folder of stacks; returns the command that fits them all.

    Raises
    ------
    InputError
        If there is a file of that name, no image, or the settings are those of one image only.
    """
    path = Path(folder) / BATCH_FILE
    if path.exists():
        raise InputError(f"{path} is there already: rename it, or run it")
    write_atomically(path, batch_for(folder, settings).to_toml().encode())
    return shlex.join([PROGRAM, "batch", str(path), "-o", str(Path(folder) / RESULTS)])
