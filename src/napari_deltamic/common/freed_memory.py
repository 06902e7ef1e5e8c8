"""How freed memory is kept for the next image, where the C library is that of GNU.

By default it goes back to the system after every image and comes again page by page for the next
one: measured, a third of the time of an image of 100^3 voxels with its gradient. So 128 MB at most
are kept. An environment that sets MALLOC_TRIM_THRESHOLD_ itself is left alone.
"""

import ctypes
import os
import sys
from contextlib import suppress
from pathlib import Path

_KEPT, _FROM_SYSTEM = 128 << 20, 32 << 20  # bytes that are kept; larger pieces always go back
_SPARE = 384 << 20  # bytes; chosen: three times what is kept anyway
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of malloc.h

if sys.platform.startswith("linux") and "MALLOC_TRIM_THRESHOLD_" not in os.environ:
    with suppress(OSError, AttributeError):  # another C library
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_TRIM_THRESHOLD, _KEPT)
        mallopt(_M_MMAP_THRESHOLD, _FROM_SYSTEM)


def give_back() -> None:
    """Give all memory that is free back to the system, also between pieces that are in use."""
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)


class SpareMemory:
    """Gives free memory back where this process has grown since the last time.

    By itself only what lies above all that is in use goes back, and a fit makes arrays of many
    sizes between those that it keeps.
    """

    def __init__(self) -> None:
        self._after = 0

    def give_back(self) -> None:
        """To be called between steps, now and then."""
        if _resident() > self._after + _SPARE:
            give_back()
            self._after = _resident()


SPARE = SpareMemory()


def _resident() -> int:
    """Bytes of this process in memory; 0 where that is not told."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")
