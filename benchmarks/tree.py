"""Which tree is measured, and on what machine."""

from __future__ import annotations

import platform
import subprocess
import time
from pathlib import Path

from napari_deltamic.accuracy.machine_costs import processor
from napari_deltamic.fourier.native import threads

MEASURED = ("src", "csrc")  # what figures follow from


def commit() -> str:
    """The last commit that changed what is measured, with a plus where files differ from it.

    "" where none is known. Commits that change docs, tests or benchmarks alone leave figures, and
    the scenes drawn from this, as they are.
    """
    found = _git("log", "-1", "--format=%H", "--", *MEASURED)
    return f"{found}+" if found and _git("status", "--porcelain", "--", *MEASURED) else found


def measured_on() -> str:
    """The line below a table: the tree, the day and the machine."""
    tree, day = commit(), time.strftime("%Y-%m-%d")
    dirty = " with changes" if tree.endswith("+") else ""
    count = threads()
    many = "one thread" if count == 1 else f"{count} threads"
    return (
        f"*Measured: {tree[:7] or 'unknown tree'}{dirty}, {day}, {processor()}, {many} of "
        f"{platform.system()} {platform.machine()}.*"
    )


def _git(*words: str) -> str:
    """What git says; "" where there is none, or no repository."""
    try:
        told = subprocess.run(
            ["git", *words],
            cwd=Path(__file__).parents[1],
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return ""
    return told.stdout.strip()
