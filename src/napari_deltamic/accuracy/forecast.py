"""How long a fit will take, before it runs and while it does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import Protocol

import numpy as np

from ..evidence.effect_cost import milliseconds
from ..fitting.checks import FEWEST_VOXELS
from ..fitting.default_accuracy import accuracy_for_image
from ..fitting.level import LevelShape, level_shape
from ..fourier.cost import Costs, Work
from ..fourier.plan import Method, Plan
from ..geometry.contacts import contacts
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..runs.settings import WIDE_LEVELS, FitSettings
from ..scene import Grid, Renderer, Scene
from ..scene.effects import Effects, as_effects
from .experience import Experience
from .machine_costs import costs as known_costs

# Iterations of a level, from measured fits with other settings by default: cow and fish at 64^3
# from a sphere, without noise and with 40 and 10 photons, levels 5 to 1: 10 to 20, then 30 each,
# and 20 to 50 at the end; foams of 4 to 16 cells, levels 2 to 1: 32, 27 to 32, 15 to 50.
_FIRST, _COARSE, _LAST = 20, 30, 35
_NEAR_COARSE, _NEAR_LAST = 25, 35  # where the seeds lie near the membranes
# Where cells touch, other neighbours are tried at the end: foams of 8, 16 and 32 cells took 182,
# 225 and 218 iterations from labels, an embryo of 56 cells 225.
_NEIGHBOURS = 200
_NEAR_BLUR = 2.0  # first blur below which they do
_FREER = 1.3  # times the last level where density or PSF are fitted as well
# What an iteration does besides the rendering, as multiples of what was measured alone.
_SOLVES = 3.0  # two of the preconditioner, and the steps between
_APART = 5.0  # solves: keeping surfaces from crossing
_OVERHEAD = 1.0  # calls: what takes the same time however small the scene
_FACTORING = 100.0  # solves: of the preconditioner's matrix
_TRUNCATED = 3.5  # standard deviations; see level.py
_EVERY_PLAN, _EVERY_LOOK = 20, 10  # iterations; see level.py
_EVERY_PSF, _PSF_BELOW = 5, 2.5  # iterations, blur; see fit.py
_TEACH = 5  # iterations without which a fit teaches nothing
_NOTHING = Experience()
_FARTHEST = 30.0  # as a forecast can be off at most; what is more was something else


class FitHistory(Protocol):
    """The course of a fit so far, as :class:`napari_deltamic.results.report.History` keeps it."""

    level: list[int]
    first: int


class Where(Protocol):
    """Where a fit is, as a :class:`FitState` says it."""

    @property
    def level(self) -> int: ...
    @property
    def converged(self) -> bool: ...


@dataclass(frozen=True)
class LevelForecast:
    """What one level of a fit is expected to take.

    Attributes
    ----------
    number
        Counts from 1.
    blur
        Width of both images, in widths of the PSF.
    shape
        Of its grid, voxels.
    method, accuracy
        Of its images.
    seconds_per_iteration, iterations, preparation
        s, a number, s: the last is the time before the first iteration.
    """

    number: int
    blur: float
    shape: tuple[int, int, int]
    method: Method
    accuracy: float
    seconds_per_iteration: float
    iterations: int
    preparation: float

    @property
    def seconds(self) -> float:
        """Of the whole level."""
        return self.preparation + self.iterations * self.seconds_per_iteration


@dataclass(frozen=True)
class Forecast:
    """What a fit is expected to take, level by level.

    Attributes
    ----------
    levels
        Those that will be run.
    measured
        Whether the costs were measured on this machine, or are those of another one.
    kind
        Of the fit: those of one kind need like numbers of iterations.
    learned
        From earlier fits, which is in the levels already.
    """

    levels: tuple[LevelForecast, ...]
    measured: bool
    kind: str = ""
    learned: Experience = _NOTHING

    @property
    def seconds(self) -> float:
        """Until the fit has converged."""
        return sum(level.seconds for level in self.levels)

    @property
    def iterations(self) -> int:
        """Until the fit has converged."""
        return sum(level.iterations for level in self.levels)

    @property
    def seconds_per_iteration(self) -> float:
        """Of the last level, where most of the time goes."""
        return self.levels[-1].seconds_per_iteration

    def remaining_seconds(
        self, history: FitHistory, state: Where, elapsed: float | None = None
    ) -> float | None:
        """Seconds until the fit has converged; None while nothing is known.

        Parameters
        ----------
        history
            The levels of all iterations so far.
        state
            The latest one.
        elapsed
            s since the fit began. The forecast is scaled by how much longer than expected the
            iterations so far have taken; without it, the forecast is taken as it is.
        """
        done = len(history.level)
        if state.converged:
            return 0.0
        if done < 2 or (elapsed is not None and elapsed <= 0):
            return None
        spent, left, more = self._spent(history), 0.0, self._more(history, state.level)
        for level in self.levels:
            each, wanted = level.seconds_per_iteration, more * level.iterations
            if level.number > state.level:
                left += level.preparation + wanted * each
            elif level.number == state.level:
                left += each * _still_to_come(_count(history, level.number), wanted)
        if spent <= 0:
            return None
        # Trusted the more, the longer the fit has run: a first iteration says little.
        pace = 1.0
        if elapsed is not None:
            trust = done / (done + 5.0)
            pace = float((elapsed / spent) ** trust)
        return left * pace

    def experience(self, history: FitHistory, state: Where, elapsed: float) -> Experience | None:
        """What a fit of which this is the forecast teaches about the next; None if nothing.

        Parameters
        ----------
        history, state
            As above, when it has ended.
        elapsed
            s that it took.
        """
        spent = self._spent(history)
        if len(history.level) < _TEACH or spent <= 0 or elapsed <= 0:
            return None
        done, wanted = self._done(history, state.level, ended=state.converged)
        more = done / wanted if wanted else 1.0
        known = self.learned
        seconds, iterations = known.seconds * elapsed / spent, known.iterations * more
        return Experience(_within(seconds), _within(iterations))

    def after(self, earlier: Experience) -> Forecast:
        """The same, corrected by how far off earlier ones were."""
        more = earlier.iterations
        levels = [
            replace(
                level,
                seconds_per_iteration=earlier.seconds * level.seconds_per_iteration,
                preparation=earlier.seconds * level.preparation,
                iterations=max(1, round(more * level.iterations)),
            )
            for level in self.levels
        ]
        return replace(self, levels=tuple(levels), learned=earlier)

    def _spent(self, history: FitHistory) -> float:
        """Seconds that the iterations so far should have taken."""
        counts = ((level, _count(history, level.number)) for level in self.levels)
        return sum(a.preparation + n * a.seconds_per_iteration for a, n in counts if n)

    def _done(self, history: FitHistory, present: int, *, ended: bool = False) -> tuple[int, int]:
        """Iterations of the levels that are over, and how many had been expected of them.

        The present level counts as far as it has come, unless it has ended too.
        """
        done = wanted = 0
        for level in self.levels:
            here = _count(history, level.number)
            if level.number <= present:
                over = ended or level.number < present
                done += here
                wanted += level.iterations if over else min(here, level.iterations)
        return done, wanted

    def _more(self, history: FitHistory, present: int) -> float:
        """Iterations that the levels need, in parts of what was expected, by those so far."""
        done, wanted = self._done(history, present)
        if not done or not wanted:
            return 1.0
        return float((done / wanted) ** (wanted / (wanted + _FIRST)))


def _count(history: FitHistory, number: int) -> int:
    """Iterations that a level has had."""
    return sum(1 for one in history.level if one == number)


def _within(factor: float) -> float:
    return min(max(factor, 1 / _FARTHEST), _FARTHEST)


def _still_to_come(here: int, expected: float) -> float:
    """Iterations left at a level that has had ``here`` of ``expected``; never quite none.

    One that goes on beyond what was expected is taken to need a window or a tenth more.
    """
    return float(max(expected - here, 12, 0.1 * here))


def forecast(
    image: np.ndarray,
    grid: Grid,
    mesh: Mesh,
    optics: Optics,
    settings: FitSettings,
    counted: np.ndarray | None = None,
    effects: Effects | Sequence[str] = (),
    costs: Costs | None = None,
    touching: bool | None = None,
) -> Forecast:
    """What a fit with these arguments is expected to take; nothing is rendered.

    Parameters
    ----------
    image, grid, mesh, optics, settings, counted, effects
        As :func:`napari_deltamic.fit` takes them. The image is looked at only where the settings
        leave the accuracy to its noise.
    costs
        Of this machine; by default those kept from an earlier measurement, if any
        (``machine_costs.costs(measure=True)`` measures them, in about a second).
    touching
        Whether cells touch, where the mesh only is about as large as they are; None: see the mesh.

    Raises
    ------
    InputError
        If the mesh is so far from the grid that its units must be wrong.
    """
    costs = costs or known_costs()
    if settings.accuracy is None:
        settings = settings.model_copy(update={"accuracy": accuracy_for_image(image)})
    chosen = as_effects(effects)
    factors = settings.levels or WIDE_LEVELS
    surface = _surface(mesh)
    share = 1.0 if counted is None else float(np.mean(np.asarray(counted, dtype=bool)))
    found: list[LevelForecast] = []
    tried = settings.topology and settings.collisions
    tried = tried and (bool(contacts(mesh)) if touching is None else touching)
    for number, factor in enumerate(factors, 1):
        shape = level_shape(grid, optics, settings, factor)
        voxels = _seen(shape, grid) * share
        if voxels < FEWEST_VOXELS and number < len(factors):
            continue
        near = min(voxels, _near(shape.grid, optics, settings.reach, factor, surface))
        plan = Renderer(
            Scene.of(mesh, optics, chosen),
            shape.grid,
            shape.accuracy,
            blur=shape.blur,
            frame=grid,
            margin=2 * shape.width,
        ).plan
        each = _iteration(costs, plan, shape, mesh, near, settings, factor)
        each += sum(milliseconds(e, plan, shape.grid, costs) for e in chosen.present()) / 1e3
        found.append(
            LevelForecast(
                number=number,
                blur=factor,
                shape=shape.grid.shape,
                method=plan.method,
                accuracy=shape.accuracy,
                seconds_per_iteration=each,
                iterations=_iterations(settings, factors, number, not found, tried),
                preparation=_preparation(costs, shape, grid, mesh),
            )
        )
    if sum(level.iterations for level in found) > settings.max_iterations:
        found = _cut(found, settings.max_iterations)
    blurs = "-".join(f"{factor:g}" for factor in factors)
    cells = "touching" if tried else "apart"
    kind = f"{blurs} {cells} {settings.density}{' psf' * settings.fit_psf}"
    return Forecast(tuple(found), costs.measured, kind)


def _cut(levels: Sequence[LevelForecast], most: int) -> list[LevelForecast]:
    """The levels that fit into so many iterations."""
    found = []
    for level in levels:
        if most <= 0:
            break
        found.append(replace(level, iterations=min(level.iterations, most)))
        most -= level.iterations
    return found


def _iterations(
    settings: FitSettings, factors: Sequence[float], number: int, first: bool, tried: bool
) -> int:
    """Expected of a level; tried : whether other neighbours are."""
    near = factors[0] < _NEAR_BLUR
    if number < len(factors):
        return _NEAR_COARSE if near else _FIRST if first else _COARSE
    if tried:
        return _NEIGHBOURS
    free = settings.fit_psf or settings.density != "uniform"
    return round((_NEAR_LAST if near else _LAST) * (_FREER if free else 1.0))


def _iteration(
    costs: Costs,
    plan: Plan,
    shape: LevelShape,
    mesh: Mesh,
    near: float,
    settings: FitSettings,
    factor: float,
) -> float:
    """Seconds of one iteration, what is done every few of them included."""
    vertices, voxels = len(mesh.vertices), prod(shape.grid.shape)
    call = costs.rates(plan.single, True).call
    seconds = costs.seconds(plan.work, plan.single) + _OVERHEAD * call
    seconds += near * costs.voxel + _SOLVES * vertices * costs.vertex
    if settings.collisions:
        seconds += _APART * vertices * costs.vertex
    if settings.density == "smooth":
        seconds += _SOLVES / 2 * vertices * costs.vertex + call / 2
    seconds += (len(mesh.faces) * costs.face + call) / _EVERY_PLAN
    seconds += voxels * costs.voxel / _EVERY_LOOK
    if settings.fit_psf and factor <= _PSF_BELOW:
        image = costs.rates(plan.single, False).seconds(Work(pixels=plan.work.pixels))
        seconds += (4 * image + 8 * near * costs.voxel) / _EVERY_PSF
    return seconds


def _preparation(costs: Costs, shape: LevelShape, grid: Grid, mesh: Mesh) -> float:
    """Seconds before the first iteration of a level: blurred images, plan, preconditioner."""
    taps = 2 * _TRUNCATED * np.divide(shape.blur, grid.voxel_size).sum() + 3
    blurred = 2 * prod(grid.shape) * taps * costs.tap if any(shape.blur) else 0.0
    return float(
        blurred + len(mesh.faces) * costs.face + _FACTORING * len(mesh.vertices) * costs.vertex
    )


def _seen(shape: LevelShape, grid: Grid) -> float:
    """Voxels of a level whose blur rests mostly on the image: not those at its rim."""
    n = np.array(grid.shape) - 0.5 * np.divide(shape.blur, grid.voxel_size)
    return float(np.prod(np.maximum(n, 0) / shape.step))


def _surface(mesh: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Areas (F,) um^2, unit normals (F, 3), and sides of the box around it (3,) um."""
    v = mesh.vertices_numpy()
    corners = v[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(normal, axis=1)
    return doubled / 2, normal / np.maximum(doubled, 1e-300)[:, None], np.ptp(v, axis=0)


def _near(
    grid: Grid,
    optics: Optics,
    reach: float,
    factor: float,
    surface: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> float:
    """Voxels of a grid within reach of a surface, about."""
    areas, normals, sides = surface
    sigma = factor * np.asarray(optics.sigma_um)
    along = np.sqrt(((normals * sigma) ** 2).sum(1)).clip(1e-12)
    # Where the image of a flat piece falls to what level.py asks for.
    distance = along * np.sqrt(reach**2 + 2 * np.log(sigma.max() / along))
    shell = 2 * float(areas @ distance)
    around = float(np.prod(sides + 2 * reach * sigma))
    return min(shell, around) / float(np.prod(grid.voxel_size))
