"""Connections to the viewer's events that are undone together."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class Connections:
    """Remembers what was connected, so that nothing stays connected."""

    def __init__(self) -> None:
        self._made: list[tuple[Any, Callable[..., None]]] = []

    def connect(self, emitter: Any, slot: Callable[..., None]) -> None:
        """Connect a slot to an emitter of events."""
        emitter.connect(slot)
        self._made.append((emitter, slot))

    def undo(self) -> None:
        """Undo every connection."""
        for emitter, slot in self._made:
            emitter.disconnect(slot)
        self._made.clear()
