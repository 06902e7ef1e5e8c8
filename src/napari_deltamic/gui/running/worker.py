"""A fit in a background thread: what it shows, and how it is paused, stopped and ended."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QTimer

from ...accuracy.forecast import Forecast, forecast
from ...errors import TOLD, InputError
from ...fitting import Change, FitState
from ...fitting.job import FitInput, scene_with, start
from ...geometry import Mesh
from ...results.report import History
from ...runs.settings import FitSettings, SceneSettings
from ...scene.effects import Effects
from ..accuracy.renewed_forecast import RenewedForecast
from ..attempt import words_of
from ..background import BackgroundRun, BackgroundSteps
from .run_progress import Clock, Course, Forecaster, Outcome, Snapshot, Verdict
from .waiting import usable


class FitRun(BackgroundRun):
    """One run of a fit, from its start to its outcome. Made and used on the main thread.

    Parameters
    ----------
    prepare : puts the fit together, in the thread.
    on_snapshot : called with each snapshot, at most every 33 ms and never before the last
        was drawn.
    on_end : called once with the outcome, unless the run was closed.
    on_note : called with warnings that are meant for users.
    on_refusal : called with the reason why a change was not taken over.
    forecaster : makes what forecasts how long a fit will take, in the thread; None for none.
    first : what the fit is told after its first iteration: pinned vertices, for example.
    """

    def __init__(
        self,
        prepare: Callable[[], FitInput],
        on_snapshot: Callable[[Snapshot], None],
        on_end: Callable[[Outcome], None],
        on_note: Callable[[str], None],
        on_refusal: Callable[[str], None],
        forecaster: Callable[[FitInput], Forecaster | None] | None = None,
        first: Change | None = None,
    ) -> None:
        self._course = Course()
        if first is not None:
            self._course.waiting.add(first)
        self._on_snapshot, self._on_end = on_snapshot, on_end
        self._on_note, self._on_refusal = on_note, on_refusal
        given = (prepare, forecaster, self._course)
        failed = partial(_failed, course=self._course)
        self._thread = BackgroundSteps(_steps, given, self._show, self._finish, failed, self._warn)

    @property
    def paused(self) -> bool:
        """Whether it waits."""
        return self._course.paused

    @property
    def history(self) -> History:
        """The course of the fit so far."""
        return self._course.history

    @property
    def stage(self) -> str:
        """What the thread is doing, in words."""
        return self._course.stage

    def pause(self, paused: bool) -> None:
        """Wait, or go on."""
        self._course.paused = paused

    def show_rendered(self, wanted: bool) -> None:
        """Whether snapshots should bring rendered images."""
        self._course.render = wanted

    @property
    def state(self) -> FitState | None:
        """The newest state; it may not have been shown yet."""
        return self._course.state

    @property
    def seconds(self) -> float:
        """s; how long the fit has taken, without pauses."""
        return self._course.seconds

    @property
    def forecast(self) -> Forecaster | None:
        """What forecasts how long it takes; None for nothing, or while it is prepared."""
        return self._course.forecast

    @property
    def job(self) -> FitInput | None:
        """What is fitted, with the settings as they are now; None while it is prepared."""
        return self._course.job

    @property
    def left(self) -> Change | None:
        """After the end: a change that came too late for the fit."""
        state, taken = self._course.state, self._course.waiting.take()
        return None if taken is None or state is None else taken.on(state.mesh)

    def change(self, change: Change, of: Mesh | None = None) -> int:
        """Let the fit go on from something else, from its next iteration on.

        Snapshots tell by the number returned whether they include it. What cannot be used is
        refused with a note, and the fit goes on without it. Pins are of a mesh, which the fit may
        have remeshed by then.
        """
        return self._course.waiting.add(change, of)

    def shift(self, shift: NDArray[np.float64], of: Mesh | None = None) -> int:
        """Move the vertices from where they then are, (V, 3) um; else like ``change``."""
        return self._course.waiting.shift(shift, of)

    def update_every(self, seconds: float) -> None:
        """How often snapshots come, at most; s."""
        self._course.interval = seconds

    def _show(self, snapshot: Snapshot | str | None) -> None:
        if snapshot is None:
            return
        if isinstance(snapshot, str):
            self._on_refusal(snapshot)
            return
        began = time.monotonic()
        try:
            self._on_snapshot(snapshot)
        finally:
            # Fires when the viewer has drawn what it was given.
            QTimer.singleShot(0, partial(self._course.drawn, began))

    def _warn(self, message: str, category: type[Warning]) -> None:
        if issubclass(category, TOLD):
            self._on_note(message)

    def _finish(self, outcome: Outcome | None) -> None:
        course = self._course
        outcome = outcome or Outcome(
            "stopped",
            "stopped by you" if course.state else "stopped before the first iteration",
            course.state,
            course.job,
            course.seconds,
        )
        self._on_end(outcome)


def expected(job: FitInput) -> Forecaster | None:
    """What forecasts how long a fit will take; None where the fit will say what is wrong."""
    settings = job.settings
    try:
        return forecast(
            job.image,
            job.grid,
            job.mesh,
            job.optics,
            settings.fit,
            job.counted,
            settings.scene.effects,
        )
    except InputError:
        return None


def _steps(
    prepare: Callable[[], FitInput],
    forecaster: Callable[[FitInput], Forecaster | None] | None,
    course: Course,
) -> Any:
    """The generator that the thread runs; yields a snapshot where one is due, else None.

    It yields after every iteration, as the thread can only be stopped there.
    """
    try:
        course.stage = "preparing the seeds"
        job = course.job = prepare()
        yield None
        course.forecast = forecaster(job) if forecaster is not None else None
        course.stage = "fitting"
        yield from _fit_steps(job, course, forecaster)
    except Exception as error:
        return _failed(error, course)
    state = course.state
    if state is None:
        return Outcome("failed", "the fit ended before its first iteration")
    verdict: Verdict = "converged" if state.converged else "ended"
    # The last message is the verdict in words; those before it are remarks made on the way.
    words = [*course.messages[-1:], *course.messages[:-1]] if state.message else [verdict]
    return Outcome(verdict, "\n".join(dict.fromkeys(words)), state, course.job, course.seconds)


def _fit_steps(
    job: FitInput,
    course: Course,
    forecaster: Callable[[FitInput], Forecaster | None] | None,
) -> Iterator[Snapshot | str | None]:
    clock, began, waited = Clock(), time.monotonic(), 0.0
    states: Any = start(job)
    state, change = next(states, None), None
    while state is not None:
        course.state = state
        course.messages += [state.message] if state.message else []
        course.history.add(state)
        course.seconds = time.monotonic() - began - waited
        # What a change led to is always shown, and kept in the history.
        snapshot = clock.snapshot(state, course, must=change is not None)
        yield snapshot
        pause = time.monotonic()
        while course.paused and not course.waiting.any:
            if snapshot is None:
                snapshot = clock.snapshot(state, course, must=True)
                yield snapshot
            time.sleep(0.02)
            yield None
        waited += time.monotonic() - pause
        change, refused = _taken(state, course)
        yield refused
        if change is not None and change.settings is not None and forecaster is not None:
            _forecast_anew(course, forecaster)
        try:
            state = states.send(change)
        except StopIteration:
            state = None
    if course.state is not None:
        yield clock.snapshot(course.state, course, must=True)


def _taken(state: FitState, course: Course) -> tuple[Change | None, str | None]:
    """The change that waits, if any; else why it was refused, if it was."""
    taken, job = course.waiting.take(), course.job
    if taken is None or job is None:
        return None, None
    course.changes = taken.number
    try:
        change = taken.on(state.mesh)
        usable(change, state.mesh, state.optics, job)
    except InputError as error:
        return None, f"not changed: {error}"
    if change.settings is not None:
        job = course.job = _with_settings(job, change.settings)
    if change.effects is not None:
        job = course.job = _with_scene(job, job.settings.scene, change.effects)
    if change.optics is not None:
        scene = scene_with(job.settings.scene, change.optics)
        course.job = _with_scene(job, scene, scene.effects)
    return change, None


def _forecast_anew(course: Course, forecaster: Callable[[FitInput], Forecaster | None]) -> None:
    """The settings were changed: forecast what is left of the fit with the new ones."""
    found = forecaster(course.job) if course.job is not None else None
    if isinstance(found, Forecast):
        course.forecast = RenewedForecast(found, len(course.history.level), course.seconds)


def _with_settings(job: FitInput, settings: FitSettings) -> FitInput:
    """The job as the fit now does it, for whoever saves or repeats it."""
    run = job.settings
    settings = settings.model_copy(update={"levels": run.fit.levels})
    return replace(job, settings=run.model_copy(update={"fit": settings}))


def _with_scene(job: FitInput, scene: SceneSettings, effects: Effects) -> FitInput:
    scene = scene.model_copy(update={"effects": effects})
    return replace(job, settings=job.settings.model_copy(update={"scene": scene}))


def _failed(error: Exception, course: Course) -> Outcome:
    shape = course.job.grid.shape if course.job else None
    return Outcome("failed", words_of(error, shape), course.state, course.job, course.seconds)
