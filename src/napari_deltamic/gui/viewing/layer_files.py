"""The files that layers were opened from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...common.choices import IMAGE_FILES
from ...images.stacks import stored_shape
from .frame import stack_of


def file_of(layer: Any) -> str:
    """The file that a 3D image layer was opened from, if an image of its shape is in it; else ''.

    The pixels may have been edited since: see :func:`.stacks.holds_image`.
    """
    path = layer.source.path
    if not path or layer.ndim != 3 or Path(path).suffix.lower() not in IMAGE_FILES:
        return ""
    if stored_shape(path) != stack_of(layer, ()).shape:
        return ""  # a crop, a channel, a time point
    return str(Path(path).absolute())
