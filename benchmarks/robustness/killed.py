"""A child of the experiment with kills: the command line, ended at a place that is named.

``python -m benchmarks.robustness.killed PLACE NUMBER SIGNAL fit ...``: the NUMBER-th time that it
comes to the place, the process gets the signal.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from napari_deltamic.cli import fit_command, main
from napari_deltamic.common import writing
from napari_deltamic.fitting import job

# Where a run may be ended: after an iteration, with half a file written, before a file replaces
# another, and after.
PLACES = ("iteration", "half", "replace", "replaced")


def ended_at(place: str, here: Callable[[], None]) -> None:
    """Have a function called whenever the process comes to a place."""
    if place == "iteration":
        fit = job.fit

        def watched(*arguments: Any, **options: Any) -> Any:
            for state in fit(*arguments, **options):
                yield state
                here()

        job.fit = watched
    elif place == "half":
        written = writing._written

        def half(target: Path, data: bytes) -> Path:
            if len(data) > 1:
                name = f".deltamic-{writing._machine()}-{os.getpid()}-{'0' * 16}.tmp"
                target.with_name(name).write_bytes(data[: len(data) // 2])
                here()
                target.with_name(name).unlink()
            return written(target, data)

        writing._written = half
    else:
        replace = Path.replace

        def replaced(path: Path, target: Any) -> Path:
            if place == "replace":
                here()
            done = replace(path, target)
            if place == "replaced":
                here()
            return done

        Path.replace = replaced  # type: ignore[method-assign]


if __name__ == "__main__":
    left = int(sys.argv[2])

    def _here() -> None:
        global left
        left -= 1
        if left == 0:
            os.kill(os.getpid(), getattr(signal, sys.argv[3]))

    fit_command.CHECKPOINT_EVERY = 0.0
    ended_at(sys.argv[1], _here)
    raise SystemExit(main(sys.argv[4:]))
