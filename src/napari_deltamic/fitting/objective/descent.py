"""Steps down a posterior: L-BFGS with backtracking, within what guards and bounds allow."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ...geometry.mesh import FloatArray
from ...geometry.vectors import lengths
from ..model.variables import Variables
from ..solvers.lbfgs import Learnt, Memory, dot
from .limits import Limits
from .metric import Metric
from .posterior import Evaluation, Posterior

# Of one step, at most: widths of the blurred PSF, log density, brightness of an inside over that of
# all, unbounded numbers of the PSF, and those of effects in units of their scale. Further away the
# objective is no parabola; in many
# effects it is. (The prototypes' caps; those of effects are wider than any of them needs.)
FAR, _FAR_DENSITY, _FAR_INSIDES, _FAR_OPTICS, _FAR_EFFECTS = 0.6, 0.5, 0.5, 0.3, 10.0
# Of the step before, how much shorter the next one is: as J. E. Dennis and R. B. Schnabel bound it
# (Numerical methods for unconstrained optimization, 1983) for backtracking by parabolas.
_LEAST_CUT, _MOST_KEPT = 0.1, 0.5
_MOVING = 1e-6  # of the longest part of a step: what is shorter is rounding, and says no proportion
_ARMIJO = 1e-4  # share of the predicted gain that a step must bring (Nocedal & Wright, 2006)
_LONGEST = 1e6  # widths: a step longer than this is shortened as a whole before it is capped
_HELD = 0.1  # of its step that guard or bounds take from a vertex which counts as held back
_SHORTER = 6  # times that a step is shortened before the past is forgotten


@dataclass(frozen=True, eq=False)
class _Cut:
    """A step, where it ends within guard and bounds, and the slope along that."""

    step: Variables
    end: Variables
    slope: float


class Descent:
    """One way down.

    Parameters
    ----------
    posterior, at
        An objective, and where to begin.
    metric
        See :class:`Metric`.
    width
        um: of the blurred PSF.
    limits
        Of each step.
    learnt
        What is known from before, of the same unknowns.

    Attributes
    ----------
    at, now
        Where it is, and the objective there.
    """

    def __init__(
        self,
        posterior: Posterior,
        at: Variables,
        metric: Metric,
        width: float,
        limits: Limits,
        learnt: Learnt | None = None,
    ) -> None:
        self._posterior, self._width, self._limits = posterior, width, limits
        self.at, self.now = at, posterior(at)
        metric.measure(posterior.imaging_curvature(at), posterior.insides_curvature(at, self.now))
        self._guess = partial(_solved, metric, at)
        self._memory = Memory(self._guess, metric.first_scale, learnt)
        self._evaluations = 1
        self._ahead: tuple[Evaluation, Variables] | None = None  # asked for twice

    def learnt(self) -> Learnt:
        """What another descent of the same unknowns may begin with."""
        return self._memory.learnt()

    def taken(self) -> int:
        """Evaluations since this was last asked."""
        taken, self._evaluations = self._evaluations, 0
        return taken

    def _evaluated(self, at: Variables) -> Evaluation:
        self._evaluations += 1
        return self._posterior(at)

    def step(self) -> bool:
        """Go one step down; False where none is found."""
        for _ in range(2):
            known = len(self._memory) > 0
            if self._search(self._feasible(self.direction())):
                return True
            if not known:
                return False
            self._forget()
        return False

    def _forget(self) -> None:
        self._memory.forget()
        self._ahead = None

    def direction(self) -> Variables:
        """The step to where the objective is thought to be least."""
        if self._ahead is None or self._ahead[0] is not self.now:
            self._ahead = self.now, self._direction(self.now.gradient)
        return self._ahead[1]

    def _direction(self, gradient: Variables) -> Variables:
        flat = gradient.flat()
        direction = self._memory.direction(flat)
        if not dot(direction, flat) < 0:  # or no number, where amplitudes all but vanish
            self._memory.forget()
            direction = -self._guess(flat, self._memory.scale)
        return self.at.with_flat(direction)

    def _feasible(self, step: Variables) -> _Cut:
        """A step that leads down although caps, guard and bounds cut it.

        Where they turn it uphill, vertices that are held back stay, as active bounds do in a
        projected quasi-Newton method (D. P. Bertsekas, 1982), and the rest finds its own way.
        """
        cut = self._cut(self._capped(step))
        if cut.slope < 0:
            return cut
        short = lengths(self.at.vertices + cut.step.vertices - cut.end.vertices)
        held = short > _HELD * lengths(cut.step.vertices)
        free = np.where(held[:, None], 0.0, 1.0)
        gradient = replace(self.now.gradient, vertices=free * self.now.gradient.vertices)
        step = self._direction(gradient)
        step = replace(step, vertices=free * step.vertices)
        cut = self._cut(self._capped(step))
        if cut.slope < 0:
            return cut
        # As a whole: all parts keep their proportions, so that it leads down.
        whole, capped = step.flat(), self._capped(step).flat()
        moving = np.abs(whole) > _MOVING * np.abs(whole).max(initial=0.0)
        share = float((capped[moving] / whole[moving]).min(initial=1.0))
        return self._cut(self.at.with_flat(share * whole))

    def _cut(self, step: Variables) -> _Cut:
        end = self._limits.within(self.at, self.at.with_flat(self.at.flat() + step.flat()))
        slope = dot(self.now.gradient.flat(), end.flat() - self.at.flat())
        return _Cut(step, end, slope)

    def _search(self, cut: _Cut) -> bool:
        share, trial = 1.0, cut.end
        start, direction = self.at.flat(), cut.step.flat()
        gradient = self.now.gradient.flat()
        for _ in range(_SHORTER):
            moved = trial.flat() - start
            predicted = dot(gradient, moved)
            found = self._evaluated(trial)
            gain = found.value - self.now.value
            down = np.isfinite(found.value) and gain <= _ARMIJO * min(predicted, 0.0)
            if down and moved.any():
                change = found.gradient.flat() - gradient
                on_surface = np.arange(len(moved)) < trial.on_surface
                self._memory.add(moved, change, on_surface)
                self.at, self.now = trial, found
                return True
            # The least of the parabola through both values and the slope.
            curved = 2 * (gain - predicted)
            better = -predicted / curved if np.isfinite(curved) and curved > 0 else _LEAST_CUT
            share *= float(np.clip(better, _LEAST_CUT, _MOST_KEPT))
            trial = self._limits.within(self.at, self.at.with_flat(start + share * direction))
        return False

    def _capped(self, step: Variables) -> Variables:
        """A step with no part longer than it may be; one wild vertex does not hold back others."""
        # Where an amplitude jumps, a step may be so long that its square is no number.
        longest = float(np.abs(step.vertices).max(initial=0.0)) / (_LONGEST * self._width)
        vertices = step.vertices / max(longest, 1.0)
        far = lengths(vertices)[:, None] / (FAR * self._width)
        optics = np.abs(step.optics).max(initial=0.0) / _FAR_OPTICS
        rest = max(optics, np.abs(step.effects).max(initial=0.0) / _FAR_EFFECTS)
        return Variables(
            vertices / np.maximum(far, 1.0),
            np.clip(step.density, -_FAR_DENSITY, _FAR_DENSITY),
            np.clip(step.insides, -_FAR_INSIDES, _FAR_INSIDES),
            step.optics / max(rest, 1.0),
            step.effects / max(rest, 1.0),
        )


def _solved(metric: Metric, like: Variables, gradient: FloatArray, scale: float) -> FloatArray:
    return metric.solve(like.with_flat(gradient), scale).flat()
