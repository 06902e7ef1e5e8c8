"""Keeps freed memory for the next image, where the C library is glibc.

By default it returns to the system after every image and is fetched again page by page for the
next: measured, a third of the time of an image of 100^3 voxels with its gradient. So up to 128 MB
are kept. An environment that sets MALLOC_TRIM_THRESHOLD_ itself is left alone.
"""

import ctypes
import os
import sys
from contextlib import suppress
from pathlib import Path

_KEPT, _FROM_SYSTEM = 128 << 20, 32 << 20  # bytes: kept at most; larger blocks always go back
_SPARE = 384 << 20  # bytes; chosen: three times what is kept anyway
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of malloc.h

if sys.platform.startswith("linux") and "MALLOC_TRIM_THRESHOLD_" not in os.environ:
    with suppress(OSError, AttributeError):  # another C library
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_TRIM_THRESHOLD, _KEPT)
        mallopt(_M_MMAP_THRESHOLD, _FROM_SYSTEM)


def give_back() -> None:
    """Return all free memory to the system, including that between blocks in use."""
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)


class SpareMemory:
    """Returns free memory to the system once this process has grown since the last time.

    On its own, malloc returns only what lies above all blocks in use, and a fit leaves gaps of many
    sizes between the arrays that it keeps.
    """

    def __init__(self) -> None:
        self._after = 0

    def give_back(self) -> None:
        """Return free memory if the process has grown enough; to be called between steps."""
        if _resident() > self._after + _SPARE:
            give_back()
            self._after = _resident()


SPARE = SpareMemory()


def _resident() -> int:
    """Resident memory of this process in bytes; 0 where the system does not tell it."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")
