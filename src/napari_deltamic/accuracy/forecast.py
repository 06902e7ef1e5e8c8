"""How long a fit will take, before it starts and while it runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..evidence.effect_cost import milliseconds
from ..fitting import FitState
from ..fitting.history import History
from ..fitting.model.checks import FEWEST_VOXELS
from ..fitting.model.default_accuracy import accuracy_for_image
from ..fitting.model.level import level_shape
from ..fourier.cost import Costs
from ..fourier.plan import Method
from ..geometry.contacts import contacts
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..runs.settings import WIDE_LEVELS, FitSettings
from ..scene import Grid, Renderer, Scene
from ..scene.effects import Effects, as_effects
from .experience import Experience
from .iteration_costs import (
    FORECAST,
    iteration_seconds,
    iterations_of,
    near_voxels,
    posing_of,
    preparation_seconds,
    seen_voxels,
)
from .machine_costs import costs as known_costs

_NOTHING = Experience()


@dataclass(frozen=True)
class LevelForecast:
    """What one level of a fit is expected to take.

    Attributes
    ----------
    number
        Its number, from 1.
    blur
        Width to which both images are blurred, in widths of the PSF.
    shape
        Shape of its grid, voxels.
    method, accuracy
        How its images are rendered.
    seconds_per_iteration, iterations, preparation
        s; a number; s before the first iteration.
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
        """Seconds that the whole level takes."""
        return self.preparation + self.iterations * self.seconds_per_iteration


