"""Events between frames as session files and reports of tracking hold them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..tracking import Event
from ..tracking.result import EventKind


@dataclass(frozen=True, kw_only=True)
class EventFacts:
    """An event; which frame it belongs to, the place where it stands says."""

    kind: EventKind
    cell: int
    daughters: tuple[int, ...]
    text: str

    @classmethod
    def of(cls, events: Iterable[Event]) -> tuple[EventFacts, ...]:
        """Those of a frame."""
        return tuple(
            cls(kind=e.kind, cell=e.cell, daughters=e.daughters, text=e.text) for e in events
        )

    def event(self, frame: int) -> Event:
        """It again."""
        return Event(self.kind, frame, self.cell, self.text, self.daughters)
