"""What the thread of a fit and its watcher share, and when something is shown."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ...fitting import FitState
from ...fitting.job import FitInput
from ...results.report import History
from .waiting import Waiting

INTERVAL = 0.033  # s between two updates of the viewer
LONGEST_REST = 0.5  # s that a slow viewer is left alone, at most
RENDER_EVERY = 0.3  # s, at least, between two rendered images
RENDER_SHARE = 0.1  # of the time of a fit may go into rendered images
RATE_OVER = 2.0  # s
FORECAST_EVERY = 0.5  # s; more often it could not be read

Verdict = Literal["converged", "ended", "stopped", "failed"]


@dataclass(frozen=True)
class Snapshot:
    """What the viewer shows of a state; nothing in it is touched by the fit any more.

    state : the last state.
    job : what is fitted.
    rendered : (Z, Y, X) float32, or None where it was not computed this time.
    iterations_per_second : lately, without pauses.
    changes : the number of the last change that it includes, see ``FitRun.change``.
    remaining : s that the fit will still take; None where that is not known.
    """

    state: FitState
    job: FitInput
    rendered: NDArray[np.float32] | None
    iterations_per_second: float
    changes: int = 0
    remaining: float | None = None


class Forecaster(Protocol):
    """Says how long a fit will still take."""

    def remaining_seconds(
        self, history: History, state: FitState, elapsed: float | None = None
    ) -> float | None:
        """s, after so many s (without pauses); None while nothing is known."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended: the verdict, in plain words too, and the last good state if any.

    message : its first line is the verdict; each of those after it is a remark.
    """

    verdict: Verdict
    message: str
    state: FitState | None = None
    job: FitInput | None = None
    seconds: float = 0.0


@dataclass
class Course:
    """What the thread and its watcher share; each field is written by one of them."""

    # by the watcher
    paused: bool = False
    shown: bool = True  # whether the last snapshot has been drawn
    rest_until: float = 0.0  # no snapshot before
    render: bool = True
    interval: float = INTERVAL
    # by both, under a lock of its own
    waiting: Waiting = field(default_factory=Waiting)
    # by the thread
    job: FitInput | None = None
    forecast: Forecaster | None = None
    state: FitState | None = None
    history: History = field(default_factory=History)
    seconds: float = 0.0
    stage: str = "starting"
    messages: list[str] = field(default_factory=list)
    changes: int = 0  # the number of the last change taken over

    def drawn(self, began: float) -> None:
        """The viewer has drawn the last snapshot, which it was given at a time."""
        now = time.monotonic()
        # Drawing without a GPU takes the cores that the fit needs.
        self.rest_until = now + rest_after(now - began)
        self.shown = True


def rest_after(drawing: float) -> float:
    """s that a viewer is left alone that took so long (s) to draw."""
    # Ten updates a second come first, as long as the fit gets a quarter of the cores.
    return min(2 * drawing, max(0.1 - drawing, 0.3 * drawing), LONGEST_REST)


class Clock:
    """Decides when a snapshot, and when a rendered image, is due."""

    def __init__(self) -> None:
        self._next = self._next_render = self._next_forecast = 0.0
        self._left: float | None = None
        self._lately: deque[tuple[float, int]] = deque()  # seconds of fitting, iterations

    def snapshot(self, state: FitState, course: Course, *, must: bool = False) -> Snapshot | None:
        rate, now = self._rate(course), time.monotonic()
        # A viewer that draws slowly gets fewer snapshots, not a queue of them.
        early = now < max(self._next, course.rest_until)
        if course.job is None or (not must and (early or not course.shown)):
            return None
        rendered = None
        if course.render and (must or now >= self._next_render):
            rendered = state.rendered()
            cost = time.monotonic() - now
            self._next_render = time.monotonic() + max(RENDER_EVERY, cost / RENDER_SHARE)
        self._next = time.monotonic() + course.interval
        course.shown = False
        return Snapshot(
            state, course.job, rendered, rate, course.changes, self._remaining(state, course)
        )

    def _remaining(self, state: FitState, course: Course) -> float | None:
        now = time.monotonic()
        if course.forecast is not None and now >= self._next_forecast:
            self._next_forecast = now + FORECAST_EVERY
            self._left = course.forecast.remaining_seconds(course.history, state, course.seconds)
        return self._left

    def _rate(self, course: Course) -> float:
        """Iterations a second, lately: levels differ in speed."""
        lately = self._lately
        lately.append((course.seconds, len(course.history.loss)))
        while len(lately) > 2 and lately[-1][0] - lately[1][0] > RATE_OVER:
            lately.popleft()
        seconds, count = (b - a for a, b in zip(lately[0], lately[-1], strict=True))
        return count / seconds if seconds > 0 else 0.0
