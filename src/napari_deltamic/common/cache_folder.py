"""Where results that are costly to compute are kept between runs."""

from __future__ import annotations

import os
from pathlib import Path

from platformdirs import user_cache_path

CACHE_VARIABLE = "DELTAMIC_CACHE"


def cache_folder() -> Path:
    """The folder that DELTAMIC_CACHE names, else the user's cache folder of this system."""
    folder = os.environ.get(CACHE_VARIABLE)
    return Path(folder) if folder else user_cache_path("napari-deltamic", appauthor=False)
