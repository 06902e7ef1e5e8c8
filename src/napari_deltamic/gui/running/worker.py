"""A fit as a task: what its thread does, and what of that is shown."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...accuracy.forecast import Forecast, Forecaster, RenewedForecast
from ...common.doing import listening
from ...errors import InputError
from ...fitting import Change, FitState
from ...fitting.history import History
from ...fitting.job import FitInput, following, scene_with, start
from ...fitting.pending import Waiting, usable
from ..window_words import words_of
from ..work import Outcome, Task

RENDER_EVERY = 0.3  # s, at least, between two rendered images
RENDER_SHARE = 0.1  # of the time of a fit may go into rendered images
SNAPSHOT_EVERY = 0.03  # s
RATE_OVER = 2.0  # s
FORECAST_EVERY = 0.5  # s; more often it could not be read


@dataclass(frozen=True, eq=False)
class Snapshot:
    """What the viewer shows of a state; nothing in it is touched by the fit any more.

    state : the last state.
    job : what is fitted.
    rendered : (Z, Y, X) float32, or None where it was not computed this time.
    iterations_per_second : lately, without pauses.
    changes : the number of the last change that it includes, see ``FitRun.waiting``.
    remaining : s that the fit will still take; None where that is not known.
    """

    state: FitState
    job: FitInput
    rendered: NDArray[np.float32] | None
    iterations_per_second: float
    changes: int = 0
    remaining: float | None = None


class FitRun(Task):
    """One run of a fit, from its start to its outcome.

    Parameters
    ----------
    prepare : puts the fit together, in the thread.
    on_snapshot : called with the newest snapshot, and with each that a change led to.
    on_end : called once with the outcome, unless the run was closed.
    on_refusal : called with the reason why a change was not taken over.
    forecaster : makes what forecasts how long a fit will take, in the thread.
    first : what the fit is told after its first iteration: pinned vertices, for example.

    Attributes
    ----------
    waiting : changes from which the fit goes on, from its next iteration on. Snapshots tell by its
        number whether they include one. What cannot be used is refused with a note, and the fit
        goes on without it. Pins are of a mesh, which the fit may have remeshed by then.
    """

    title = "a fit is running"
    kept = "A fit is running. Its meshes stay in the viewer; its table and history are lost."

    def __init__(
        self,
        prepare: Callable[[], FitInput],
        on_snapshot: Callable[[Snapshot], None],
        on_end: Callable[[Outcome], None],
        on_refusal: Callable[[str], None],
        forecaster: Callable[[FitInput], Forecaster | None],
        first: Change | None = None,
    ) -> None:
        super().__init__()
        self._prepare, self._forecaster = prepare, forecaster
        self._on_snapshot, self._on_end, self._on_refusal = on_snapshot, on_end, on_refusal
        self.waiting = Waiting()
        if first is not None:
            self.waiting.add(first)
        self.render = False  # whether snapshots should bring rendered images
        self._refusals: deque[str] = deque()
        self._marked: deque[Snapshot] = deque()  # those that a change led to
        self._newest: Snapshot | None = None
        # By the thread: what is fitted, with the settings as they are now, how far it has come, and
        # how long that took without pauses, s.
        self.job: FitInput | None = None
        self.forecast: Forecaster | None = None
        self.first_forecast: Forecaster | None = None  # before anything was changed
        self.settings_changed = False  # by the user, on the way
        self.reached: tuple[FitState, int] | None = None  # and the last change that it includes
        self.history = History()
        self.seconds = 0.0
        self.stage = "starting"
        self._messages: list[str] = []
        self._changes = 0  # the number of the last change taken over
        self._due = self._render_due = self._forecast_due = 0.0
        self._left: float | None = None
        self._lately: deque[tuple[float, int]] = deque()  # s of fitting, iterations

    @property
    def state(self) -> FitState | None:
        """The newest state; None before there is one."""
        reached = self.reached
        return None if reached is None else reached[0]

    @property
    def left(self) -> Change | None:
        """After the end: a change that came too late for the fit."""
        state, taken = self.state, self.waiting.take()
        return None if taken is None or state is None else taken.on(state.mesh)

    def look(self) -> None:
        while self._refusals:
            self._on_refusal(self._refusals.popleft())
        while self._marked:
            self._on_snapshot(self._marked.popleft())
        newest, self._newest = self._newest, None
        if newest is not None:
            self._on_snapshot(newest)

    def end(self, outcome: Outcome | None) -> None:
        self._on_end(outcome or Outcome("stopped", "stopped"))

    def failed(self, error: Exception) -> Outcome:
        shape = self.job.grid.shape if self.job else None
        return Outcome("failed", words_of(error, shape))

    # ------------------------------------------------------------------------------- the thread

    def steps(self) -> Generator[None, None, Outcome]:
        """Run the fit in the thread; yields after every iteration."""
        self.stage = "preparing the seeds"
        with listening(self.step):
            job = self.job = self._prepare()
        yield
        self.forecast = self.first_forecast = self._forecaster(job)
        self.stage = "fitting"
        yield from self._fit(job)
        state = self.state
        if state is None:
            return Outcome("failed", "the fit ended before its first iteration")
        # The last message is the verdict in words; those before it are remarks made on the way.
        told = self._messages
        words = [*told[-1:], *told[:-1]] if state.message else ["ended"]
        message = "\n".join(dict.fromkeys(words))
        return Outcome("converged" if state.converged else "ended", message)

    def _fit(self, job: FitInput) -> Generator[None]:
        began, waited = time.monotonic(), 0.0
        states: Any = start(job)
        change: Change | None = None
        with listening(self.step):
            state = next(states, None)
        while state is not None:
            self.reached = state, self._changes  # both at once: the main thread looks whenever
            self._follow(state)
            self._messages += [state.message] if state.message else []
            self.history.add(state)
            self.seconds = time.monotonic() - began - waited
            self._publish(state, marked=change is not None)
            yield
            pause = time.monotonic()
            if self.paused:
                self._publish(state, must=True)
                self.stage = "paused"
            while self.paused and not self.waiting.any and not self.stopping:
                time.sleep(0.02)
                yield
            self.stage = "fitting"
            waited += time.monotonic() - pause
            change = self._taken(state)
            with listening(self.step):
                try:
                    state = states.send(change)
                except StopIteration:
                    state = None
        if self.state is not None:
            self._publish(self.state, must=True)

    def _follow(self, state: FitState) -> None:
        """Update job and forecast if the fit has started again with another kind of PSF."""
        before = self.job
        assert before is not None
        self.job = following(before, state)
        if self.job is not before:
            self._forecast_anew(self.job)

    def _publish(self, state: FitState, *, marked: bool = False, must: bool = False) -> None:
        """Hand a state to the main thread if it is time, and always if a change led to it."""
        rate, now = self._rate(), time.monotonic()
        if self.job is None or (now < self._due and not marked and not must):
            return
        self._due = now + SNAPSHOT_EVERY
        rendered = None
        if self.render and (must or now >= self._render_due):
            rendered = state.rendered()
            cost = time.monotonic() - now
            self._render_due = time.monotonic() + max(RENDER_EVERY, cost / RENDER_SHARE)
        elif self._newest is not None:
            rendered = self._newest.rendered  # that nobody has seen yet
        left = self._remaining(state, now)
        snapshot = Snapshot(state, self.job, rendered, rate, self._changes, left)
        if marked:
            self._marked.append(snapshot)
        else:
            self._newest = snapshot

    def _remaining(self, state: FitState, now: float) -> float | None:
        if self.forecast is not None and now >= self._forecast_due:
            self._forecast_due = now + FORECAST_EVERY
            self._left = self.forecast.remaining_seconds(self.history, state, self.seconds)
        return self._left

    def _rate(self) -> float:
        """Recent iterations per second, as levels differ in speed."""
        lately = self._lately
        lately.append((self.seconds, len(self.history.loss)))
        while len(lately) > 2 and lately[-1][0] - lately[1][0] > RATE_OVER:
            lately.popleft()
        seconds, count = (b - a for a, b in zip(lately[0], lately[-1], strict=True))
        return count / seconds if seconds > 0 else 0.0

    def _taken(self, state: FitState) -> Change | None:
        """The waiting change, if any; if it is refused, the reason is told."""
        taken, job = self.waiting.take(), self.job
        if taken is None or job is None:
            return None
        self._changes = taken.number
        try:
            change = taken.on(state.mesh)
            usable(change, state.mesh, state.optics, job)
        except InputError as error:
            self._refusals.append(f"not changed: {error}")
            return None
        # For whoever saves or repeats the fit: as it is done now.
        if change.settings is not None:
            self.settings_changed = True
            planned = {"levels": job.settings.fit.levels}
            job = job.with_settings(fit=change.settings.model_copy(update=planned))
            self._forecast_anew(job)
        if change.effects is not None:
            update = {"effects": change.effects}
            job = job.with_settings(scene=job.settings.scene.model_copy(update=update))
        if change.optics is not None:
            job = job.with_settings(scene=scene_with(job.settings.scene, change.optics))
        self.job = job
        return change

    def _forecast_anew(self, job: FitInput) -> None:
        """Forecast what is left of the fit after a change of settings, with the new ones."""
        found = self._forecaster(job)
        if isinstance(found, Forecast):
            self.forecast = RenewedForecast(found, len(self.history.level), self.seconds)
