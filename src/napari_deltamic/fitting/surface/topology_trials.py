"""Changes of topology in a fit: made as the policy says, undone as the image says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ...errors import listed
from ...geometry.topology.rearranging import give_way
from ...geometry.topology.thin_places import ThinPlace
from ...runs.settings import FitSettings
from ..model.density import evener
from ..model.fitted import Fitted
from ..model.problem import Problem
from .local_misfit import Misfit, gaps, misfit_of
from .topology import RULES, TopologyPolicy, Trial, may_change

_TOLD = 3  # places in a sentence, chosen: more would fill lines that nobody reads


class TopologyTrials:
    """The change that is to be judged, and the policy that proposes others.

    Each method takes what is fitted and gives what the fit goes on with: the same object where
    nothing was changed.

    Attributes
    ----------
    policy
        Where the topology may change.
    trial
        What is to be judged; None where nothing is.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self.go_on_with(TopologyPolicy())

    def go_on_with(self, policy: TopologyPolicy) -> None:
        """Another fit was here before: what it tried is not tried again."""
        self.policy = policy
        self.trial: Trial | None = None
        self._events: tuple[str, ...] = ()

    @property
    def trying(self) -> bool:
        """Whether a change is still to be judged."""
        return self.trial is not None

    def events(self) -> tuple[str, ...]:
        """What has happened since this was last asked, a sentence each."""
        events, self._events = self._events, ()
        return events

    def forget_trial(self) -> None:
        """The image is explained in another way: no change is to be judged by it."""
        self.trial = None

    def restart(self) -> None:
        """Another surface: whatever was tried may be tried again."""
        self.trial, self.policy = None, self.policy.restarted()

    def look(self, fitted: Fitted, settings: FitSettings, factor: float, iteration: int) -> Fitted:
        """Judge a change that has had its time, and change what presses."""
        if not _may_change(fitted, settings, factor):
            return fitted
        if self._waits(iteration):
            return fitted
        fitted = self.judged(fitted, settings)
        self.policy, places = self.policy.pressing(fitted.shape)
        return self._changed(fitted, settings, places, iteration, tried=False) if places else fitted

    def end_level(self, fitted: Fitted, settings: FitSettings, iteration: int) -> Fitted:
        """Judge a change that has had its time; another goes on at the level that follows."""
        self.policy = self.policy.restarted()
        return fitted if self._waits(iteration) else self.judged(fitted, settings)

    def _waits(self, iteration: int) -> bool:
        """Whether a change has not had its time."""
        trial = self.trial
        return trial is not None and iteration - trial.iteration < RULES.patience_for(trial)

    def tried(self, fitted: Fitted, settings: FitSettings, factor: float, iteration: int) -> Fitted:
        """Change what only a trial can tell."""
        if not (settings.trials and _may_change(fitted, settings, factor)):
            return fitted
        width = max(fitted.optics.sigma_um)
        self.policy = self.policy.unlimited()
        candidates = self.policy.candidates(fitted.shape, width)
        while places := self.policy.worth_a_trial(candidates, fitted.shape, width):
            known = len(self.policy.futile), self.policy.most
            found = self._changed(fitted, settings, places, iteration, tried=True)
            if found is not fitted:
                return found
            if known == (len(self.policy.futile), self.policy.most):
                break  # nothing was learnt from it
        return fitted

    def too_soon(self, iteration: int) -> bool:
        """Whether rest that comes now is of the places that have not changed."""
        return self.trial is not None and iteration - self.trial.iteration < RULES.patience

    def judged(self, fitted: Fitted, settings: FitSettings) -> Fitted:
        """Undo the last change where the image speaks against it."""
        trial, self.trial = self.trial, None
        if trial is None:
            return fitted
        optics = fitted.optics
        points = [place.points for place in trial.places]
        after = self._misfit(fitted, settings, trial.misfit)
        reach = RULES.beyond * max(optics.sigma_um)
        found = gaps(self._problem, trial.misfit, after, points, reach, optics)
        if trial.tried:  # what pressed is judged before its densities have settled
            one, other = ((s.mesh, s.log_density) for s in (trial.before.shape, fitted.shape))
            even = evener(
                fitted.shape.model,
                one,
                other,
                min(optics.sigma_um),
                points,
                reach,
                trial.misfit.independent,
            )
            found = [replace(gap, nats=gap.nats + n) for gap, n in zip(found, even, strict=True)]
        self.policy, judged = self.policy.judged(trial, found)
        self._events += _undecided(judged.undecided)
        if not judged.undone:
            self._events += trial.events if trial.tried else ()
            return fitted
        # As a whole: what shone, and the PSF, have gone along with what was wrong.
        before = trial.before.shape
        restored = trial.before.retriangulated(before)
        if judged.kept:
            made = give_way(before.mesh, judged.kept, before.mesh.median_edge())
            if made.mesh is not before.mesh:
                self._events += made.events if trial.tried else ()
                return restored.retriangulated(before.retriangulated(made.mesh, made.origin))
        elif not trial.tried:
            self._events += ("undone: the image contradicts it",)
        return restored

    def _changed(
        self,
        fitted: Fitted,
        settings: FitSettings,
        places: list[ThinPlace],
        iteration: int,
        tried: bool,
    ) -> Fitted:
        before = fitted.shape
        made = give_way(before.mesh, places, before.mesh.median_edge())
        if made.mesh is before.mesh:
            self.policy = self.policy.refused(places, made.hopeless, tried)
            return fitted
        places = [p for p in places if p not in made.hopeless]
        misfit = self._misfit(fitted, settings)
        self.policy = self.policy.changed(places, tried)
        self.trial = Trial(fitted, misfit, tuple(places), made.events, iteration, tried)
        self._events += () if tried else made.events
        return fitted.retriangulated(before.retriangulated(made.mesh, made.origin))

    def _misfit(self, fitted: Fitted, settings: FitSettings, like: Misfit | None = None) -> Misfit:
        faces = fitted.shape.face_densities()
        return misfit_of(
            self._problem,
            fitted.mesh,
            faces,
            fitted.optics,
            fitted.effects,
            settings.image_accuracy,
            like,
            fitted.light,
        )


def _may_change(fitted: Fitted, settings: FitSettings, factor: float) -> bool:
    asked = settings.topology and settings.collisions
    return asked and factor <= RULES.sharp and may_change(fitted.mesh)


def _undecided(places: Sequence[ThinPlace]) -> tuple[str, ...]:
    """One sentence that names the first places, if there are any."""
    told = []
    for place in places[:_TOLD]:
        cells = [r for r in sorted({*place.regions, *place.sides}) if r]
        meet = "meet" if len(cells) > 1 else "meets itself"
        z, y, x = place.points.mean(0)
        told.append(f"how {listed('cell', cells)} {meet} at ({z:.1f}, {y:.1f}, {x:.1f}) um")
    more = f", and {len(places) - _TOLD} more" if len(places) > _TOLD else ""
    return (f"undecided: {', '.join(told)}{more}",) if told else ()
