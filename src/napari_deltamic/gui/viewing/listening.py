"""Listening to a viewer and its mouse, and stopping again; what a click is, and who wants it."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Generator
from typing import Any

import numpy as np

_STILL = 5.0  # px: a mouse that moves further drags
_MOVES_THE_VIEW = "pan_zoom"


class Connections:
    """Remembers connections to events of a viewer, so that all can be undone."""

    def __init__(self) -> None:
        self._made: list[tuple[Any, Callable[..., None]]] = []

    def connect(self, emitter: Any, slot: Callable[..., None], **how: Any) -> None:
        """Connect a slot to an emitter of events; ``how`` is for the emitter."""
        emitter.connect(slot, **how)
        self._made.append((emitter, slot))

    def undo(self) -> None:
        for emitter, slot in self._made:
            emitter.disconnect(slot)
        self._made.clear()


def reference(data: Any) -> Callable[[], Any]:
    """A function that gives voxels, without keeping them alive if possible."""
    try:
        return weakref.ref(data)
    except TypeError:
        return lambda: data


class Presses:
    """Calls a generator for each press of the mouse, while it listens."""

    def __init__(self, viewer: Any, callback: Callable[[Any, Any], Any]) -> None:
        self._all, self.callback = viewer.mouse_drag_callbacks, callback

    def listen(self, on: bool = True, *, first: bool = False) -> None:
        """Start or stop listening; first : before all other callbacks."""
        if self.callback in self._all:
            self._all.remove(self.callback)
        if on:
            self._all.insert(0 if first else len(self._all), self.callback)


def is_click(event: Any) -> Generator[None, None, bool]:
    """Follow a press to its release; returns whether the mouse stayed in place."""
    start = np.asarray(event.pos, float)
    yield
    while event.type == "mouse_move":
        if np.abs(np.asarray(event.pos, float) - start).max() > _STILL:
            return False  # the view is moved
        yield
    return True


def wants_clicks(layer: Any) -> bool:
    """Whether a layer has a tool in use that places, paints or moves things; False for None."""
    return str(getattr(layer, "mode", _MOVES_THE_VIEW)) != _MOVES_THE_VIEW


def lay_down(layer: Any) -> None:
    """Let clicks into a layer move the view again."""
    if wants_clicks(layer):
        layer.mode = _MOVES_THE_VIEW
