"""Connections to events of a viewer that are undone together."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class Connections:
    """Remembers what was connected to events of a viewer, so that nothing stays connected."""

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
