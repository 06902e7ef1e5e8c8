"""Queries the NVIDIA driver without torch: whether there is a card, and which CUDA it runs."""

from __future__ import annotations

import ctypes
import sys
from functools import cache

_LIBRARY = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"
# Newest first: CUDA version that a driver must run, and the wheels of torch that need it.
_WHEELS = (((13, 0), "cu130"), ((12, 6), "cu126"))


@cache
def driver_version() -> tuple[int, int] | None:
    """Return the newest CUDA (major, minor) that the driver runs; None without card or driver."""
    try:
        library = ctypes.CDLL(_LIBRARY)
        count, version = ctypes.c_int(0), ctypes.c_int(0)
        failed = (
            library.cuInit(0)
            or library.cuDeviceGetCount(ctypes.byref(count))
            or library.cuDriverGetVersion(ctypes.byref(version))
        )
    except (OSError, AttributeError):
        return None
    if failed or not count.value:
        return None
    return version.value // 1000, version.value % 1000 // 10


def torch_for(driver: tuple[int, int]) -> str:
    """Return the command that installs torch for a driver, or the advice to update the driver."""
    for needed, wheels in _WHEELS:
        if driver >= needed:
            return f"pip install -U torch --index-url https://download.pytorch.org/whl/{wheels}"
    return f"update the NVIDIA driver, which runs no more than CUDA {driver[0]}.{driver[1]}"
