"""The mouse in a viewer: who listens to it, what is a click, and whether a layer wants it."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

import numpy as np

_STILL = 5.0  # px: a mouse that moves further drags
_MOVES_THE_VIEW = "pan_zoom"


class Presses:
    """Calls a generator for each press of the mouse, while it listens."""

    def __init__(self, viewer: Any, callback: Callable[[Any, Any], Any]) -> None:
        self._all, self.callback = viewer.mouse_drag_callbacks, callback

    def listen(self, on: bool = True, *, first: bool = False) -> None:
        """Listen, or do not; first: before all others."""
        if self.callback in self._all:
            self._all.remove(self.callback)
        if on:
            self._all.insert(0 if first else len(self._all), self.callback)


def is_click(event: Any) -> Generator[None, None, bool]:
    """Follows a press to its release; whether the mouse stayed where it was."""
    start = np.asarray(event.pos, float)
    yield
    while event.type == "mouse_move":
        if np.abs(np.asarray(event.pos, float) - start).max() > _STILL:
            return False  # the view is moved
        yield
    return True


def wants_clicks(layer: Any) -> bool:
    """Whether a layer, or None, has a tool in use: it would place, paint or move things."""
    return str(getattr(layer, "mode", _MOVES_THE_VIEW)) != _MOVES_THE_VIEW


def lay_down(layer: Any) -> None:
    """Let clicks into a layer move the view again."""
    if wants_clicks(layer):
        layer.mode = _MOVES_THE_VIEW
