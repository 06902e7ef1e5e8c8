"""The state of a fit between iterations, and one iteration of it."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np
import torch
from scipy.spatial import cKDTree

from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene import Grid, expected_image
from ..scene.effects import Effects
from ..settings import WIDE_LEVELS, FitSettings
from . import checkpoint
from .change import Change
from .collisions import CollisionGuard
from .density import DensityField
from .health import GrowthAlarm, shrunken
from .imaging_step import Imaging, imaging_step
from .level import Level
from .likelihood import Match, match
from .optimiser import AdamUniform
from .preconditioner import NEAR_JUNCTIONS, Preconditioner, components
from .second_view import Pixels, SecondTerm
from .state import FitState
from .topology import TopologyKeeper
from .upkeep import Upkeep

_WINDOW = 12  # iterations over which a level must gain
# A coarse level ends when its window gains less than this share of the loss, or moves the vertices
# by less than this share of its width: it only has to bring the next one within reach.
_COARSE_GAIN, _COARSE_STILL = 0.05, 0.04
_STILL = 0.02  # the same at the last level
_SETTLE = 2  # times the last level halves its step before it counts as converged
_PSF_EVERY = 5
_EXPLAINS_NOTHING = 0.97  # loss at the end from which on nothing was found
_LEFT_OPEN = ("accuracy", "smoothing", "levels")  # settings that the software may fill in
_PSF_BELOW = 2.5  # blur, in widths of the PSF, from which on the PSF is fitted


class Run:
    """The state of a fit between iterations."""

    def __init__(
        self,
        image: np.ndarray,
        counted: np.ndarray,
        grid: Grid,
        mesh: Mesh,
        optics: Optics,
        settings: FitSettings,
        effects: Effects,
        second: Pixels | None = None,
    ) -> None:
        self.second = second
        self.image, self.counted, self.grid = image, counted, grid
        self.settings = settings
        self.effects = self.first_effects = effects
        self.levels = settings.levels or WIDE_LEVELS
        self.growth = GrowthAlarm(mesh)
        self.upkeep = Upkeep(mesh)
        self.guard = CollisionGuard(settings.collisions)
        self.topology = TopologyKeeper()
        self.seed = checkpoint.seed(mesh)
        self.mesh = mesh.with_vertices(mesh.vertices_numpy().copy())
        self.optics = self.first_optics = optics.detach()
        self.pieces = components(mesh)
        self.adam = AdamUniform(self.pieces, 3)
        self.density = DensityField(mesh, self.pieces, settings.density)
        self.iteration = 0
        self.changed_at = 0  # the iteration of the last change: the patience starts anew
        self.level_number = 0
        self.step_factor = 1.0
        self.halvings = 0
        self.losses: list[float] = []  # since the level or the present step began
        self.window_start = self.mesh.vertices_numpy()
        self.level_optics = self.optics  # of the blur: a fit of the PSF leaves it alone
        self.bounded = False  # whether the amplitude wanted to be negative
        self.remark = ""  # for the first state
        self.pinned = np.zeros(len(mesh.vertices), bool)
        self.kept: dict[str, np.ndarray] = {}

    # --------------------------------------------------------------------------- iterations

    def states(self) -> Generator[FitState, Change | None, None]:
        """One state after every iteration; a change may be sent in return for each."""
        levels = self.levels
        first = self.level_number
        for number in range(first, len(levels)):
            if number > first or self.iteration == 0:
                self._enter(number)
            self._make_level()
            last = number == len(levels) - 1
            if not (self.level.usable or last):
                continue
            self.hold()
            while True:
                state = self._iterate()
                finished = self._settled(last)
                warning = "" if self.iteration % _WINDOW else self.growth.check(self.mesh)
                over = self.iteration - self.changed_at >= self.settings.max_iterations
                if finished and last and not over and self.topology.holds_up(self):
                    finished = False
                    self._enter(number)
                ends = (finished and last) or over
                if ends:
                    state = self._verdict(state, finished and last, warning)
                else:
                    told = (self.remark, self.guard.remark(), *state.events, warning)
                    state = replace(state, message="; ".join(filter(None, told)))
                self.remark = ""
                change = yield state
                if change is not None:
                    self._take(change)
                elif ends:
                    return
                elif finished:
                    self.topology.level_ends(self)
                    break

    def _make_level(self) -> None:
        given = self.grid, self.level_optics, self.settings, self.effects
        factor = self.levels[self.level_number]
        second = None if self.second is None else self.second.optics
        # As wide as at the start, so that the voxels that count stay the same.
        halo = 0.0 if self.first_effects.halo is None else self.first_effects.halo.width
        self.level = Level(self.image, self.counted, *given, factor, second, halo)
        self.other = None if self.second is None else SecondTerm(self.second, *given, factor)

    def hold(self) -> None:
        """Smoothers of this level: of steps, which end at pinned vertices, and of the density."""
        smoothing = self.level.smoothing
        at_junctions = NEAR_JUNCTIONS if self.level.factor == 1 else 1.0
        self.smoother = Preconditioner(self.mesh, smoothing, None, at_junctions)
        self.mover = self.smoother
        if self.pinned.any():
            self.mover = Preconditioner(self.mesh, smoothing, self.pinned, at_junctions)
        self.guard.watch(self.mesh)

    def _take(self, change: Change) -> None:
        """Go on from a changed state: the past says nothing about it."""
        change.check(self.mesh, self.optics, self.settings)
        self.changed_at = self.iteration
        if change.mesh is not None:
            self._replace(change.mesh)
            self.growth = GrowthAlarm(self.mesh)
            self.topology.restart()
        if change.pinned is not None:
            self.pinned = np.array(change.pinned, bool)
            if change.mesh is None:
                # They stay where they were seen, which is one step back.
                vertices = self.mesh.vertices_numpy().copy()
                vertices[self.pinned] = self.seen[self.pinned]
                self.mesh = self.mesh.with_vertices(self.guard.limited(self.seen, vertices))
        if change.optics is not None:
            self.optics = self.first_optics = change.optics.detach()
        if change.settings is not None:
            self._take_settings(change.settings)
        if change.effects is not None:
            self.effects = self.first_effects = change.effects
        blurred_for = self.level_optics
        self._enter(self.level_number)
        if (change.optics, change.settings, change.effects) != (None, None, None):
            self._make_level()
            if not self.level.usable:
                # The blur that goes with the new PSF is wider than the image.
                self.level_optics = blurred_for
                self._make_level()
        else:
            self.level.renew()
        self.hold()

    def _remesh(self) -> None:
        """Good triangles again."""
        before, log, past = self.mesh, self.density.per_vertex, self.adam.carried()
        width, count = past.shape[1], self.adam.count
        carried = past if log is None else np.column_stack([past, log])
        done = self.upkeep.renewed(before, carried, self.pinned, self.settings.collisions)
        if not self.guard.allows(done.mesh):
            self.upkeep.refused(before)
            return
        self.retriangulate(done.mesh, None if log is None else done.carried[:, width])
        # Its past included, or the first steps after it would be as rough as those of a level.
        self.adam.count = count
        self.adam.carry_on(self.pieces, done.carried[:, :width])
        self.pinned = done.fixed
        self.growth.remeshed(before, self.mesh)
        self.window_start = np.zeros((0, 3))
        self.hold()

    def _replace(self, mesh: Mesh) -> None:
        """Take a mesh from outside, as it is."""
        vertices = mesh.vertices_numpy().copy()
        vertices.setflags(write=False)  # states share it
        old = self.mesh
        if np.array_equal(mesh.faces, old.faces) and np.array_equal(mesh.regions, old.regions):
            self.mesh = old.with_vertices(vertices)
            return
        log = self.density.per_vertex
        if log is not None:
            log = log[cKDTree(old.vertices_numpy()).query(vertices)[1]]
        self.retriangulate(mesh.with_vertices(vertices), log)
        self.pinned = np.zeros(len(vertices), bool)

    def retriangulate(self, mesh: Mesh, log_density: np.ndarray | None) -> None:
        """The same regions with other triangles; the density goes along."""
        kept, before = self.density.log, self.mesh
        self.mesh = mesh
        self.pieces = components(mesh)
        self.adam = AdamUniform(self.pieces, 3)
        self.density = DensityField(mesh, self.pieces, self.settings.density)
        if log_density is not None:
            self.density.log = log_density
        elif self.settings.density == "interface":
            # Walls that are new have the mean density.
            own = {tuple(pair): log for pair, log in zip(before.interfaces()[0], kept, strict=True)}
            self.density.log = np.array([own.get(tuple(p), 0.0) for p in mesh.interfaces()[0]])

    def _take_settings(self, settings: FitSettings) -> None:
        old = self.settings
        open_ones = {k: getattr(old, k) for k in _LEFT_OPEN if getattr(settings, k) is None}
        self.settings = settings.model_copy(update={**open_ones, "levels": self.levels})
        if self.settings.density != old.density:
            self.density = DensityField(self.mesh, self.pieces, self.settings.density)
        if self.settings.collisions != old.collisions:
            self.guard = CollisionGuard(self.settings.collisions)

    def _verdict(self, state: FitState, finished: bool, warning: str) -> FitState:
        """The last state, with what came of the fit in plain words."""
        points = shrunken(state.mesh, min(self.optics.sigma_um))
        stuck = self.bounded or bool(points) or state.loss > _EXPLAINS_NOTHING
        if finished and points:
            listed = ", ".join(map(str, points))
            message = f"stuck: the surface of region {listed} has shrunk to a point; place it anew"
        elif finished and stuck:
            message = (
                f"stuck: {1 - min(state.loss, 1):.0%} of the measured image is explained; "
                "do the seeds lie near bright membranes?"
            )
        elif finished:
            message = "converged"
        else:
            message = f"stopped after {self.iteration} iterations, before it converged"
        message += f"; {warning}" if warning else ""
        return replace(state, converged=finished and not stuck, message=message)

    def _enter(self, number: int) -> None:
        self.level_number = number
        self.level_optics = self.optics
        self.step_factor = 1.0
        self.halvings = 0
        self.losses = []
        self.window_start = self.mesh.vertices_numpy()
        self.adam.restart()
        self.density.restart()

    def _iterate(self) -> FitState:
        level = self.level
        if level.renews:
            if self.settings.remesh and not self.halvings and self.upkeep.wanted(self.mesh):
                self._remesh()
            self.topology.look(self)
            self.kept = checkpoint.kept(self)
        kept = self.kept
        vertices = torch.tensor(self.mesh.vertices_numpy(), requires_grad=True)
        with_density = level.factor < self.levels[0] or len(self.levels) == 1
        density = self.density.faces(active=with_density)
        renderer = level.renderer(self.mesh, self.optics)
        optics = self.optics
        otf = renderer.otf(optics)
        transform = renderer.transform(vertices, density)
        rendered = level.rendered(renderer, transform, otf)
        given = renderer, transform, optics
        voxels = level.voxels(rendered.detach(), lambda other: level.with_effects(*given, other))
        result = match(voxels.of(rendered), voxels.measured, voxels.weights)
        if self.other is not None:
            result = self.other.added_to(result, level, renderer, transform)
        result.loss.backward()
        assert vertices.grad is not None
        gradient = self.mover.solve(vertices.grad.numpy())
        step = self.mover.solve(self.adam.step(gradient))
        size = self.settings.step * level.width * self.step_factor
        self.seen = self.mesh.vertices_numpy()
        moved = self.guard.limited(self.seen, self.seen - size * step)
        self.density.step(self.smoother, self.step_factor)
        moved.setflags(write=False)  # states share it
        self.bounded = result.bounded
        loss = float(result.loss.detach())
        if not np.isfinite(loss) or not np.isfinite(moved).all():
            raise FloatingPointError("the fit met a number that is not finite")
        state = self._state(level, result, kept)
        imaging = Imaging(self.optics, self.effects, self.settings.fit_psf)
        due = level.factor <= _PSF_BELOW and len(self.losses) % _PSF_EVERY == _PSF_EVERY - 1
        if due and imaging.fitted:
            fixed = None if density is None else density.detach()
            self.optics, self.effects = imaging_step(
                level,
                renderer,
                imaging,
                lambda other: other.transform(vertices.detach(), fixed),
                voxels,
                self.first_optics,
            )
            level.set_effects(self.effects)
        self.mesh = self.mesh.with_vertices(moved)
        self.iteration += 1
        self.losses.append(loss)
        return state

    def _settled(self, last: bool) -> bool:
        """Whether the level is done; at the last one the step is halved a few times before."""
        if len(self.losses) % _WINDOW:
            return False
        vertices = self.mesh.vertices_numpy()
        # Unknown across a remeshing.
        same = len(self.window_start) == len(vertices)
        shift = np.sqrt(((vertices - self.window_start) ** 2).sum(1).mean()) if same else np.inf
        self.window_start = vertices
        if len(self.losses) < 2 * _WINDOW:
            return False
        now, before = np.mean(self.losses[-_WINDOW:]), np.mean(self.losses[-2 * _WINDOW : -_WINDOW])
        gain = 1 - now / before
        tolerance = self.settings.tolerance if last else _COARSE_GAIN
        still = _STILL if last else _COARSE_STILL
        if gain > tolerance and shift > still * self.level.width * self.step_factor:
            return False
        if not last:
            return True
        self.halvings += 1
        self.step_factor /= 2
        self.losses = []
        return self.halvings > _SETTLE

    # ---------------------------------------------------------------------------- reporting

    def _state(self, level: Level, result: Match, kept: dict[str, np.ndarray]) -> FitState:
        amplitude, background = result.amplitude, result.background
        mesh, optics = self.mesh, self.optics
        density = self.density.faces_numpy()
        grid, accuracy, effects = self.grid, self.settings.image_accuracy, self.effects

        def rendered() -> np.ndarray:
            given = mesh, grid, optics, accuracy, amplitude, background
            return expected_image(*given, density=density, effects=effects)

        return FitState(
            iteration=self.iteration + 1,
            level=self.level_number + 1,
            levels=len(self.levels),
            mesh=mesh,
            optics=optics,
            density=density,
            loss=float(result.loss.detach()),
            amplitude=amplitude,
            background=background,
            effects=effects,
            blur=level.factor,
            pinned=self.pinned if self.pinned.any() else None,
            events=self.topology.events(),
            _render=rendered,
            _checkpoint=lambda: kept,
        )

    def load(self, kept: dict[str, np.ndarray]) -> None:
        """Take over a checkpoint; raises InputError if it belongs to another mesh."""
        checkpoint.take_over(self, kept)
