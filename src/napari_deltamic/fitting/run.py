"""The state of a fit between iterations, and one iteration of it."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import numpy as np
import torch

from ..geometry.mesh import FloatArray, Mesh
from ..geometry.topology.rearranging import give_way
from ..optics import Optics
from ..runs.settings import WIDE_LEVELS, FitSettings
from ..scene import expected_image
from ..scene.effects import Effects
from . import checkpoint
from .change import Change
from .collisions import CollisionGuard
from .convergence import Patches, Remaining
from .density import LIMIT, Density
from .descent import Descent
from .growth_alarm import GrowthAlarm, shrunken, told_shrunken, why_stuck
from .imaging import Imaging
from .lbfgs import Learnt
from .level import Level
from .local_misfit import Misfit, gaps, misfit_of
from .metric import Metric
from .pose import Posed, pose
from .preconditioner import NEAR_JUNCTIONS, Preconditioners
from .problem import Problem
from .schedule import Progress, Schedule
from .shape import Shape
from .state import FitState
from .topology import BEYOND, SHARP, TRIAL, TRIAL_AT_MOST, TopologyPolicy, Trial, may_change
from .triangle_quality import Upkeep, median_edge
from .variables import Variables

_LEFT_OPEN = ("accuracy", "levels")  # settings that the software may fill in
_PSF_BELOW = 2.5  # blur, in widths of the PSF, from which on PSF and effects are fitted
_ALARMS_EVERY = 10  # iterations


class Run:
    """The state of a fit between iterations."""

    def __init__(
        self, problem: Problem, mesh: Mesh, optics: Optics, settings: FitSettings, effects: Effects
    ) -> None:
        self.problem, self.settings, self.schedule = problem, settings, Schedule()
        self.effects = self.first_effects = effects
        self.optics = self.first_optics = self.level_optics = optics.detach()
        self.levels = settings.levels or WIDE_LEVELS
        self.seed = checkpoint.seed(mesh)
        self.shape = Shape.begun(mesh, settings.density)
        self.growth, self.upkeep = GrowthAlarm(mesh), Upkeep(mesh, min(optics.sigma_um))
        self.guard, self.factored = CollisionGuard(settings.collisions), Preconditioners()
        self.policy, self.trial = TopologyPolicy(), None
        self.posed: Posed
        self.iteration = self.evaluations = 0
        self.changed_at = 0  # the iteration of the last change: the patience starts anew
        self.level_number = 0
        self.progress, self.remaining = Progress(), Remaining(0.0, 0.0, 0)
        self.learnt: Learnt | None = None  # while the unknowns are the same
        self.remark = ""  # for the next state
        self.events: tuple[str, ...] = ()
        self.kept: dict[str, np.ndarray] = {}

    trial: Trial | None

    # --------------------------------------------------------------------------- iterations

    def states(self) -> Generator[FitState, Change | None, None]:
        """One state after every iteration; a change may be sent in return for each."""
        resumed = self.iteration > 0
        while self.level_number < len(self.levels):
            if not resumed:
                self.level_optics, self.progress, self.learnt = self.optics, Progress(), None
            self._make_level()
            if not resumed:
                blurred = 0.0 if self.level.factor == 1 else self.level.width
                self.upkeep.begin_level(self.shape.mesh, blurred)
            resumed = False
            if self.level.usable or self._last:
                yield from self._level_states()
                if self._over:
                    return
            self._level_ends()
            self.level_number += 1

    def _level_states(self) -> Generator[FitState, Change | None, None]:
        self.due = True
        while True:
            if self.due:
                self._renew()
            else:
                self._advance()
            self.iteration += 1
            finished = self._finished()
            ends = (finished and self._last) or self._over
            change = yield self._state(ends, finished and self._last)
            if change is not None:
                self._take(change)
            elif ends or finished:
                return

    @property
    def _last(self) -> bool:
        return self.level_number == len(self.levels) - 1

    @property
    def _over(self) -> bool:
        return self.iteration - self.changed_at >= self.settings.max_iterations

    def _make_level(self) -> None:
        self.problem.counted_with(self.effects)  # refuses what leaves too few
        given = self.problem.grid, self.level_optics, self.settings, self.effects
        factor, second = self.levels[self.level_number], self.problem.second
        # As wide as at the start, so that the voxels that count stay the same.
        halo = 0.0 if self.first_effects.halo is None else self.first_effects.halo.width
        counted = self.problem.counted_with(self.effects)
        other = None if second is None else second.optics
        self.level = Level(self.problem.image, counted, *given, factor, other, halo)
        self.other = None if second is None else second.level(*given, factor)

    # ------------------------------------------------------------------------- the objective

    def _renew(self) -> None:
        """Good triangles, topology, and the objective from where the fit is."""
        if self.trial is None:
            self.kept = checkpoint.kept(self)  # before the look: a resumed fit looks again
        self._look_at_topology()
        if self.settings.remesh and self.upkeep.wanted(self.shape.mesh):
            self._remesh()
        self._pose()

    def _pose(self) -> None:
        level, mesh = self.level, self.shape.mesh
        self.density = Density(mesh, self.settings.density, min(self.optics.sigma_um))
        fitted = level.factor <= _PSF_BELOW
        self.imaging = Imaging(
            self.optics, self.effects, self.first_optics, self.settings.fit_psf and fitted, fitted
        )
        given = (level, self.other), self.shape, self.density, self.imaging
        held = self.posed.posterior.views if self.progress.held and self._last else ()
        self.posed = pose(*given, self._density_fitted, self._last, held)
        self._take_numbers(self.posed.at)
        self.guard.watch(mesh)
        self.patches = Patches(mesh, min(self.optics.sigma_um))
        known = self.learnt if self.learnt and self.learnt.fits(len(self.posed.at.flat())) else None
        self.descent = Descent(self._metric(self.posed), level.width, self._limited, known)
        self.descent.begin(self.posed.posterior, self.posed.at)
        posed, value = self.posed, self.descent.now.value
        if not posed.held:
            self.progress = self.progress.freed()
        told = posed.variance, self.schedule, posed.left
        self.progress = self.progress.posed(value, *told)
        self.evaluations += self.descent.taken()
        self.due = False

    @property
    def _density_fitted(self) -> bool:
        """A smooth density waits for the first level's shape, or it stands in for that. Numbers of
        walls are too few to do so; held back, the shape would stand in for them."""
        first = self.level_number == 0 and len(self.levels) > 1
        return self.settings.density == "interface" or not first

    def _metric(self, posed: Posed) -> Metric:
        return Metric(
            self.factored,
            self.shape,
            self.level.smoothing,
            self.settings.bending,
            posed.firmness,
            self.level.width,
            NEAR_JUNCTIONS if self.level.factor == 1 else 1.0,
            self._density_fitted,
        )

    def _limited(self, start: Variables, end: Variables) -> Variables:
        """As near to the end as guard and bounds allow, where voxels count."""
        from_here = self.posed.at.vertices
        away = end.vertices - from_here
        far = np.linalg.norm(away, axis=1, keepdims=True)
        far /= self.schedule.strayed_far * self.level.width
        vertices = from_here + away / np.maximum(far, 1.0)
        return Variables(
            self.guard.limited(start.vertices, vertices),
            np.clip(end.density, -LIMIT, LIMIT),
            *self.imaging.bounded(end.optics, end.effects),
        )

    def _take_numbers(self, at: Variables) -> None:
        known = self._density_fitted or self.shape.log_density is not None
        log = at.density if known and len(at.density) else self.shape.log_density
        self.shape = self.shape.moved(at.vertices, log)
        if len(at.optics):
            self.optics = self.imaging.optics_of(torch.from_numpy(at.optics)).detach()
        self.effects = self.imaging.effects_of(at.effects)

    def _advance(self) -> None:
        """One step down."""
        moved = self.descent.step()
        self.evaluations += self.descent.taken()
        now = self.descent.now
        if not np.isfinite(now.value):
            raise FloatingPointError("the fit met a number that is not finite")
        self._take_numbers(self.descent.at)
        self.progress = self.progress.stepped(now.value, moved)
        s = self.schedule
        away = self.descent.at.vertices - self.posed.at.vertices
        limit = 0.97 * s.strayed_far * self.level.width
        strayed = float((np.linalg.norm(away, axis=1) > limit).mean()) > s.strayed
        if strayed:
            self.progress = self.progress.released()
        self.due = self.progress.since_posed >= s.renewed_every or strayed or not moved
        self.learnt = self.descent.learnt()

    # ------------------------------------------------------------------------------- the end

    def _finished(self) -> bool:
        """Whether the level is done; at the last one, topology is tried before."""
        if not self._last:
            return self.progress.coarse_ends(self.schedule)
        self.remaining = self._remaining()
        self.progress = self.progress.looked(self.remaining, self._tolerance, self.schedule)
        if not self.progress.at_rest(self.schedule):
            return False
        if not self.progress.settled and self.progress.stuck <= 1:
            self.due = True  # its variance is still that of a surface further off
            return False
        if self.trial is not None:
            if self.iteration - self.trial.iteration < TRIAL and self.progress.stuck <= 1:
                return False  # rest that comes so soon is of the places that have not changed
            self.due = self._judge()
        self.due = self._try() or self.due
        return not self.due

    @property
    def _tolerance(self) -> float:
        return self.settings.tolerance * min(self.optics.sigma_um)

    def _remaining(self) -> Remaining:
        if self.progress.since_posed < self.schedule.window:
            return Remaining(np.inf, np.inf, 0)
        at, step = self.descent.at.vertices, self.descent.direction().vertices
        # What the guard holds back has come as far as it can.
        free = (self.guard.held < self.schedule.held)[:, None]
        gradient = free * self.descent.now.gradient.vertices
        return self.patches.worst(at, free * step, gradient, self._tolerance, self.schedule.gain)

    def _level_ends(self) -> None:
        if self.trial is not None:
            self._judge()
        self.policy = self.policy.restarted()

    # ------------------------------------------------------------------------------ topology

    @property
    def _topology_may_change(self) -> bool:
        asked = self.settings.topology and self.settings.collisions
        return asked and self.level.factor <= SHARP and may_change(self.shape.mesh)

    def _look_at_topology(self) -> None:
        if not self._topology_may_change:
            return
        if self.trial is not None:
            patience = TRIAL_AT_MOST if self.trial.tried else TRIAL
            if self.iteration - self.trial.iteration < patience:
                return
            self._judge()
        self.policy, places = self.policy.pressing(self.shape, self.level.factor)
        if places:
            self._change(places, tried=False)

    def _try(self) -> bool:
        """Change what only a trial can tell; whether it did."""
        if not self._topology_may_change:
            return False
        width = max(self.optics.sigma_um)
        candidates = self.policy.candidates(self.shape, width)
        while places := self.policy.worth_a_trial(candidates, self.shape, width):
            known = len(self.policy.futile), self.policy.most
            if self._change(places, tried=True):
                return True
            if known == (len(self.policy.futile), self.policy.most):
                break  # nothing was learnt from it
        return False

    def _change(self, places: list[Any], tried: bool) -> bool:
        before = self.shape
        made = give_way(before.mesh, places, median_edge(before.mesh))
        if made.mesh is before.mesh:
            self.policy = self.policy.refused(places, made.hopeless, tried)
            return False
        places = [p for p in places if p not in made.hopeless]
        misfit = self._misfit()
        self.policy = self.policy.changed(places, tried)
        given = tuple(places), made.events, self.iteration, tried
        self.trial = Trial(before, misfit, *given)
        self._retriangulate(before.retriangulated(made.mesh, made.origin))
        self.events += () if tried else made.events
        return True

    def _judge(self) -> bool:
        """Undo the last change where the image speaks against it; whether the shape is another."""
        trial, self.trial = self.trial, None
        assert trial is not None
        reach = BEYOND * max(self.optics.sigma_um)
        points = [place.points for place in trial.places]
        after = self._misfit(trial.misfit)
        found = gaps(self.problem, trial.misfit, after, points, reach, self.optics)
        self.policy, judged = self.policy.judged(trial, found)
        for place in judged.undecided:
            self.events += (_undecided(place),)
        if not judged.undone:
            self.events += trial.events if trial.tried else ()
            return False
        self._retriangulate(trial.before)
        if judged.kept:
            made = give_way(trial.before.mesh, judged.kept, median_edge(trial.before.mesh))
            if made.mesh is not trial.before.mesh:
                self._retriangulate(trial.before.retriangulated(made.mesh, made.origin))
                self.events += made.events if trial.tried else ()
        elif not trial.tried:
            self.events += ("undone, as the image speaks against it",)
        return True

    def _misfit(self, like: Misfit | None = None) -> Misfit:
        density = Density(self.shape.mesh, self.settings.density, 1.0)
        faces = density.faces_numpy(self._log(density))
        given = self.optics, self.effects, self.settings.image_accuracy
        return misfit_of(self.problem, self.shape.mesh, faces, *given, like)

    def _log(self, density: Density) -> FloatArray:
        log = self.shape.log_density
        return np.zeros(len(density)) if log is None else log

    # ------------------------------------------------------------------------------ triangles

    def _retriangulate(self, shape: Shape) -> None:
        self.shape, self.learnt, self.progress = shape, None, self.progress.released()
        self.growth = GrowthAlarm(shape.mesh)

    def _remesh(self) -> None:
        """Good triangles again."""
        shape = self.shape
        log = shape.log_density if shape.model == "smooth" else None
        carried = np.zeros((len(shape.mesh.vertices), 0)) if log is None else log[:, None]
        apart = self.settings.collisions
        done = self.upkeep.renewed(shape.mesh, carried, shape.pinned, apart)
        self.guard.watch(shape.mesh)
        if not self.guard.allows(done.mesh):
            self.upkeep.refused(shape.mesh)
            return
        values = None if log is None else np.ascontiguousarray(done.carried[:, 0])
        self.growth.remeshed(shape.mesh, done.mesh)
        self.shape = shape.retriangulated(done.mesh, None, values).with_pins(done.fixed)
        self.learnt = None

    # ------------------------------------------------------------------------------- changes

    def _take(self, change: Change) -> None:
        """Go on from a changed state: the past says nothing about it."""
        change.check(self.shape.mesh, self.optics, self.settings)
        self.changed_at = self.iteration
        if change.mesh is not None:
            self._replace(change.mesh)
        if change.pinned is not None:
            self.shape = self.shape.with_pins(change.pinned)
        if change.mesh is not None or change.pinned is not None:
            self.trial, self.policy = None, self.policy.restarted()
        if change.optics is not None:
            self.optics = self.first_optics = change.optics.detach()
        if change.settings is not None:
            self._take_settings(change.settings)
        if change.effects is not None:
            self.effects = self.first_effects = change.effects
        self.progress, self.learnt, self.due = Progress(), None, True
        if (change.optics, change.settings, change.effects) != (None, None, None):
            self.trial = None  # the image is explained in another way
            blurred_for, self.level_optics = self.level_optics, self.optics
            self._make_level()
            if not self.level.usable:
                # The blur that goes with the new PSF is wider than the image.
                self.level_optics = blurred_for
                self._make_level()

    def _replace(self, mesh: Mesh) -> None:
        """Take a mesh from outside, as it is."""
        old = self.shape.mesh
        if np.array_equal(mesh.faces, old.faces) and np.array_equal(mesh.regions, old.regions):
            self.shape = self.shape.moved(mesh.vertices_numpy(), self.shape.log_density)
        else:
            unpinned = self.shape.with_pins(np.zeros(len(old.vertices), bool))
            self.shape = unpinned.retriangulated(mesh)
        self.upkeep.given()
        self.growth = GrowthAlarm(self.shape.mesh)

    def _take_settings(self, settings: FitSettings) -> None:
        old = self.settings
        open_ones = {k: getattr(old, k) for k in _LEFT_OPEN if getattr(settings, k) is None}
        self.settings = settings.model_copy(update={**open_ones, "levels": self.levels})
        self.shape = self.shape.with_model(self.settings.density)
        if self.settings.collisions != old.collisions:
            self.guard = CollisionGuard(self.settings.collisions)

    # ---------------------------------------------------------------------------- reporting

    def _state(self, ends: bool, finished: bool) -> FitState:
        shape, optics, effects = self.shape, self.optics, self.effects
        density, found = self.density.faces_numpy(self.descent.at.density), self.descent.now.match
        grid, accuracy, kept = self.problem.grid, self.settings.image_accuracy, self.kept
        told = self.remark, self.guard.remark(), *self.events
        due = ends or self.iteration % _ALARMS_EVERY == 0
        warning = self.growth.check(shape.mesh) if due else ""
        message = "; ".join(filter(None, (*told, warning)))
        if ends:
            message, finished = self._verdict(finished, message)
        events, self.remark, self.events = self.events, "", ()

        def rendered() -> np.ndarray:
            given = shape.mesh, grid, optics, accuracy, found.amplitude, found.background
            return expected_image(*given, density=density, effects=effects)

        return FitState(
            iteration=self.iteration,
            level=self.level_number + 1,
            levels=len(self.levels),
            mesh=shape.mesh,
            optics=optics,
            density=density,
            loss=found.loss,
            amplitude=found.amplitude,
            background=found.background,
            blur=self.level.factor,
            effects=effects,
            converged=finished,
            message=message,
            pinned=shape.pinned if shape.pinned.any() else None,
            events=events,
            evaluations=self.evaluations,
            _render=rendered,
            _checkpoint=lambda: kept,
        )

    def _verdict(self, finished: bool, told: str) -> tuple[str, bool]:
        """What came of the fit in plain words, and whether it has converged."""
        found = self.descent.now.match
        points = shrunken(self.shape.mesh, min(self.optics.sigma_um))
        cells, explained = len(self.shape.mesh.region_ids()), 1 - min(found.loss, 1)
        stuck = why_stuck(explained, found.bounded, points, cells) if finished else ""
        message = stuck or ("converged" if finished else "")
        message = message or f"stopped after {self.iteration} iterations, before it converged"
        further = "" if stuck else told_shrunken(points)
        moving = ""
        if finished and not stuck and self.remaining.moves(self._tolerance, self.schedule.gain):
            z, y, x = self.shape.mesh.vertices_numpy()[self.remaining.vertex]
            moving = f"the surface still moves at ({z:.1f}, {y:.1f}, {x:.1f}) um"
        return "; ".join(filter(None, (message, told, further, moving))), finished and not stuck

    def load(self, kept: dict[str, np.ndarray]) -> None:
        """Take over a checkpoint; raises InputError if it belongs to another mesh."""
        checkpoint.take_over(self, kept)


def _undecided(place: Any) -> str:
    cells = " and ".join(str(r) for r in sorted({*place.regions, *place.sides}) if r)
    z, y, x = place.points.mean(0)
    return f"undecided: how cells {cells} meet at ({z:.1f}, {y:.1f}, {x:.1f}) um"
