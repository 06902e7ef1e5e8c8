"""Mesh files as Surface layers."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from napari.utils.notifications import show_warning

from .errors import RepairWarning
from .geometry import load_mesh
from .gui.colours import LIMITS, region_colormap, vertex_values
from .gui.frame import OWN

EXTENSIONS = (".ply", ".stl", ".rec", ".off", ".obj")
LayerData = tuple[Any, dict[str, Any], str]


def get_reader(path: str | Sequence[str]) -> Callable[..., list[LayerData]] | None:
    """The reader of a mesh file, or of several; None for other files."""
    paths = [path] if isinstance(path, str) else list(path)
    if paths and all(Path(p).suffix.lower() in EXTENSIONS for p in paths):
        return read_meshes
    return None


def read_meshes(path: str | Sequence[str]) -> list[LayerData]:
    """One Surface layer for each file, um, with a colour for each region.

    Raises
    ------
    InputError
        Naming the file and what is wrong with it.
    """
    paths = [path] if isinstance(path, str) else list(path)
    return [_read(p) for p in paths]


def _read(path: str) -> LayerData:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mesh = load_mesh(path)
    for warning in caught:
        if issubclass(warning.category, RepairWarning):
            show_warning(str(warning.message))
    vertices = mesh.vertices_numpy().astype(np.float32)
    options = {
        "name": Path(path).stem,
        "colormap": region_colormap(),
        "contrast_limits": LIMITS,
        "shading": "smooth",
        "units": ("um",) * 3,
        "metadata": {OWN: {"regions": mesh.regions}},
    }
    return (vertices, mesh.faces, vertex_values(mesh)), options, "surface"
