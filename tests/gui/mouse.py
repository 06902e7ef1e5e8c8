"""A mouse over a viewer without a canvas."""

from types import SimpleNamespace

import numpy as np
from napari.utils import interactions
from napari.utils._proxies import ReadOnlyWrapper


class Mouse:
    """Presses, drags and releases at places in um of a link's frame."""

    def __init__(self, viewer, link):
        self.viewer, self.link = viewer, link
        self._options = {}

    def drag(self, *places, shift=False, direction=(0.0, 0.0, 1.0)):
        """Press at the first place, move through the others, release; whether it was used."""
        handled = self.press(places[0], shift=shift, direction=direction)
        for place in places[1:]:
            self.move(place)
        self.release(places[-1])
        return handled

    def press(self, place, *, shift=False, direction=(0.0, 0.0, 1.0)):
        self._options = {
            "modifiers": ("Shift",) if shift else (),
            "view_direction": np.array(direction) if self.viewer.dims.ndisplay == 3 else None,
        }
        event = self._event("mouse_press", place)
        interactions.mouse_press_callbacks(self.viewer, event)
        return event.handled

    def move(self, place):
        interactions.mouse_move_callbacks(self.viewer, self._event("mouse_move", place))

    def release(self, place):
        interactions.mouse_release_callbacks(self.viewer, self._event("mouse_release", place))

    def _event(self, kind, place):
        event = SimpleNamespace(
            type=kind,
            button=1,
            pos=np.asarray(place)[:2] * 100,
            position=tuple(self.link.frame.to_world(place)),
            dims_displayed=list(self.viewer.dims.displayed),
            is_dragging=kind != "mouse_press",
            handled=False,
            **self._options,
        )
        return ReadOnlyWrapper(event, exceptions=("handled",))
