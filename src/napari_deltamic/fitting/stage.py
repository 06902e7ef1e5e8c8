"""Where in its schedule a fit is."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

from ..optics import Optics
from .objective.convergence import Remaining
from .objective.schedule import Progress

_COUNTS = ("iteration", "evaluations", "level_number", "changed_at", "begun_at")


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
    begun_at
        The iteration before the first one with this kind of PSF: so it does then.
    tried
        What explained less than this: 1, a tilted PSF; 2, also that of an objective; 3, also one
        with long tails; 4, also a local background.
    """

    level_number: int
    blurred_for: Optics
    progress: Progress = field(default_factory=Progress)
    remaining: Remaining = field(default_factory=lambda: Remaining(0.0, 0.0, 0))
    iteration: int = 0
    evaluations: int = 0
    changed_at: int = 0
    begun_at: int = 0
    tried: int = 0

    @property
    def edited(self) -> bool:
        """Whether anything has been changed from outside."""
        return self.changed_at > 0

    @property
    def since_changed(self) -> int:
        """Iterations since the patience last started."""
        return self.iteration - max(self.changed_at, self.begun_at)

    def spent(self, evaluations: int) -> Stage:
        """After so many evaluations more."""
        return replace(self, evaluations=self.evaluations + evaluations)

    def begun_anew(self, blurred_for: Optics) -> Stage:
        """The first level again; counts go on."""
        return Stage(
            0,
            blurred_for,
            iteration=self.iteration,
            evaluations=self.evaluations,
            begun_at=self.iteration,
        )

    def after(self, other: Stage, tried: int) -> Stage:
        """Where this was, after a fit with another model; counts go on.

        tried : see :attr:`tried`.
        """
        return replace(
            self,
            iteration=other.iteration,
            evaluations=other.evaluations,
            begun_at=other.iteration,
            tried=tried,
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values, but for the PSF."""
        counts = {name: getattr(self, name) for name in _COUNTS}
        return {**counts, "tried": self.tried, "progress": asdict(self.progress)}

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
            changed_at=int(values["changed_at"]),
            begun_at=int(values["begun_at"]),
            tried=int(values["tried"]),
        )
