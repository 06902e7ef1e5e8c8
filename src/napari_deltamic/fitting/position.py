"""Where a fit is, and what it works with wherever it is."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from ..runs.settings import FitSettings
from .model.fitted import Fitted
from .model.problem import Problem
from .model.shape import Shape
from .model_choice import ModelChoice
from .objective.schedule import Progress, Schedule
from .reporting import Reporter
from .solvers.preconditioner import Preconditioners
from .stage import Stage
from .surface.surface_upkeep import SurfaceUpkeep


@dataclass(frozen=True)
class Position:
    """Where a fit is.

    Attributes
    ----------
    fitted
        Surface, PSF and effects.
    stage
        Where in the schedule that is.
    settings
        With levels and accuracy.
    """

    fitted: Fitted
    stage: Stage
    settings: FitSettings

    @property
    def levels(self) -> tuple[float, ...]:
        """Widths of the blur of each, in widths of the PSF."""
        return self.settings.levels or ()

    @property
    def choice(self) -> ModelChoice:
        """The choice of structure and densities here."""
        return ModelChoice(self.settings, len(self.levels))

    @property
    def last(self) -> bool:
        """Whether no level follows."""
        return self.choice.last(self.stage)

    @property
    def over(self) -> bool:
        """Whether the iterations are used up."""
        return self.stage.since_changed >= self.settings.max_iterations

    @property
    def tolerance(self) -> float:
        """um."""
        return self.settings.tolerance * min(self.fitted.optics.sigma_um)

    def holding(self, fitted: Fitted) -> Position:
        """The same position with this fit."""
        return replace(self, fitted=fitted)

    def spent(self, evaluations: int) -> Position:
        """After so many evaluations more."""
        return replace(self, stage=self.stage.spent(evaluations))

    def counted(self) -> Position:
        """After one iteration more."""
        return replace(self, stage=replace(self.stage, iteration=self.stage.iteration + 1))

    def progressed(self, progress: Progress) -> Position:
        """So far within the level."""
        return replace(self, stage=replace(self.stage, progress=progress))


@dataclass(frozen=True, eq=False)
class RunContext:
    """What all levels of a run share.

    Attributes
    ----------
    problem
        What is to be explained.
    upkeep, reporter
        What keeps the surface sound, and what tells of it.
    begun
        Where the run began.
    schedule, factored
        When levels end; factors of the metric that are there already.
    """

    problem: Problem
    upkeep: SurfaceUpkeep
    reporter: Reporter
    begun: Shape
    schedule: Schedule = field(default_factory=Schedule)
    factored: Preconditioners = field(default_factory=Preconditioners)
