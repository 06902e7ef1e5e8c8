"""Where in its schedule a fit is."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from ..optics import Optics
from .convergence import Remaining
from .schedule import Progress

_COUNTS = ("iteration", "evaluations", "level_number", "changed_at")


@dataclass(frozen=True)
class Stage:
    """Where in its schedule a fit is.

    Attributes
    ----------
    level_number
        Of the level, from 0 on.
    blurred_for
        The PSF whose blur the level has.
    progress
        Within the level.
    remaining
        What was still to come when this was last looked at.
    iteration, evaluations
        Of the fit.
    changed_at
        The iteration of the last change from outside: the patience starts anew.
    """

    level_number: int
    blurred_for: Optics
    progress: Progress = field(default_factory=Progress)
    remaining: Remaining = field(default_factory=lambda: Remaining(0.0, 0.0, 0))
    iteration: int = 0
    evaluations: int = 0
    changed_at: int = 0

    def to_dict(self) -> dict[str, Any]:
        """Plain values, but for the PSF."""
        counts = {name: getattr(self, name) for name in _COUNTS}
        return {**counts, "progress": asdict(self.progress)}

    @classmethod
    def from_dict(cls, values: dict[str, Any], blurred_for: Optics) -> Stage:
        """What :meth:`to_dict` gave."""
        held = values["progress"]
        progress = Progress(**{**held, "values": tuple(held["values"])})
        return cls(
            int(values["level_number"]),
            blurred_for,
            progress,
            iteration=int(values["iteration"]),
            evaluations=int(values["evaluations"]),
            changed_at=int(values.get("changed_at", 0)),  # earlier versions kept none
        )
