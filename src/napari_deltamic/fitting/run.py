"""A fit as a loop: level after level, and what may be changed between two iterations."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

from ..common.triple import triple
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..runs.settings import WIDE_LEVELS, FitSettings
from ..scene.effects import Effects
from .checkpoint import Checkpoint
from .level_run import LevelRun
from .model.change import Change
from .model.fitted import Arrays, Fitted, fingerprint
from .model.problem import Problem
from .model.state import FitState
from .objective.fit_objective import Objective, Terms
from .objective.schedule import Progress
from .position import Position, RunContext
from .reporting import Reporter, verdict
from .stage import Stage
from .successor import is_given_up, successor
from .surface.surface_upkeep import SurfaceUpkeep
from .surface.topology import TopologyPolicy


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
        levels = settings.levels or WIDE_LEVELS
        settings = settings.model_copy(update={"levels": levels})
        # Where many cells begin near their walls, those differ more than places within a wall do.
        several = len(levels) == 1 and len(mesh.region_ids()) > 1
        model = "interface" if several and settings.density == "smooth" else settings.density
        fitted = Fitted.begun(mesh, optics, effects, model, settings.structure)
        self._start, self._former = fingerprint(mesh), former
        upkeep = SurfaceUpkeep(problem, mesh, min(optics.sigma_um), settings.collisions)
        self._context = RunContext(problem, upkeep, Reporter(mesh), fitted.shape)
        stage = stage or Stage(0, fitted.optics)
        self._level = LevelRun(self._context, Position(fitted, stage, settings))
        self._kept: Arrays = {}

    @property
    def fitted(self) -> Fitted:
        """Surface, PSF and effects so far."""
        return self._level.at.fitted

    @property
    def stage(self) -> Stage:
        """Where in the schedule that is."""
        return self._level.at.stage

    @property
    def objective(self) -> Objective:
        """What the last step went down."""
        return self._level.objective

    @property
    def terms(self) -> Terms:
        """What an objective is posed for."""
        return self._level.terms

    @property
    def problem(self) -> Problem:
        """What is to be explained."""
        return self._context.problem

    @property
    def begun(self) -> Mesh:
        """Where it began."""
        return self._context.begun.mesh

    def say(self, *remarks: str) -> None:
        """Tell this with the next state."""
        self._context.reporter.say(*remarks)

    def spend(self, evaluations: int) -> None:
        """Count evaluations that something about this run took."""
        self._level.spend(evaluations)

    def leave_device(self) -> bool:
        """Go on on the CPU; False where it is there already."""
        at = self._level.at
        settings = at.settings.model_copy(update={"device": "cpu"})
        # Voxels that were held are those of an objective on the other device.
        at = at.progressed(at.stage.progress.freed())
        self._go_on_at(replace(at, settings=settings))
        return at.settings.device != "cpu"

    # --------------------------------------------------------------------------- iterations

    def states(self) -> Generator[FitState, Change | None, Run | None]:
        """One state after every iteration; a change may be sent in return for each.

        Returns the run that follows, if the image calls for another PSF.
        """
        # A level of a checkpoint, or of another device.
        begun = self.stage.iteration > 0 or self.stage.evaluations > 0
        while self.stage.level_number < len(self._level.at.levels):
            if begun:
                self._level.go_on()
            else:
                self._level.begin()
            begun = False
            steps = self._level.usable or self._level.at.last
            if steps:
                following = yield from self._level_states()
                if following is not None or self._level.at.over:
                    return following
            self._level = self._level.end(steps)
        return None

    def _level_states(self) -> Generator[FitState, Change | None, Run | None]:
        level = self._level
        while True:
            if level.due and not self._context.upkeep.trying:
                self._kept = self.checkpoint().saved()  # before the look: a resumed fit looks again
            finished = level.iterate(self._given_up)
            last = level.at.last
            ended = (finished and last) or level.at.over
            following, cone = successor(self, finished) if ended and last else (None, False)
            ends = following is None and ended
            if ends and last:
                level.look_back()
            state = replace(level.state(self._kept), cone=cone)
            change = yield self._told(state, ends, finished and last)
            if change is not None:
                level.take(change)
            elif ends or finished:
                return following

    def _given_up(self) -> bool:
        return is_given_up(self, self._former)

    def _told(self, state: FitState, ends: bool, finished: bool) -> FitState:
        """The state with its messages, and with a verdict if it is the last."""
        at, reporter = self._level.at, self._context.reporter
        reporter.say(self._context.upkeep.guard.remark())
        message, events = reporter.told(at.fitted.mesh, at.stage.iteration, ends)
        if ends:
            left, found = at.stage.remaining, self.objective.now.match
            moves = left.moves(at.tolerance, self._context.schedule.gain)
            place = triple(at.fitted.mesh.vertices_numpy()[left.vertex]) if moves else None
            message, finished = verdict(
                at.fitted, found, finished, at.stage.iteration, place, message
            )
            state = replace(state, moving=place if finished else None)
        return replace(state, message=message, events=events, converged=ends and finished)

    # ---------------------------------------------------------------- runs that follow another

    def again(
        self,
        optics: Optics,
        former: Run | None = None,
        problem: Problem | None = None,
        effects: Effects | None = None,
    ) -> Run:
        """A run from the same start with another PSF.

        former : what it is held against. problem, effects : what it is to explain, and what makes
        the image, if these are others.
        """
        return Run(
            problem or self._context.problem,
            self._context.begun.mesh,
            optics,
            self._level.at.settings,
            effects or self.fitted.first_effects,
            self.stage.begun_anew(optics),
            former,
        )

    def go_on_at(
        self, fitted: Fitted, all_shines: bool, policy: TopologyPolicy | None = None
    ) -> None:
        """Begin at the last level, where another fit has ended.

        all_shines : whether all that may shine does again; else what did in the end stays, what
        else might shine is not asked again, and the patience of the level is over.
        policy : of the other fit, where what it tried of the topology is not tried again.
        """
        at = self._level.at
        if all_shines:
            fitted = at.choice.anew(fitted)
        progress = Progress()
        if not all_shines:
            patience = self._context.schedule.patience
            progress = Progress(iterations=patience, asked_again=True, nuclei=True)
        stage = replace(at.stage, level_number=len(at.levels) - 1, progress=progress)
        self._go_on_at(Position(fitted, stage, at.settings))
        if policy is not None:
            self._context.upkeep.go_on_with(policy)
        self._context.reporter.other_mesh(fitted.mesh)

    def let_former_go(self) -> Run | None:
        """The run that this is held against; None the next time."""
        former, self._former = self._former, None
        return former

    def posed_here(self) -> Objective:
        """The objective where this run goes on."""
        self._level.go_on()
        return self._level.posed()

    def come_back(self, stage: Stage, tried: int) -> None:
        """Go on after another run, which ended at this stage; tried : see :class:`.Stage`."""
        self._go_on_at(replace(self._level.at, stage=self.stage.after(stage, tried)))

    def _go_on_at(self, at: Position) -> None:
        self._level = LevelRun(self._context, at)

    # -------------------------------------------------------------------------- checkpoints

    def checkpoint(self) -> Checkpoint:
        """A checkpoint from which the fit can go on."""
        at, upkeep = self._level.at, self._context.upkeep
        return Checkpoint(
            self._start,
            at.settings.density,
            at.fitted,
            at.stage,
            at.levels,
            upkeep.policy,
            upkeep.saved(),
            None if self._former is None else self._former.checkpoint().saved(),
            self.problem,
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
        stage = replace(found.stage, progress=found.stage.progress.freed())
        self._go_on_at(Position(found.fitted, stage, self._level.at.settings))
        self._context.upkeep.resume(found.policy, found.remeshing)
        self._context.reporter.other_mesh(found.fitted.mesh)
