"""How freed memory is kept for the next image, where the C library is that of GNU.

By default it goes back to the system after every image and comes again page by page for the next
one: measured, a third of the time of an image of 100^3 voxels with its gradient. So 128 MB at most
are kept. An environment that sets MALLOC_TRIM_THRESHOLD_ itself is left alone.
"""

import ctypes
import os
import sys
from contextlib import suppress

_KEPT, _FROM_SYSTEM = 128 << 20, 32 << 20  # bytes that are kept; larger pieces always go back
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of malloc.h

if sys.platform.startswith("linux") and "MALLOC_TRIM_THRESHOLD_" not in os.environ:
    with suppress(OSError, AttributeError):  # another C library
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_TRIM_THRESHOLD, _KEPT)
        mallopt(_M_MMAP_THRESHOLD, _FROM_SYSTEM)
