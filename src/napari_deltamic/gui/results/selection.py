"""Which cell lies under the mouse: clicks in the viewer choose cells."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ...geometry.mesh import OUTSIDE
from ...measure.picking import region_behind, region_in_slice
from ..viewing.contours import sliced_axis
from ..viewing.frame import camera_of
from ..viewing.listening import Presses, is_click, wants_clicks
from ..viewing.viewer_link import ViewerLink

_NEAR = 6.0  # px: how far from its contour a click may be


class ClickSelection:
    """Tells which cell was clicked on, until it is closed.

    Parameters
    ----------
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
        self._link = link
        self._on_click: Callable[[int, bool], None] | None = on_click
        self.presses = Presses(viewer, self._pressed)
        self.presses.listen()

    def close_links(self) -> None:
        self.presses.listen(False)
        self._on_click = None

    def _pressed(self, viewer: Any, event: Any) -> Iterator[None]:
        link = self._link()
        if event.button != 1 or event.handled or wants_clicks(viewer.layers.selection.active):
            return  # a tool of ours, or of the layer, is in use
        if link is None or link.shown is None:
            return
        adding = any(key in event.modifiers for key in ("Control", "Shift"))
        if (yield from is_click(event)) and self._on_click is not None:
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
        return region_behind(mesh, face, direction)
    axis = sliced_axis(dims)
    if axis is None:
        return OUTSIDE
    um = link.frame.to_um(np.asarray(event.position, float)[-3:])
    drawn = max(unit for k, unit in enumerate(link.frame.um) if k != axis)
    near = drawn * _NEAR / max(float(camera_of(link.viewer).zoom), 1e-9)
    return region_in_slice(mesh, axis, um, near)
