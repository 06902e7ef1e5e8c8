"""A fit as a loop: levels, objectives, steps, and what may change between two steps."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace

import numpy as np

from ..geometry.mesh import Mesh
from ..optics import Optics
from ..runs.settings import WIDE_LEVELS, FitSettings
from ..scene.effects import Effects
from .change import Change, taken_over
from .checkpoint import Checkpoint
from .convergence import Remaining, strayed_off
from .fit_objective import Objective, Terms
from .fitted import Arrays, Fitted, fingerprint
from .level import Level
from .model_choice import ModelChoice
from .preconditioner import Preconditioners
from .prediction import View
from .problem import Problem
from .reporting import Reporter, verdict
from .schedule import Progress, Schedule
from .shape import Shape
from .stage import Stage
from .state import FitState
from .state_of import state_of
from .successor import is_given_up, successor
from .surface_upkeep import SurfaceUpkeep

_UNDONE = "a coarse level was undone: a cell had drifted away from its start"
_FURTHER_IN = "membranes shine as well: the fit goes on with surfaces further in"


class Run:
    """A fit between two iterations.

    Parameters
    ----------
    problem
        What is to be explained.
    mesh, optics, effects
        Where it starts.
    settings
        With levels and accuracy.
    stage
        Where counts go on from; None at the very start.
    former
        A run at its end, which goes on if it explains more than this one does at its own.

    Attributes
    ----------
    fitted, stage, objective
        What has been fitted, where in the schedule that is, and what the last step went down.
    """

    def __init__(
        self,
        problem: Problem,
        mesh: Mesh,
        optics: Optics,
        settings: FitSettings,
        effects: Effects,
        stage: Stage | None = None,
        former: Run | None = None,
    ) -> None:
        self._problem, self._schedule = problem, Schedule()
        self._levels = settings.levels or WIDE_LEVELS
        self._settings = settings.model_copy(update={"levels": self._levels})
        self._start = fingerprint(mesh)
        # Where many cells begin near their walls, those differ more than places within a wall do.
        several = len(self._levels) == 1 and len(mesh.region_ids()) > 1
        model = "interface" if several and settings.density == "smooth" else settings.density
        self.fitted = Fitted.begun(mesh, optics, effects, model, settings.structure)
        self.stage = stage or Stage(0, self.fitted.optics)
        self._former = former
        self._upkeep = SurfaceUpkeep(problem, mesh, min(optics.sigma_um), settings.collisions)
        self._reporter, self._factored = Reporter(mesh), Preconditioners()
        self.objective: Objective
        self._level: Level
        self._second: Level | None
        self._due = True  # whether the objective is to be posed anew
        self._kept: Arrays = {}
        self._begun = self.fitted.shape

    def say(self, *remarks: str) -> None:
        """Tell this with the next state."""
        self._reporter.say(*remarks)

    def spend(self, evaluations: int) -> None:
        """Count evaluations that something about this run took."""
        self.stage = self.stage.spent(evaluations)

    def leave_device(self) -> bool:
        """Go on on the CPU; False where it is there already."""
        left = self._settings.device != "cpu"
        self._settings = self._settings.model_copy(update={"device": "cpu"})
        return left

    # --------------------------------------------------------------------------- iterations

    def states(self) -> Generator[FitState, Change | None, Run | None]:
        """One state after every iteration; a change may be sent in return for each.

        Returns the run that follows, if the image calls for another PSF.
        """
        # A level of a checkpoint, or of another device.
        begun = self.stage.iteration > 0 or self.stage.evaluations > 0
        while self.stage.level_number < len(self._levels):
            self._begin_level(begun)
            begun = False
            if self._level.usable or self._last:
                before = self.fitted
                following = yield from self._level_states()
                if following is not None or self._over:
                    return following
                if not self._undone(before):
                    self._look_for_rivals()
            given = self.fitted, self._settings, self.stage.iteration
            self._go_on_with(self._upkeep.end_level(*given))
            self.stage = replace(self.stage, level_number=self.stage.level_number + 1)
        return None

    def _undone(self, before: Fitted) -> bool:
        """Undo a coarse level at which a cell drifted away from its start; True if undone."""
        astray = not self._last and strayed_off(before.mesh, self.fitted.mesh)
        if not astray or self.stage.edited:
            return False
        self.fitted = before
        self._reporter.say(_UNDONE)
        self._reporter.other_mesh(before.mesh)
        return True

    def _look_for_rivals(self) -> None:
        """Go on with the best of what may shine, where the fit may be stuck."""
        if not self._level.usable:
            return
        given = self.objective, self.fitted, self.stage, self._first_shape()
        before = self.fitted.mesh
        self.fitted, taken = self._choice.beside_rivals(self.terms, *given)
        self.spend(taken)
        if not np.array_equal(self.fitted.mesh.faces, before.faces):
            self._reporter.other_mesh(self.fitted.mesh)

    def _first_shape(self) -> Shape | None:
        """Where the fit began, if it is still of the same cells, and nobody has touched them."""
        first, now = self._begun.mesh.region_ids(), self.fitted.mesh.region_ids()
        touched = self.stage.edited or self.fitted.shape.pinned.any()
        return self._begun if np.array_equal(first, now) and not touched else None

    def _level_states(self) -> Generator[FitState, Change | None, Run | None]:
        self._due = True
        while True:
            if self._due:
                self._renew()
            else:
                self._advance()
            self.stage = replace(self.stage, iteration=self.stage.iteration + 1)
            finished, state = self._finished(), self._state()
            ended = (finished and self._last) or self._over
            following, cone = successor(self, finished) if ended and self._last else (None, False)
            ends = following is None and ended
            told = replace(state, cone=cone)
            change = yield self._told(told, ends, finished and self._last)
            if change is not None:
                self._take(change)
            elif ends or finished:
                return following

    # ---------------------------------------------------------------- runs that follow another

    def again(self, optics: Optics, former: Run | None = None) -> Run:
        """A run from the same start with another PSF; former : what it is held against."""
        given = self._begun.mesh, optics, self._settings, self.fitted.first_effects
        return Run(self._problem, *given, self.stage.begun_anew(optics), former)

    def go_on_at(self, fitted: Fitted) -> None:
        """Begin at the last level, where the fit with another PSF has ended."""
        self.fitted = self._choice.anew(fitted.seen_through(self.fitted.optics))
        self._reporter.other_mesh(self.fitted.mesh)
        self.stage = replace(self.stage, level_number=len(self._levels) - 1)

    def let_former_go(self) -> Run | None:
        """The run that this is held against; None the next time."""
        former, self._former = self._former, None
        return former

    def posed_here(self) -> Objective:
        """The objective where this run goes on."""
        self._make_level()
        return self._posed(())

    def come_back(self, stage: Stage) -> None:
        """Go on after another run, which ended at this stage; its PSF is not asked for again."""
        self.stage = self.stage.after(stage)

    @property
    def _choice(self) -> ModelChoice:
        return ModelChoice(self._settings, len(self._levels))

    @property
    def _last(self) -> bool:
        return self._choice.last(self.stage)

    @property
    def _over(self) -> bool:
        return self.stage.since_changed >= self._settings.max_iterations

    def _begin_level(self, begun: bool) -> None:
        if not begun:
            self.stage = replace(self.stage, blurred_for=self.fitted.optics, progress=Progress())
            self.fitted = self.fitted.taught(None)
            if not self._last:  # how bright each inside is, is found anew where the surface is now
                self.fitted = self.fitted.shining(replace(self.fitted.light, cells=()))
        self._make_level()
        if not begun:
            self._ask_of_small()
            blurred = 0.0 if self._level.factor == 1 else self._level.width
            self._upkeep.begin_level(self.fitted.mesh, blurred)

    def _ask_of_small(self) -> None:
        """Which of membranes and insides shine, where cells are too small to fit both."""
        choice = self._choice
        if self._level.usable and self.stage.iteration == 0:
            self.fitted = choice.of_small(self.terms, self.fitted)
        if self._last:
            self.fitted, taken = choice.of_small_again(self.terms, self.fitted)
            self.spend(taken)

    def _make_level(self) -> None:
        fitted, factor = self.fitted, self._levels[self.stage.level_number]
        # As wide as at the start, so that the voxels that count stay the same.
        spread = fitted.first_effects.spread
        given = self.stage.blurred_for, self._settings, fitted.effects, factor, spread
        self._level, self._second = self._problem.levels(*given)

    def _renew(self) -> None:
        """Good triangles, topology, and the objective from where the fit is."""
        stage, settings = self.stage, self._settings
        if not self._upkeep.trying:
            self._kept = self.checkpoint().saved()  # before the look: a resumed fit looks again
        choice = self._choice
        after_one = stage.progress.iterations > 0  # objective, at most
        if after_one and choice.density_waits(self.fitted):
            self.fitted = self.fitted.with_density(settings.density)
        given = self.fitted, settings, self._level.factor, stage.iteration
        self._go_on_with(self._upkeep.rearranged(*given))
        before = self.fitted
        self.fitted = self._upkeep.remeshed(before, settings)
        if self.fitted is not before:
            self._reporter.remeshed(before.mesh, self.fitted.mesh)
        held = self.stage.progress.held and self._last
        views = self.objective.posed.posterior.views if held else ()
        self.objective = self._posed(views)
        waits = choice.density_waits(self.fitted)
        if waits and not choice.walls_first(self.objective, self.fitted):
            self.fitted = self.fitted.with_density(settings.density)
            self.objective = self._posed(())
        if choice.asked(self.fitted, self.stage):
            found = self.objective.structure()
            progress = replace(self.stage.progress, sure=found.sure)
            if found.structure != self.fitted.structure:
                self.fitted = self.fitted.with_structure(found.structure)
                progress = progress.released()
                self.objective = self._posed(())
            self.stage = replace(self.stage, progress=progress)
        posed, progress = self.objective.posed, self.stage.progress
        progress = progress if posed.held else progress.freed()
        value = self.objective.now.value
        self._follow(progress.posed(value, posed.variance, self._schedule, posed.left))
        self._due = False

    @property
    def terms(self) -> Terms:
        """What an objective is posed for."""
        return Terms(
            self._level,
            self._second,
            self._settings,
            self._schedule,
            self._choice.density_fitted(self.fitted, self.stage),
            not self._choice.first(self.stage),
            self._last,
        )

    def _posed(self, views: Sequence[View]) -> Objective:
        return Objective(self.terms, self.fitted, self._upkeep.guard, self._factored, views)

    def _advance(self) -> None:
        """One step down."""
        moved = self.objective.step()
        progress = self.stage.progress.stepped(self.objective.now.value, moved, self._schedule)
        strayed = self.objective.strayed()
        self._follow(progress.released() if strayed else progress)
        since = self.stage.progress.since_posed
        self._due = since >= self._schedule.renewed_every or strayed or not moved

    def _follow(self, progress: Progress) -> None:
        """Take over where the objective is."""
        self.fitted = self.objective.fitted
        spent = self.stage.spent(self.objective.evaluations())
        self.stage = replace(spent, progress=progress)

    def _finished(self) -> bool:
        """Whether the level is done; at the last one, topology is tried before."""
        schedule, progress = self._schedule, self.stage.progress
        if not self._last:
            return progress.coarse_ends(schedule)
        remaining = Remaining(np.inf, np.inf, 0)
        if progress.since_posed >= schedule.window:
            remaining = self.objective.remaining(self._tolerance)
        progress = progress.looked(remaining, self._tolerance, schedule)
        self.stage = replace(self.stage, remaining=remaining, progress=progress)
        if not progress.at_rest(schedule):
            return False
        if self._choice.density_waits(self.fitted):
            self._due = True
            return False
        late = progress.iterations >= schedule.patience
        if not (progress.final(schedule) or late) and progress.stuck <= 1:
            self._due = True  # what it is judged by is that of a surface further off
            return False
        if is_given_up(self, self._former):
            return True
        too_soon = self._upkeep.too_soon(self.stage.iteration) and progress.stuck <= 1
        judging = self._upkeep.trying  # a change that is kept needs no other objective
        if judging and too_soon:
            return False
        # Before what shines is asked: judged by another light, it would bring the old one back.
        judged = self._upkeep.judged(self.fitted, self._settings)
        if self._go_on_with(judged) or self._other_structure():
            self._due = True
            return False
        if too_soon:
            return False
        given = self.fitted, self._settings, self._level.factor, self.stage.iteration
        changed = self._go_on_with(self._upkeep.tried(*given))
        self._due = changed or (self._due and not judging)
        return not self._due

    def _other_structure(self) -> bool:
        """Whether, at rest, something else shines than what had been clear on the way."""
        before, progress = self.fitted, self.stage.progress
        given = self.terms, self.objective, before, self._factored, progress
        self.fitted, taken, after = self._choice.asked_anew(*given, self._first_shape())
        self.spend(taken)
        self.stage = replace(self.stage, progress=after)
        if self.fitted is before:
            return False
        self.stage = replace(self.stage, progress=replace(after.released(), stuck=0, rests=0))
        if after.again != progress.again and self.fitted.mesh is not before.mesh:
            self._go_on_elsewhere(before.mesh)
        return True

    def _go_on_elsewhere(self, before: Mesh) -> None:
        """The surface was taken up again further in, or where the fit began."""
        progress = self.stage.progress
        fresh = Progress(again=True, unsure=progress.unsure)
        self.stage = replace(self.stage, progress=fresh)
        self._upkeep.restart()
        self._reporter.say(_FURTHER_IN)
        if not np.array_equal(self.fitted.mesh.faces, before.faces):
            self._upkeep.begin_level(self.fitted.mesh, 0.0)
            self._reporter.other_mesh(self.fitted.mesh)

    @property
    def _tolerance(self) -> float:
        return self._settings.tolerance * min(self.fitted.optics.sigma_um)

    # --------------------------------------------------------------------------- the surface

    def _go_on_with(self, fitted: Fitted) -> bool:
        """Go on with what a change of topology made; whether it is another surface."""
        self._reporter.happened(self._upkeep.events())
        if fitted is self.fitted:
            return False
        self.fitted = fitted
        self.stage = replace(self.stage, progress=self.stage.progress.released())
        self._reporter.other_mesh(fitted.mesh)
        return True

    # ------------------------------------------------------------------------------- changes

    def _take(self, change: Change) -> None:
        """Go on from a changed state: the past says nothing about it."""
        change.check(self.fitted.mesh, self.fitted.optics, self._settings)
        if change.settings is not None:
            self._take_settings(change.settings)
        self.fitted = self.fitted.changed(change, self._settings.density)
        if (change.settings, change.effects) != (None, None):
            self.fitted = self._choice.anew(self.fitted)
        self.stage = replace(self.stage, changed_at=self.stage.iteration, progress=Progress())
        self._due = True
        if change.mesh is not None:
            self._upkeep.edges_given()
            self._reporter.other_mesh(self.fitted.mesh)
        if change.mesh is not None or change.pinned is not None:
            self._upkeep.restart()
        if (change.optics, change.settings, change.effects) != (None, None, None):
            self._upkeep.forget_trial()
            self._change_level()

    def _change_level(self) -> None:
        """The level for another PSF, other effects or settings."""
        before = self.stage
        self.stage = replace(before, blurred_for=self.fitted.optics)
        self._make_level()
        if not self._level.usable:  # the blur of the new PSF is wider than the image
            self.stage = before
            self._make_level()

    def _take_settings(self, settings: FitSettings) -> None:
        before = self._settings.collisions
        self._settings = taken_over(settings, self._settings)
        if self._settings.collisions != before:
            self._upkeep.guarded(self._settings.collisions)

    # ---------------------------------------------------------------------------- reporting

    def _face_densities(self) -> np.ndarray:
        fitted = self.fitted
        if self.objective.fitted.mesh.faces is fitted.mesh.faces:
            return self.objective.face_densities
        # A change of topology has come since the objective was posed.
        return fitted.shape.face_densities()

    def _told(self, state: FitState, ends: bool, finished: bool) -> FitState:
        """With what there is to say, and with a verdict where it is the last."""
        fitted, stage = self.fitted, self.stage
        self._reporter.say(self._upkeep.guard.remark())
        message, events = self._reporter.told(fitted.mesh, stage.iteration, ends)
        if ends:
            left, found = stage.remaining, self.objective.now.match
            moving = left if left.moves(self._tolerance, self._schedule.gain) else None
            given = fitted, found, finished, stage.iteration, moving, message
            message, finished = verdict(*given)
        return replace(state, message=message, events=events, converged=ends and finished)

    def _state(self) -> FitState:
        now, accuracy = self.objective.now.match, self._settings.image_accuracy
        place = self._problem.grid, len(self._levels), self._level.factor, accuracy
        return state_of(self.fitted, self.stage, now, self._face_densities(), *place, self._kept)

    # -------------------------------------------------------------------------- checkpoints

    def checkpoint(self) -> Checkpoint:
        """To go on from here."""
        return Checkpoint(
            self._start,
            self._settings.density,
            self.fitted,
            self.stage,
            self._levels,
            self._upkeep.policy,
            self._upkeep.saved(),
            None if self._former is None else self._former.checkpoint().saved(),
        )

    def go_on_from(self, kept: Arrays) -> None:
        """Go on from a checkpoint.

        Raises
        ------
        InputError
            If it belongs to another mesh or fit.
        """
        found = self.checkpoint().loaded(kept)
        # Held voxels are those of an objective that is not there any more.
        self.fitted = found.fitted
        self.stage = replace(found.stage, progress=found.stage.progress.freed())
        self._upkeep.resume(found.policy, found.remeshing)
        self._reporter.other_mesh(found.fitted.mesh)
