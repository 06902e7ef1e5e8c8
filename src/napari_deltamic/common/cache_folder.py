"""Where what is costly to make is kept between runs."""

from __future__ import annotations

import os
import sys
from pathlib import Path

CACHE_VARIABLE = "DELTAMIC_CACHE"


def cache_folder() -> Path:
    """That of the system for caches; the environment variable DELTAMIC_CACHE names another."""
    folder = os.environ.get(CACHE_VARIABLE)
    if folder:
        return Path(folder)
    home = os.path.expanduser("~")  # unlike Path.home it never fails
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or os.path.join(home, "AppData", "Local")
    elif sys.platform == "darwin":
        base = os.path.join(home, "Library", "Caches")
    else:
        base = os.environ.get("XDG_CACHE_HOME") or os.path.join(home, ".cache")
    return Path(base) / "napari-deltamic"
