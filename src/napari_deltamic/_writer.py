"""Surface layers as mesh files."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pint
from napari.utils.notifications import show_warning

from .errors import InputError
from .geometry import Mesh, save_mesh
from .gui.viewing.frame import ORIGIN, OWN
from .gui.viewing.walls import joined


def write_surface(path: str, data: Any, attributes: dict[str, Any]) -> list[str]:
    """Write a Surface layer as a mesh file, um; the suffix says which.

    The layer's scale counts, and its translation. Files of the layers of a fit, and of those that
    were read from a mesh file, have the centre of the image's first voxel at 0.

    Raises
    ------
    InputError
        If the layer holds no 3D surface, or the file cannot be written.
    """
    vertices, faces = np.asarray(data[0], float), np.asarray(data[1])
    if vertices.ndim != 2 or vertices.shape[1] < 3 or not len(faces):
        raise InputError("the layer holds no 3D surface")
    if vertices.shape[1] > 3 and len(np.unique(vertices[:, :-3], axis=0)) > 1:
        raise InputError(
            "the layer holds surfaces of several times; 'Save all frames' saves tracked cells"
        )
    vertices, faces = joined(vertices, faces, attributes.get("metadata", {}))
    um = np.array([_um(unit) for unit in attributes.get("units", ("um",) * 3)[-3:]])
    own = attributes.get("metadata", {}).get(OWN, {})
    world = vertices[:, -3:] * np.asarray(attributes.get("scale", (1, 1, 1)), float)[-3:]
    if not own.get("fit"):
        world = world + np.asarray(attributes.get("translate", (0, 0, 0)), float)[-3:]
        world = world - np.asarray(own.get(ORIGIN) or (0, 0, 0), float)
    regions = own.get("regions")
    if regions is not None and len(regions) != len(faces):
        regions = None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        save_mesh(Mesh(world * um, faces, regions), path)
    for warning in caught:
        show_warning(str(warning.message))
    return [path]


def _um(unit: Any) -> float:
    """um in a unit; one in what is no length (pixels)."""
    try:
        return float(pint.get_application_registry().Quantity(1, unit).to("um").magnitude)
    except (pint.DimensionalityError, pint.UndefinedUnitError):
        return 1.0
