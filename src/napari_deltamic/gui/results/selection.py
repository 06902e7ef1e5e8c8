"""Which cell lies under the mouse: clicks in the viewer choose cells."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ...geometry.mesh import OUTSIDE
from ...measure import section
from ..viewing.contours import sliced_axis
from ..viewing.frame import FloatArray
from ..viewing.viewer_link import ViewerLink

_NEAR = 6.0  # px: how far from its contour a click may be
_STILL = 3.0  # px: a mouse that moves further drags


class ClickSelection:
    """Tells which cell was clicked on, until it is closed.

    Parameters
    ----------
    viewer : a napari viewer or its model.
    link : gives what shows the meshes at present, or None.
    on_click : called with the region (0 beside all cells) and whether it is to be added to those
        chosen already (Ctrl or Shift).
    """

    def __init__(
        self,
        viewer: Any,
        link: Callable[[], ViewerLink | None],
        on_click: Callable[[int, bool], None],
    ) -> None:
        self._viewer, self._link = viewer, link
        self._on_click: Callable[[int, bool], None] | None = on_click
        self._callback = self._pressed  # one object, so that it can be taken out again
        viewer.mouse_drag_callbacks.append(self._callback)

    def close_links(self) -> None:
        """Listen to the viewer no more."""
        if self._callback in self._viewer.mouse_drag_callbacks:
            self._viewer.mouse_drag_callbacks.remove(self._callback)
        self._on_click = None

    def _pressed(self, viewer: Any, event: Any) -> Iterator[None]:
        link = self._link()
        if event.button != 1 or event.handled or not _for_us(viewer):
            return  # a tool of ours, or of the layer, is in use
        if link is None or link.shown is None:
            return
        start = np.asarray(event.pos, float)
        adding = any(key in event.modifiers for key in ("Control", "Shift"))
        yield
        while event.type == "mouse_move":
            if np.abs(np.asarray(event.pos, float) - start).max() > _STILL:
                return  # the view is moved
            yield
        if self._on_click is not None:
            self._on_click(region_at(link, event), adding)


def region_at(link: ViewerLink, event: Any) -> int:
    """The region at an event of the mouse in the viewer that a link shows a mesh in; 0 if none."""
    mesh, dims = link.shown, link.viewer.dims
    if mesh is None or not link.at_time:
        return OUTSIDE
    if dims.ndisplay == 3:
        if link.surface is None or not link.surface.visible:
            return OUTSIDE
        _, face = link.surface.get_value(
            event.position,
            view_direction=event.view_direction,
            dims_displayed=list(event.dims_displayed),
            world=True,
        ) or (None, None)
        face = None if face is None else link.face_of(int(face))
        if face is None or face >= len(mesh.faces):
            return OUTSIDE
        # The frame has axes along those of the world, if of another length.
        direction = np.asarray(event.view_direction, float)[-3:] * link.frame.um
        return _behind(mesh, face, direction)
    axis = sliced_axis(dims)
    if axis is None:
        return OUTSIDE
    um = link.frame.to_um(np.asarray(event.position, float)[-3:])
    scene = getattr(link.viewer, "scene", link.viewer)  # before napari 0.9, the viewer itself
    drawn = max(unit for k, unit in enumerate(link.frame.um) if k != axis)
    near = drawn * _NEAR / max(float(scene.camera.zoom), 1e-9)
    return region_in_slice(mesh, axis, um, near)


def region_in_slice(mesh: Mesh, axis: int, point: FloatArray, near: float) -> int:
    """The region around a point (3,) um in the slice across an axis, or with a contour near it.

    Where regions lie within one another, that with the nearest contour. 0 if there is none.
    """
    segments, faces = section(mesh, axis, float(point[axis]))
    if not len(segments):
        return OUTSIDE
    here = np.delete(point, axis)
    distance = _distances(segments, here)
    sides = mesh.regions[faces]
    found = []
    for region in np.unique(sides[sides != OUTSIDE]).tolist():
        own = (sides == region).any(axis=1)
        nearest = float(distance[own].min())
        inside = _crossings(segments[own], here) % 2 == 1
        if inside or nearest <= near:
            found.append((not inside, nearest, region))
    return int(min(found)[2]) if found else OUTSIDE


def _behind(mesh: Mesh, face: int, direction: FloatArray) -> int:
    """The region that lies behind a face, seen along a direction; in front, where none is."""
    first, second = mesh.regions[face].tolist()
    towards = float(mesh.normals()[face] @ direction) < 0
    behind, front = (first, second) if towards else (second, first)
    return int(behind or front)


def _distances(segments: FloatArray, point: FloatArray) -> FloatArray:
    """(S,) from a point (2,) to segments (S, 2, 2)."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    length = np.maximum((along**2).sum(axis=1), 1e-300)
    share = np.clip(((point - start) * along).sum(axis=1) / length, 0, 1)
    distance: FloatArray = np.linalg.norm(start + share[:, None] * along - point, axis=1)
    return distance


def _crossings(segments: NDArray[np.float64], point: FloatArray) -> int:
    """How many segments a ray from a point along the last axis crosses; odd: it lies inside."""
    (y, x), (a, b) = point, (segments[:, 0], segments[:, 1])
    cut = (a[:, 0] > y) != (b[:, 0] > y)
    a, b = a[cut], b[cut]
    at = a[:, 1] + (y - a[:, 0]) / (b[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    return int((at > x).sum())


def _for_us(viewer: Any) -> bool:
    """Whether a click means nothing to the layer that is active: it would place or move things."""
    active = viewer.layers.selection.active
    mode = str(getattr(active, "mode", "pan_zoom")) if active is not None else "pan_zoom"
    return mode == "pan_zoom"
