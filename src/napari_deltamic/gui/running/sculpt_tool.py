"""Tools that change the surface with the mouse: nudge, push, pin."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtWidgets import QLabel, QWidget
from superqt.utils import signals_blocked

from ...geometry import Mesh
from ...geometry.brush import Touch, falloff, outward, touched_by_ray, touched_on_section
from ...geometry.carry import carried
from ...measure import section
from ..document import Document
from ..viewing.contours import sliced_axis
from ..viewing.frame import FloatArray
from ..viewing.listening import Presses, lay_down
from ..viewing.viewer_link import ViewerLink
from ..widgets import ToolBar, button, row, slider
from .edits import Edits

_TIPS = {
    "nudge": "Drag a part of the surface, in the plane of the slice or of the view.",
    "push": "Drag over the surface to push it outward; with Shift, inward.",
    "pin": "Drag over the surface: the fit leaves it where it is; with Shift, frees it again.",
}
_EARLIER = "This is an earlier moment: press 'Back to the end', or continue from here."
_HIDDEN = "The surface is hidden: make its layer visible first."
_OTHER_TIME = "The surface is that of another time point: go there first."
_PUSH = 0.12  # of the brush's radius: how far a dab pushes
_SPACING = 0.3  # of the radius: how far the mouse goes from one dab to the next
_PINNED = 0.25  # weight from which on a vertex is pinned


class EditBar(ToolBar):
    """Tools that change the surface by hand, and the size of the brush, while one is in use.

    What misses the surface moves the view.
    """

    def __init__(self, doc: Document, control: Any, edits: Edits, parent: QWidget) -> None:
        tools = {tool: (tool.capitalize(), tip) for tool, tip in _TIPS.items()}
        super().__init__(tools, _start, doc, parent)
        self._control, self._edits = control, edits
        free_all = partial(doc.guarded, edits.free_all)
        self.pins = button("", "Free all pinned vertices.", free_all, self)
        self.radius = slider("Radius of the brush; the effect fades towards its rim.", self)
        self.unit, self.brush = QLabel(self), QWidget(self)
        row(self.unit, (self.radius, 1), of=self.brush)
        self.row.insertWidget(0, QLabel("edit", self))
        self.column.insertWidget(1, self.brush)
        self.column.addWidget(self.pins)
        self.brush.hide()
        self.presses = Presses(doc.viewer, self._pressed)
        self.tool_chosen.connect(self._tool_chosen)
        doc.began.connect(self._began)
        edits.changed.connect(self._show_pins)
        doc.at_end(partial(self.presses.listen, False))
        self._show_pins()

    def explain(self) -> None:
        """Show what the tool in use does, and the size of its brush."""
        super().explain()
        link = self._doc.link
        self.unit.setText(f"radius, {'µm' if link is None else link.frame.length}")
        self.brush.setVisible(self.tool is not None)

    def _tool_chosen(self, tool: str | None) -> None:
        self.presses.listen(tool is not None, first=True)  # others only look at a click
        if tool is not None:
            # Points that are placed, or labels that are painted, would be in the way.
            self._doc.finish_placing.emit(False)
            lay_down(self._doc.viewer.layers.selection.active)

    def _began(self, fresh: bool) -> None:
        present = self._doc.present()
        if fresh and present is not None:
            low, high = present.state.mesh.bounds()
            size = float((high - low).max())
            with signals_blocked(self.radius):  # a brush that suits the mesh
                self.radius.setRange(size / 100, size / 2)
                self.radius.setValue(size / 8)

    def _show_pins(self) -> None:
        pinned, link = self._edits.pinned, self._doc.link
        n = 0 if pinned is None else int(pinned.sum())
        self.pins.setText(f"Free {n} pinned {'vertex' if n == 1 else 'vertices'}")
        self.pins.setVisible(n > 0)
        if link is not None:
            # The fit may be ahead of what is shown, with other triangles.
            mesh = link.mesh
            link.show_pins(None if mesh is None else self._edits.pinned_on(mesh))

    # ------------------------------------------------------------------------------------ mouse

    def _pressed(self, viewer: Any, event: Any) -> Iterator[None]:
        tool, link = self.tool, self._doc.link
        if event.button != 1 or tool is None:
            return
        if self._doc.moment is not None:
            self.hint.say(_EARLIER)
            return
        if link is None or link.shown is None or self._doc.present() is None:
            self.hint.say("There is no surface yet: run a fit first.")
            return
        if not _to_be_seen(link):
            self.hint.say(_HIDDEN if link.at_time else _OTHER_TIME)
            return
        radius = float(self.radius.value())
        touch = touch_at(link, link.shown, event, radius)
        if touch is None:
            return  # the view is moved
        event.handled = True  # the view stays where it is
        stroke = _Stroke(tool, link, link.shown, touch, event, radius)
        self._show(link, stroke)
        yield
        while event.type == "mouse_move":
            event.handled = True
            if stroke.move(event):
                self._show(link, stroke)
            yield
        event.handled = True
        self._finish(stroke)

    def _show(self, link: ViewerLink, stroke: _Stroke) -> None:
        if stroke.tool == "pin":
            before, shown = self._edits.pinned_on(stroke.start), link.shown
            if before is not None and shown is not None:
                after = before & ~stroke.which if stroke.turned else before | stroke.which
                link.show_pins(carried(after, stroke.start, shown))
        else:
            self._control.hold(stroke.mesh)

    def _finish(self, stroke: _Stroke) -> None:
        if stroke.tool == "pin":
            pins = stroke.which, not stroke.turned, stroke.start
            self._doc.guarded(partial(self._edits.pin, *pins))
            self._show_pins()
        else:
            if stroke.shift.any():
                moved = stroke.shift, stroke.tool, stroke.start
                self._doc.guarded(partial(self._edits.shift, *moved))
            self._control.let_go()


def _start(tool: str, ndisplay: int) -> str:
    place = "on a surface" if ndisplay == 3 else "near a contour"
    return f"Start {place}; elsewhere the mouse moves the view."


class _Stroke:
    """One stroke, from the press of the mouse to its release, and what it does to a mesh."""

    def __init__(
        self, tool: str, link: ViewerLink, mesh: Mesh, touch: Touch, event: Any, radius: float
    ) -> None:
        self.tool, self._link, self.start, self._radius = tool, link, mesh, radius
        self._ndisplay = link.viewer.dims.ndisplay
        self.turned = "Shift" in event.modifiers
        self.shift: NDArray[np.float64] = np.zeros((len(mesh.vertices), 3))
        self.which: NDArray[np.bool_] = np.zeros(len(mesh.vertices), bool)
        self._touch = touch
        self._weights = falloff(mesh, touch, radius)
        self._grip = _in_plane(link, event, touch.point)
        if tool != "nudge":
            self._dab(touch)

    @property
    def mesh(self) -> Mesh:
        """The mesh with the shift so far."""
        return self.start.with_vertices(self.start.vertices_numpy() + self.shift)

    def move(self, event: Any) -> bool:
        """Follow the mouse; returns whether that changed something."""
        if self._link.viewer.dims.ndisplay != self._ndisplay:
            return False  # another view: the mouse is somewhere else now
        if self.tool == "nudge":
            there = _in_plane(self._link, event, self._touch.point)
            self.shift = self._weights[:, None] * (there - self._grip)
            return True
        touch = touch_at(self._link, self.mesh, event, self._radius)
        if touch is None:
            return False
        if np.linalg.norm(touch.point - self._touch.point) < _SPACING * self._radius:
            return False
        self._touch = touch
        self._dab(touch)
        return True

    def _dab(self, touch: Touch) -> None:
        mesh = self.mesh
        weights = falloff(mesh, touch, self._radius)
        if self.tool == "pin":
            self.which |= weights > _PINNED
            return
        size = _PUSH * self._radius * (-1 if self.turned else 1)
        self.shift = self.shift + size * weights[:, None] * outward(mesh, touch.face)


def touch_at(link: ViewerLink, mesh: Mesh, event: Any, reach: float) -> Touch | None:
    """Where a mouse event touches a mesh that a link shows; in 2D, within a reach (um)."""
    place, dims = link.frame.place_of(event), link.viewer.dims
    if dims.ndisplay == 3:
        return touched_by_ray(mesh, place, link.frame.direction_of(event))
    axis = sliced_axis(dims)
    if axis is None:
        return None
    place[axis] = link.contours.position(dims, axis)
    segments, faces = section(mesh, axis, float(place[axis]))
    return touched_on_section(segments, faces, axis, place, reach)


def _in_plane(link: ViewerLink, event: Any, point: FloatArray) -> FloatArray:
    """Where the mouse points, um, in the plane of the view through a point, or in the slice."""
    place = link.frame.place_of(event)
    if link.viewer.dims.ndisplay == 3:
        along = link.frame.direction_of(event)
        along = along / np.linalg.norm(along)
        return place + along * float((point - place) @ along)
    axis = sliced_axis(link.viewer.dims)
    if axis is not None:
        place[axis] = point[axis]
    return place


def _to_be_seen(link: ViewerLink) -> bool:
    layer = link.surface if link.viewer.dims.ndisplay == 3 else link.contours.layer
    there = layer is not None and layer in link.viewer.layers and bool(layer.visible)
    return there and link.at_time