@dataclass(frozen=True)
class Forecast:
    """What a fit is expected to take, level by level.

    Attributes
    ----------
    levels
        The levels that will be run.
    measured
        Whether the costs were measured on this machine, rather than on another one.
    kind
        Kind of the fit: fits of one kind need similar numbers of iterations.
    learned
        Experience from earlier fits, already included in the levels.
    """

    levels: tuple[LevelForecast, ...]
    measured: bool
    kind: str = ""
    learned: Experience = _NOTHING

    @property
    def seconds(self) -> float:
        """Seconds until the fit has converged."""
        return sum(level.seconds for level in self.levels)

    @property
    def iterations(self) -> int:
        """Iterations until the fit has converged."""
        return sum(level.iterations for level in self.levels)

    @property
    def seconds_per_iteration(self) -> float:
        """Seconds of an iteration at the last level, where most of the time goes."""
        return self.levels[-1].seconds_per_iteration

    def remaining_seconds(
        self, history: History, state: FitState, elapsed: float | None = None
    ) -> float | None:
        """Seconds until the fit has converged; None while that is not known yet, or no longer.

        Parameters
        ----------
        history
            History of the fit, of which the levels of all iterations so far are used.
        state
            The latest state.
        elapsed
            s since the fit began. The forecast is scaled by how much longer than expected the
            iterations so far have taken; without it, the forecast is used unscaled.
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
                here = _count(history, level.number)
                if level is self.levels[-1] and here > FORECAST.unknown * level.iterations:
                    return None
                left += each * _still_to_come(here, wanted)
        if spent <= 0:
            return None
        # Trusted the more, the longer the fit has run: a first iteration says little.
        pace = 1.0
        if elapsed is not None:
            trust = done / (done + FORECAST.trusted)
            pace = float((elapsed / spent) ** trust)
        return left * pace

    def experience(self, history: History, state: FitState, elapsed: float) -> Experience | None:
        """What the fit of this forecast teaches about the next; None if nothing.

        Parameters
        ----------
        history, state
            As above, when the fit has ended.
        elapsed
            s that the fit took.
        """
        spent = self._spent(history)
        if len(history.level) < FORECAST.teach or spent <= 0 or elapsed <= 0:
            return None
        done, wanted = self._done(history, state.level, ended=state.converged)
        more = done / wanted if wanted else 1.0
        known = self.learned
        seconds, iterations = known.seconds * elapsed / spent, known.iterations * more
        return Experience(_within(seconds), _within(iterations), single=state.converged)

    def after(self, earlier: Experience) -> Forecast:
        """The forecast corrected by how far off earlier forecasts were."""
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

    def _spent(self, history: History) -> float:
        """Seconds that the iterations so far should have taken."""
        counts = ((level, _count(history, level.number)) for level in self.levels)
        return sum(a.preparation + n * a.seconds_per_iteration for a, n in counts if n)

    def _done(self, history: History, present: int, *, ended: bool = False) -> tuple[int, int]:
        """Iterations of the levels so far, and how many had been expected of them.

        The present level counts as far as it has come, unless it has ended, too.
        """
        done = wanted = 0
        for level in self.levels:
            here = _count(history, level.number)
            if level.number <= present:
                over = ended or level.number < present
                done += here
                wanted += level.iterations if over else min(here, level.iterations)
        return done, wanted

    def _more(self, history: History, present: int) -> float:
        """Factor by which levels need more iterations than expected, judged by those so far."""
        done, wanted = self._done(history, present)
        if not done or not wanted:
            return 1.0
        return float((done / wanted) ** (wanted / (wanted + FORECAST.first)))


@dataclass(frozen=True)
class RenewedForecast:
    """The forecast of a fit whose settings were changed on the way; it ignores the time before.

    Attributes
    ----------
    forecast
        Forecast of a whole fit with the new settings.
    iterations, seconds
        Iterations and time (s, without pauses) that the fit had taken when they were changed.
    """

    forecast: Forecast
    iterations: int
    seconds: float

    def remaining_seconds(
        self, history: History, state: FitState, elapsed: float | None = None
    ) -> float | None:
        """Seconds until the fit has converged; None while that is not known."""
        left = self.forecast.remaining_seconds(history, state)
        if left is None or elapsed is None:
            return left
        # Only the iterations since the change tell how far off the new forecast is.
        since = History(level=history.level[self.iterations :])
        plain = self.forecast.remaining_seconds(since, state)
        scaled = self.forecast.remaining_seconds(since, state, elapsed - self.seconds)
        return left * scaled / plain if plain and scaled is not None else left


Forecaster = Forecast | RenewedForecast  # says how long a fit will still take


def _count(history: History, number: int) -> int:
    """Number of iterations that a level has had."""
    return sum(1 for one in history.level if one == number)


def _within(factor: float) -> float:
    return min(max(factor, 1 / FORECAST.farthest), FORECAST.farthest)


def _still_to_come(here: int, expected: float) -> float:
    """Iterations left at a level that has had ``here`` of ``expected``; never zero.

    A level that goes on beyond what was expected is taken to need a window or a tenth more.
    """
    return float(max(expected - here, FORECAST.window, FORECAST.more * here))


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
        As :func:`napari_deltamic.fit` takes them. The image is used only if the settings leave the
        accuracy to its noise.
    costs
        Costs of this machine; by default those kept from an earlier measurement, if any
        (``machine_costs.costs(measure=True)`` measures them, in about a second).
    touching
        Whether cells touch, if the mesh is only about as large as they are; None: as in the mesh.

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
    share = 1.0 if counted is None else float(np.mean(np.asarray(counted, dtype=bool)))
    found: list[LevelForecast] = []
    tried = settings.topology and settings.collisions and settings.trials
    tried = tried and (bool(contacts(mesh)) if touching is None else touching)
    cells = len(mesh.region_ids()) if tried else 0
    for number, factor in enumerate(factors, 1):
        shape = level_shape(grid, optics, settings, factor)
        voxels = seen_voxels(shape, grid) * share
        if voxels < FEWEST_VOXELS and number < len(factors):
            continue
        near = min(voxels, near_voxels(shape.grid, optics, settings.reach, factor, mesh))
        plan = Renderer(
            Scene.of(mesh, optics, chosen),
            shape.grid,
            shape.accuracy,
            blur=shape.blur,
            frame=grid,
            margin=2 * shape.width,
        ).plan
        each = iteration_seconds(costs, plan, shape, mesh, near, settings, factor)
        further = sum(milliseconds(e, plan, shape.grid, costs) for e in chosen.present())
        each += further / 1e3
        begun = FORECAST.begun_last if number == len(factors) else FORECAST.begun
        found.append(
            LevelForecast(
                number=number,
                blur=factor,
                shape=shape.grid.shape,
                method=plan.method,
                accuracy=shape.accuracy,
                seconds_per_iteration=posing_of(number, len(factors)) * each,
                iterations=iterations_of(settings, factors, number, not found, cells),
                preparation=preparation_seconds(costs, shape, grid, mesh) + begun * each,
            )
        )
    if sum(level.iterations for level in found) > settings.max_iterations:
        found = _cut(found, settings.max_iterations)
    blurs = "-".join(f"{factor:g}" for factor in factors)
    meeting = "touching" if tried else "apart"
    kind = f"{blurs} {meeting} {settings.density}{' psf' * settings.fit_psf}"
    return Forecast(tuple(found), costs.measured, kind)


def _cut(levels: Sequence[LevelForecast], most: int) -> list[LevelForecast]:
    """The levels, cut short to take ``most`` iterations in all."""
    found = []
    for level in levels:
        if most <= 0:
            break
        found.append(replace(level, iterations=min(level.iterations, most)))
        most -= level.iterations
    return found
