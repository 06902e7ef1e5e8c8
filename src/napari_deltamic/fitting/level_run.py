"""A fit at one level: objectives are posed and gone down until hardly anything is left to gain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..geometry.mesh import FloatArray
from .model.change import Change, taken_over
from .model.fitted import Arrays, Fitted
from .model.level import Level
from .model.state import FitState
from .objective.convergence import Remaining, strayed_off
from .objective.fit_objective import Objective, Terms
from .objective.prediction import View
from .objective.schedule import Progress
from .position import Position, RunContext
from .rivals.rival_structures import insides_may_do

_UNDONE = "a coarse level was undone: a cell had drifted away from its start"
_NUCLEI = "insides shine around dark nuclei: the fit goes on with surfaces further out"
_TAKEN_UP = {
    "both": "membranes shine as well: the fit goes on with surfaces further in",
    "interior": "insides explain the image as well as membranes: the fit goes on with them",
    "membrane": "membranes explain the image better than insides: the fit goes on with them",
}


class LevelRun:
    """A fit at one level, between two iterations.

    Parameters
    ----------
    context
        What all levels of the run share.
    at
        Where this one begins.

    Attributes
    ----------
    at
        Where it is.
    due
        Whether the objective is to be posed anew.
    objective
        What the last step went down.
    """

    def __init__(self, context: RunContext, at: Position) -> None:
        self._context, self.at = context, at
        self.due = True
        self.objective: Objective
        self._before: Fitted
        self._level: Level
        self._second: Level | None

    @property
    def usable(self) -> bool:
        """Whether a blur this wide leaves enough of the image."""
        return self._level.usable

    def spend(self, evaluations: int) -> None:
        """Count evaluations that something about the fit took."""
        self.at = self.at.spent(evaluations)

    # ------------------------------------------------------------------------ begin and end

    def begin(self) -> None:
        """Take the level up where the one before has ended."""
        at, upkeep = self.at, self._context.upkeep
        fitted = at.fitted.taught(None)
        if not at.last:  # how bright each inside is, is found anew where the surface is now
            fitted = fitted.shining(replace(fitted.light, cells=()))
        stage = replace(at.stage, blurred_for=at.fitted.optics, progress=Progress())
        self.at = replace(at, fitted=fitted, stage=stage)
        self._make_level()
        self._ask_of_small()
        upkeep.begin_level(self.at.fitted.mesh, self._blurred)
        self._before = self.at.fitted

    def go_on(self) -> None:
        """Take the level up where it was left."""
        self._make_level()
        self._before = self.at.fitted

    def end(self, went: bool) -> LevelRun:
        """What is decided between this level and the next, and that one; went : it took steps."""
        if went:
            self._undo_if_astray()
        at = self.at
        self._go_on_with(self._context.upkeep.end_level(at.fitted, at.settings, at.stage.iteration))
        stage = replace(self.at.stage, level_number=at.stage.level_number + 1)
        return LevelRun(self._context, replace(self.at, stage=stage))

    def _ask_of_small(self) -> None:
        """Choose between membranes and insides where cells are too small to fit both."""
        at = self.at
        if self.usable and at.stage.iteration == 0:
            self.at = at.holding(at.choice.of_small(self.terms, at.fitted))
        if at.last:
            fitted, taken = at.choice.of_small_again(self.terms, self.at.fitted)
            self.at = self.at.holding(fitted).spent(taken)

    def _undo_if_astray(self) -> None:
        """Undo a coarse level at which a cell drifted away from its start."""
        at, before = self.at, self._before
        astray = not at.last and strayed_off(before.mesh, at.fitted.mesh)
        if astray and not at.stage.edited:
            self.at = at.holding(before)
            self._context.reporter.say(_UNDONE)
            self._context.reporter.other_mesh(before.mesh)

    # --------------------------------------------------------------------------- the objective

    @property
    def _blurred(self) -> float:
        """um: width of the blurred PSF; 0 if it is sharp."""
        return 0.0 if self._level.factor == 1 else self._level.width

    def _make_level(self) -> None:
        at, fitted = self.at, self.at.fitted
        factor = at.levels[at.stage.level_number]
        # As wide as at the start, so that the voxels that count stay the same.
        spread = fitted.first_effects.spread
        self._level, self._second = self._context.problem.levels(
            at.stage.blurred_for, at.settings, fitted.effects, factor, spread
        )

    @property
    def terms(self) -> Terms:
        """What an objective is posed for."""
        at = self.at
        return Terms(
            self._level,
            self._second,
            at.settings,
            self._context.schedule,
            at.choice.density_fitted(at.fitted, at.stage),
            not at.choice.first(at.stage),
            at.last,
        )

    def posed(self, views: Sequence[View] = ()) -> Objective:
        """The objective where the fit is; views : of the objective before, whose voxels stay."""
        context = self._context
        return Objective(self.terms, self.at.fitted, context.upkeep.guard, context.factored, views)

    # ------------------------------------------------------------------------------ iterations

    def iterate(self, given_up: Callable[[], bool]) -> bool:
        """One step down, or a new objective; whether the level is done.

        given_up : whether, at rest, the fit goes back to the former one with nothing else tried.
        """
        if self.due:
            self._renew()
        else:
            self._advance()
        self.at = self.at.counted()
        return self._finished(given_up)

    def _renew(self) -> None:
        """Good triangles, topology, and the objective from where the fit is."""
        self._tidy()
        at, choice = self.at, self.at.choice
        held = at.stage.progress.held and at.last
        self.objective = self.posed(self.objective.posed.posterior.views if held else ())
        waits = choice.density_waits(at.fitted)
        if waits and not choice.walls_first(self.objective, at.fitted):
            self.at = at.holding(at.fitted.with_density(at.settings.density))
            self.objective = self.posed()
        if choice.asked(self.at.fitted, self.at.stage):
            self._ask_what_shines()
        posed, progress = self.objective.posed, self.at.stage.progress
        progress = progress if posed.held else progress.freed()
        value, schedule = self.objective.now.value, self._context.schedule
        self._follow(progress.posed(value, posed.variance, schedule, posed.left))
        self.due = False

    def _tidy(self) -> None:
        """Good triangles and topology."""
        at, upkeep = self.at, self._context.upkeep
        after_one = at.stage.progress.iterations > 0  # objective, at most
        if after_one and at.choice.density_waits(at.fitted):
            self.at = at.holding(at.fitted.with_density(at.settings.density))
        self._go_on_with(
            upkeep.look(self.at.fitted, at.settings, self._level.factor, at.stage.iteration)
        )
        before = self.at.fitted
        after = upkeep.remeshed(before, at.settings)
        if after is not before:
            self.at = self.at.holding(after)
            self._context.reporter.remeshed(before.mesh, after.mesh)

    def _ask_what_shines(self) -> None:
        found, fitted = self.objective.structure(), self.at.fitted
        progress = replace(self.at.stage.progress, sure=found.sure)
        if found.structure != fitted.structure:
            self.at = self.at.holding(fitted.with_structure(found.structure))
            progress = progress.released()
            self.objective = self.posed()
        self.at = self.at.progressed(progress)

    def _advance(self) -> None:
        """One step down."""
        schedule, progress = self._context.schedule, self.at.stage.progress
        moved = self.objective.step()
        progress = progress.stepped(self.objective.now.value, moved, schedule)
        strayed = self.objective.strayed()
        self._follow(progress.released() if strayed else progress)
        since = progress.since_posed
        self.due = since >= schedule.renewed_every or strayed or not moved

    def _follow(self, progress: Progress) -> None:
        """Take over where the objective is."""
        spent = self.objective.evaluations()
        self.at = self.at.holding(self.objective.fitted).spent(spent).progressed(progress)

    # ------------------------------------------------------------------------------- the end

    def _finished(self, given_up: Callable[[], bool]) -> bool:
        """Whether the level is done; at the last one, topology is tried before."""
        schedule, upkeep = self._context.schedule, self._context.upkeep
        if not self.at.last:
            return self.at.stage.progress.coarse_ends(schedule)
        progress = self._looked()
        if not progress.at_rest(schedule):
            return False
        late = progress.iterations >= schedule.patience
        judged_far_off = not (progress.final(schedule) or late) and progress.stuck <= 1
        if self.at.choice.density_waits(self.at.fitted) or judged_far_off:
            self.due = True
            return False
        if given_up():
            return True
        too_soon = upkeep.too_soon(self.at.stage.iteration) and progress.stuck <= 1
        judging = upkeep.trying  # a change that is kept needs no other objective
        if judging and too_soon:
            return False
        # Before what shines is asked: judged by another light, it would bring the old one back.
        judged = upkeep.judged(self.at.fitted, self.at.settings)
        if self._go_on_with(judged) or self._other_structure():
            self.due = True
            return False
        if too_soon:
            return False
        at = self.at
        changed = self._go_on_with(
            upkeep.tried(at.fitted, at.settings, self._level.factor, at.stage.iteration)
        )
        self.due = changed or (self.due and not judging) or self._around_nuclei()
        return not self.due

    def _looked(self) -> Progress:
        """The progress after a look at what is still to come."""
        schedule, at, remaining = self._context.schedule, self.at, Remaining(np.inf, np.inf, 0)
        if at.stage.progress.since_posed >= schedule.window:
            remaining = self.objective.remaining(at.tolerance)
        progress = at.stage.progress.looked(remaining, at.tolerance, schedule)
        self.at = replace(at, stage=replace(at.stage, remaining=remaining, progress=progress))
        return progress

    def _other_structure(self) -> bool:
        """Whether, at rest, something else shines than what had been clear on the way."""
        at, context, progress = self.at, self._context, self.at.stage.progress
        guessed = context.problem.psf_guessed
        fitted, taken, after = at.choice.asked_anew(
            self.terms, self.objective, at.fitted, context.factored, progress, guessed
        )
        self.at = at.holding(fitted).spent(taken).progressed(after)
        if fitted is at.fitted:
            return False
        self.at = self.at.progressed(replace(after.released(), stuck=0, rests=0))
        if after.asked_again != progress.asked_again and fitted.mesh is not at.fitted.mesh:
            self._go_on_further_in()
        return True

    def _around_nuclei(self) -> bool:
        """Whether, where the fit would end, it goes on with insides around dark nuclei."""
        at = self.at
        fitted, taken, after = at.choice.around_nuclei(
            self.terms, self.objective, at.fitted, at.stage.progress
        )
        self.at = at.holding(fitted).spent(taken).progressed(after)
        if fitted is at.fitted:
            return False
        self._context.reporter.say(_NUCLEI)
        self._context.upkeep.restart()
        self._other_mesh()
        return True

    def look_back(self) -> None:
        """Where a fit of both ends, once it has been at rest: whether insides alone may do.

        On the way, what is tried for it would be for nothing.
        """
        at = self.at
        if at.choice.is_open(at.fitted) and at.stage.progress.answered:
            unsure, taken = insides_may_do(self.terms, self.objective, self._context.factored)
            unsure |= at.stage.progress.unsure  # of dark nuclei
            self.at = at.spent(taken).progressed(replace(at.stage.progress, unsure=unsure))

    def _go_on_further_in(self) -> None:
        """The surface was taken up again further in, or further out for insides alone."""
        structure, unsure = self.at.fitted.structure, self.at.stage.progress.unsure
        alone = structure == "membrane"  # insides beside them are asked for yet
        self.at = self.at.progressed(Progress(asked_again=not alone, unsure=unsure))
        self._context.upkeep.restart()
        self._context.reporter.say(_TAKEN_UP[structure])

    def _other_mesh(self) -> None:
        """Go on with triangles that are none of those before."""
        now = self.at.fitted.mesh
        self._context.upkeep.begin_level(now, 0.0)
        self._context.reporter.other_mesh(now)

    def _go_on_with(self, fitted: Fitted) -> bool:
        """Go on with what a change of topology made; whether it is another surface."""
        reporter, at = self._context.reporter, self.at
        reporter.happened(self._context.upkeep.events())
        if fitted is at.fitted:
            return False
        # In a few places: what shines is what did.
        progress = replace(at.stage.progress.released(), answered=at.stage.progress.answered)
        self.at = at.holding(fitted).progressed(progress)
        reporter.other_mesh(fitted.mesh)
        return True

    # ------------------------------------------------------------------------------- changes

    def take(self, change: Change) -> None:
        """Go on from a changed state: the past says nothing about it."""
        before, upkeep = self.at, self._context.upkeep
        change.check(before.fitted.mesh, before.fitted.optics, before.settings)
        settings = before.settings
        if change.settings is not None:
            settings = taken_over(change.settings, settings)
            if settings.collisions != before.settings.collisions:
                upkeep.guarded(settings.collisions)
        stage = replace(before.stage, changed_at=before.stage.iteration, progress=Progress())
        self.at = Position(before.fitted.changed(change, settings.density), stage, settings)
        if (change.settings, change.effects) != (None, None):
            self.at = self.at.holding(self.at.choice.anew(self.at.fitted))
        self.due = True
        if change.mesh is not None:
            upkeep.edges_given()
            self._context.reporter.other_mesh(self.at.fitted.mesh)
        if change.mesh is not None or change.pinned is not None:
            upkeep.restart()
        if (change.optics, change.settings, change.effects) != (None, None, None):
            upkeep.forget_trial()
            self._change_level()

    def _change_level(self) -> None:
        """The level for another PSF, other effects or settings."""
        before = self.at
        stage = replace(before.stage, blurred_for=before.fitted.optics)
        self.at = replace(before, stage=stage)
        self._make_level()
        if not self.usable:  # the blur of the new PSF is wider than the image
            self.at = before
            self._make_level()

    # ---------------------------------------------------------------------------- what it shows

    def state(self, kept: Arrays) -> FitState:
        """Where the fit is; kept : its last checkpoint."""
        at, now = self.at, self.objective.now.match
        problem, fitted, stage = self._context.problem, at.fitted, at.stage
        return FitState(
            iteration=stage.iteration,
            level=stage.level_number + 1,
            levels=len(at.levels),
            mesh=fitted.mesh,
            optics=fitted.optics,
            density=self._densities(),
            loss=now.loss,
            amplitude=now.amplitude,
            background=now.background,
            blur=self._level.factor,
            effects=fitted.effects,
            light=fitted.light,
            pinned=fitted.shape.pinned if fitted.shape.pinned.any() else None,
            evaluations=stage.evaluations,
            unsure=stage.progress.unsure and fitted.structure != "membrane",
            dimmed=fitted.dimmed,
            counted=problem.counted if problem.ground_changed else None,
            local_background=problem.local_background,
            grid=problem.grid,
            accuracy=at.settings.image_accuracy,
            _checkpoint=lambda: kept,
        )

    def _densities(self) -> FloatArray:
        """(F,) relative to the mean."""
        fitted = self.at.fitted
        if self.objective.fitted.mesh.faces is fitted.mesh.faces:
            return self.objective.face_densities
        # A change of topology has come since the objective was posed.
        return fitted.shape.face_densities()
