"""The state of a fit between iterations, and one iteration of it."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree

from ..fourier.devices import for_objects
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene import Grid, expected_image
from ..scene.effects import Effects
from ..settings import WIDE_LEVELS, FitSettings
from . import checkpoint
from .change import Change
from .collisions import CollisionGuard
from .density import DensityField
from .health import GrowthAlarm, shrunken, why_stuck
from .imaging_step import Imaging, imaging_step
from .level import Level
from .likelihood import Match, match
from .optimiser import AdamUniform
from .preconditioner import NEAR_JUNCTIONS, Preconditioner, components
from .readings import Readings, late
from .second_view import Pixels, SecondTerm
from .state import FitState
from .surface import Surface
from .topology import TopologyKeeper
from .upkeep import Upkeep

_WINDOW = 12  # iterations over which a level must gain
# A coarse level ends when its window gains less than this share of the loss, or moves the vertices
# by less than this share of its width: it only has to bring the next one within reach.
_COARSE_GAIN, _COARSE_STILL = 0.05, 0.04
_STILL = 0.02  # the same at the last level
_SETTLE = 2  # times the last level halves its step before it counts as converged
_PSF_EVERY = 5
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
        self.losses: list[float] = []  # since the level or the present step began, when last read
        self.readings = Readings()
        self.window_start = self.mesh.vertices_numpy()
        self.level_optics = self.optics  # of the blur: a fit of the PSF leaves it alone
        self.bounded = torch.tensor(False)  # whether the amplitude wanted to be negative
        self.remark = ""  # for the first state
        self.pinned = np.zeros(len(mesh.vertices), bool)
        self.kept: dict[str, np.ndarray] = {}

    @property
    def mesh(self) -> Mesh:
        """As it is now, on the host."""
        return self.surface.mesh

    @mesh.setter
    def mesh(self, mesh: Mesh) -> None:
        self.surface = Surface(mesh)

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
                ends = (finished and last) or over
                if ends:
                    self._read()
                    state = self._verdict(state, finished and last, warning)
                else:
                    told = (self.remark, self.guard.remark(), *state.events, warning)
                    state = state.saying("; ".join(filter(None, told)))
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
        rest = at_junctions, for_objects(self.level.device)
        self.smoother = Preconditioner(self.mesh, smoothing, None, *rest)
        self.mover = self.smoother
        if self.pinned.any():
            self.mover = Preconditioner(self.mesh, smoothing, self.pinned, *rest)
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
            self.topology.restart()  # to undo a change of it would bring back the pins of then
            if change.mesh is None:
                # They stay where they were seen, which is one step back.
                vertices = self.mesh.vertices_numpy().copy()
                seen = self.seen.mesh.vertices_numpy()
                vertices[self.pinned] = seen[self.pinned]
                self.mesh = self.mesh.with_vertices(self.guard.limited(seen, vertices))
        if change.optics is not None:
            self.optics = self.first_optics = change.optics.detach()
        if change.settings is not None:
            self._take_settings(change.settings)
        if change.effects is not None:
            self.effects = self.first_effects = change.effects
        blurred_for = self.level_optics
        self._enter(self.level_number)
        if (change.optics, change.settings, change.effects) != (None, None, None):
            self.topology.restart()  # the loss is another
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
        explained = 1 - min(state.loss, 1)
        points = shrunken(state.mesh, min(self.optics.sigma_um))
        stuck = why_stuck(explained, bool(self.bounded), points) if finished else ""
        message = stuck or ("converged" if finished else "")
        message = message or f"stopped after {self.iteration} iterations, before it converged"
        message += f"; {warning}" if warning else ""
        return replace(state, converged=finished and not stuck, message=message)

    def _enter(self, number: int) -> None:
        self.level_number = number
        self.level_optics = self.optics
        self.step_factor = 1.0
        self.halvings = 0
        self.losses = []
        self.readings.forget()
        self.window_start = self.mesh.vertices_numpy()
        self.adam.restart()
        self.density.restart()

    def _iterate(self) -> FitState:
        level = self.level
        if level.renews:
            self._read()
            if self.settings.remesh and not self.halvings and self.upkeep.wanted(self.mesh):
                self._remesh()
            self.topology.look(self)
            self.kept = checkpoint.kept(self)
        kept, steps = self.kept, self.steps
        start = self.surface.on(level.device)
        vertices = start.detach().requires_grad_()
        with_density = level.factor < self.levels[0] or len(self.levels) == 1
        density = self.density.faces(with_density, vertices.device)
        renderer = level.renderer(self.surface, self.optics)
        optics = self.optics
        otf = renderer.otf(optics)
        transform = renderer.transform(vertices, density)
        rendered = level.rendered(renderer, transform, otf)
        fixed = vertices.detach(), None if density is None else density.detach()
        given = renderer, transform, lambda other: other.transform(*fixed), optics
        voxels = level.voxels(rendered.detach(), lambda other: level.with_effects(*given, other))
        result = match(voxels.of(rendered), voxels.measured, voxels.weights)
        if self.other is not None:
            result = self.other.added_to(result, level, renderer, transform)
        result.loss.backward()
        assert vertices.grad is not None
        gradient = self.mover.solve(vertices.grad)
        gradient = self.density.evened(gradient, start, optics.sigma_um)
        step = self.mover.solve(self.adam.step(gradient))
        size = self.settings.step * level.width * self.step_factor
        self.seen = self.surface
        moved = self.guard.kept_apart(start, start - size * step)
        if self.density.unknown:
            seen = level.brightness(self.mesh.vertices_numpy(), rendered, result)
            self.density.estimate(seen, self.smoother)
        else:
            self.density.step(self.smoother, self.step_factor)
        self.bounded = result.bounded
        self.readings.add(renderer, result.loss, renderer.moved(moved))
        self._read(leave=late(level.device))
        state = self._state(level, result, kept)
        imaging = Imaging(self.optics, self.effects, self.settings.fit_psf)
        due = level.factor <= _PSF_BELOW and steps % _PSF_EVERY == _PSF_EVERY - 1
        if due and imaging.fitted:
            self.optics, self.effects = imaging_step(
                level,
                renderer,
                imaging,
                lambda other: other.transform(*fixed),
                voxels,
                self.first_optics,
            )
            level.set_effects(self.effects)
        self.surface = self.surface.moved(moved)
        self.iteration += 1
        return state

    @property
    def steps(self) -> int:
        """Iterations since the level or the present step began."""
        return len(self.losses) + len(self.readings)

    def _read(self, leave: int = 0) -> None:
        """Take what all iterations but the last few have left on the device."""
        for planned, (loss, far) in self.readings.read(leave):
            if not np.isfinite([loss, far]).all():
                raise FloatingPointError("the fit met a number that is not finite")
            self.losses.append(loss)
            self.level.heard(planned, far)

    def _settled(self, last: bool) -> bool:
        """Whether the level is done; at the last one the step is halved a few times before."""
        if self.steps % _WINDOW:
            return False
        self._read()
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
        self.topology.forgets(self.losses)
        self.losses = []
        return self.halvings > _SETTLE

    # ---------------------------------------------------------------------------- reporting

    def _state(self, level: Level, result: Match, kept: dict[str, np.ndarray]) -> FitState:
        surface, optics, density = self.surface, self.optics, self.density.later()
        grid, accuracy, effects = self.grid, self.settings.image_accuracy, self.effects

        loss, *scale = (t.detach() for t in (result.loss, result.amplitude, result.background))

        def values() -> dict[str, Any]:
            numbers = {"amplitude": float(scale[0]), "background": float(scale[1])}
            return {"mesh": surface.mesh, "density": density(), "loss": float(loss), **numbers}

        def rendered() -> np.ndarray:
            given = surface.mesh, grid, optics, accuracy, float(scale[0]), float(scale[1])
            return expected_image(*given, density=density(), effects=effects)

        return FitState.late(
            values,
            iteration=self.iteration + 1,
            level=self.level_number + 1,
            levels=len(self.levels),
            optics=optics,
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
