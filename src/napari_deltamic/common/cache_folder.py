"""Where what is costly to make is kept between runs."""

from __future__ import annotations

import os
from pathlib import Path

from platformdirs import user_cache_path

CACHE_VARIABLE = "DELTAMIC_CACHE"


def cache_folder() -> Path:
    """That of the system for caches; the environment variable DELTAMIC_CACHE names another."""
    folder = os.environ.get(CACHE_VARIABLE)
    return Path(folder) if folder else user_cache_path("napari-deltamic", appauthor=False)
