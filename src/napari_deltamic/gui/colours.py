"""One colour for each region, the same in the viewer, the table and the pictures of a report."""

from __future__ import annotations

from typing import Any

import numpy as np
from napari.utils import Colormap
from numpy.typing import NDArray

from ..geometry import Mesh
from ..picture import COLOURS

_TABLE = np.column_stack([np.array(COLOURS) / 255, np.ones(len(COLOURS))])
LIMITS = (0.0, float(len(COLOURS)))


def region_colours(regions: Any) -> NDArray[np.float64]:
    """(n, 4) RGBA for region numbers from 1, or (4,) for one."""
    colours: NDArray[np.float64] = _TABLE[(np.asarray(regions) - 1) % len(_TABLE)]
    return colours


def region_colormap() -> Colormap:
    """A colormap that, over ``LIMITS``, gives ``vertex_values`` the colours of their regions."""
    controls = np.linspace(0, 1, len(_TABLE) + 1)
    return Colormap(_TABLE, name="deltamic regions", controls=controls, interpolation="zero")


def vertex_values(mesh: Mesh) -> NDArray[np.float32]:
    """(V,) a value for each vertex; where several regions meet, that of the largest number."""
    largest = np.ones(len(mesh.vertices), np.int64)
    np.maximum.at(largest, mesh.faces.ravel(), np.repeat(mesh.regions.max(axis=1), 3))
    return ((largest - 1) % len(_TABLE) + 0.5).astype(np.float32)
