"""How much memory a piece of work takes at its peak."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from ..common.freed_memory import give_back


class Peak:
    """Measures how far the resident memory of this process rises within a block.

    Linux keeps the highest mark and lets a process reset its own; elsewhere that would need another
    process for every measurement, so ``bytes`` stays None. Memory that was freed before but not
    returned to the system could be reused unnoticed, so it is returned first.
    """

    def __init__(self) -> None:
        self.bytes: int | None = None
        self._before: int | None = None

    def __enter__(self) -> Peak:
        if sys.platform.startswith("linux"):
            give_back()
            try:
                Path("/proc/self/clear_refs").write_text("5")
                self._before = _resident("VmHWM")
            except OSError:  # not allowed here
                self._before = None
        return self

    def __exit__(self, *_: object) -> None:
        after = _resident("VmHWM") if self._before is not None else None
        if self._before is not None and after is not None:
            self.bytes = max(after - self._before, 0)


def _resident(name: str) -> int | None:
    try:
        found = re.search(rf"^{name}:\s+(\d+) kB", Path("/proc/self/status").read_text(), re.M)
    except OSError:
        return None
    return 1024 * int(found[1]) if found else None
