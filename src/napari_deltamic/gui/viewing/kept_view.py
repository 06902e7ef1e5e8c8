"""The same slice and the same picture, whatever happens to the scale of a layer."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..plain import camera_of


def rescale(viewer: Any, layer: Any, scale: ArrayLike) -> None:
    """Give a layer another scale; its slice, and what of it fills the canvas, stay as they are."""
    old, new = np.array(layer.scale, float), np.array(scale, float)
    dims, camera = viewer.dims, camera_of(viewer)
    if dims.ndim < layer.ndim or layer not in viewer.layers:
        layer.scale = new
        return
    first = dims.ndim - layer.ndim  # axis of the viewer that is the layer's first
    ratio, fixed = np.ones(dims.ndim), np.zeros(dims.ndim)
    ratio[first:], fixed[first:] = new / old, layer.translate
    point = fixed + (np.array(dims.point, float) - fixed) * ratio
    shown = list(dims.displayed)
    center, zoom = np.array(camera.center, float), float(camera.zoom)
    at = slice(len(center) - len(shown), None)
    center[at] = fixed[shown] + (center[at] - fixed[shown]) * ratio[shown]
    layer.scale = new
    dims.set_point(range(dims.ndim), point.tolist())
    camera.center = tuple(center.tolist())
    # Lengths may change differently along the axes: the middle of what each asks for.
    camera.zoom = zoom / float(np.exp(np.log(np.abs(ratio[shown])).mean()))
