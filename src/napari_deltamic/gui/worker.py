"""A fit in a background thread: what it shows, and how it is paused, stopped and ended."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QTimer
from superqt.utils import create_worker

from ..cli.messages import failure
from ..errors import InputError, RepairWarning
from ..fourier import SlowPathWarning
from ..inference import FitState
from ..job import FitInput, start
from ..report import History

INTERVAL = 0.033  # s between two updates of the viewer
LONGEST_REST = 0.5  # s that a slow viewer is left alone, at most
RENDER_EVERY = 0.3  # s, at least, between two rendered images
RENDER_SHARE = 0.1  # of the time of a fit may go into rendered images

Verdict = Literal["converged", "ended", "stopped", "failed"]


@dataclass(frozen=True)
class Snapshot:
    """What the viewer shows of a state; nothing in it is touched by the fit any more.

    state : the last state.
    job : what is fitted.
    rendered : (Z, Y, X) float32, or None where it was not computed this time.
    iterations_per_second : over the whole run, without pauses.
    """

    state: FitState
    job: FitInput
    rendered: NDArray[np.float32] | None
    iterations_per_second: float


@dataclass(frozen=True)
class Outcome:
    """How a run ended: the verdict, in plain words too, and the last good state if any."""

    verdict: Verdict
    message: str
    state: FitState | None = None
    job: FitInput | None = None
    seconds: float = 0.0


@dataclass
class _Course:
    """What the thread and its watcher share; each field is written by one of them."""

    # by the watcher
    paused: bool = False
    shown: bool = True  # whether the last snapshot has been drawn
    rest_until: float = 0.0  # no snapshot before
    render: bool = True
    # by the thread
    job: FitInput | None = None
    state: FitState | None = None
    history: History = field(default_factory=History)
    seconds: float = 0.0
    stage: str = "starting"
    messages: list[str] = field(default_factory=list)

    def drawn(self, began: float) -> None:
        """The viewer has drawn the last snapshot, which it was given at a time."""
        now = time.monotonic()
        # Drawing without a GPU takes the cores that the fit needs: it gets about a third of them.
        self.rest_until = now + min(2 * (now - began), LONGEST_REST)
        self.shown = True


class FitRun:
    """One run of a fit, from its start to its outcome. Made and used on the main thread.

    Parameters
    ----------
    prepare : puts the fit together, in the thread.
    on_snapshot : called with each snapshot, at most every 33 ms and never before the last
        was drawn.
    on_end : called once with the outcome, unless the run was closed.
    on_note : called with warnings that are meant for users.
    """

    def __init__(
        self,
        prepare: Callable[[], FitInput],
        on_snapshot: Callable[[Snapshot], None],
        on_end: Callable[[Outcome], None],
        on_note: Callable[[str], None],
    ) -> None:
        self._course = _Course()
        self._on_snapshot, self._on_end, self._on_note = on_snapshot, on_end, on_note
        self._outcome: Outcome | None = None
        self._open = True
        # Errors are caught in the thread: this library drops any RuntimeError without a word.
        self._worker: Any = create_worker(
            _steps, prepare, self._course, _start_thread=False, _ignore_errors=True
        )
        self._slots: tuple[tuple[Any, Callable[..., None]], ...] = (
            (self._worker.yielded, self._show),
            (self._worker.returned, self._note_outcome),
            (self._worker.warned, self._warn),
            (self._worker.finished, self._finish),
        )
        for signal, slot in self._slots:
            signal.connect(slot)

    def start(self) -> None:
        """Start the thread."""
        self._worker.start()

    @property
    def running(self) -> bool:
        """Whether it has been neither closed nor ended."""
        return self._open

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
    def stopping(self) -> bool:
        """Whether it was asked to end."""
        return bool(self._worker.abort_requested)

    def stop(self) -> None:
        """End the fit after its present iteration; ``on_end`` brings what it reached."""
        self._worker.quit()

    def close(self) -> None:
        """End the fit and call nobody any more."""
        if self._open:
            self._open = False
            self._worker.quit()
            self._disconnect()

    def _show(self, snapshot: Snapshot | None) -> None:
        if snapshot is None or not self._open:
            return
        began = time.monotonic()
        try:
            self._on_snapshot(snapshot)
        except Exception as error:  # a fit that cannot be shown should not go on unseen
            self._outcome = _failed(error, self._course)
            self._worker.quit()
        # Fires when the viewer has drawn what it was given.
        QTimer.singleShot(0, partial(self._course.drawn, began))

    def _note_outcome(self, outcome: Outcome) -> None:
        self._outcome = outcome

    def _warn(self, warning: tuple[Any, ...]) -> None:
        message, category = warning[:2]
        if issubclass(category, (RepairWarning, SlowPathWarning)):
            self._on_note(str(message))

    def _finish(self) -> None:
        course = self._course
        outcome = self._outcome or Outcome(
            "stopped",
            "stopped by you" if course.state else "stopped before the first iteration",
            course.state,
            course.job,
            course.seconds,
        )
        self._open = False
        self._disconnect()
        self._on_end(outcome)

    def _disconnect(self) -> None:
        for signal, slot in self._slots:
            signal.disconnect(slot)
        self._slots = ()


def _steps(prepare: Callable[[], FitInput], course: _Course) -> Any:
    """The generator that the thread runs; yields a snapshot where one is due, else None.

    It yields after every iteration, as the thread can only be stopped there.
    """
    try:
        course.stage = "preparing the seeds"
        job = course.job = prepare()
        yield None
        course.stage = "fitting"
        yield from _fit_steps(job, course)
    except Exception as error:
        return _failed(error, course)
    state = course.state
    if state is None:
        return Outcome("failed", "the fit ended before its first iteration")
    verdict: Verdict = "converged" if state.converged else "ended"
    # The last message is the verdict in words; those before it are remarks made on the way.
    words = [*course.messages[-1:], *course.messages[:-1]] if state.message else [verdict]
    return Outcome(verdict, "; ".join(words), state, course.job, course.seconds)


def _fit_steps(job: FitInput, course: _Course) -> Iterator[Snapshot | None]:
    clock, started = _Clock(), time.monotonic()
    waited = 0.0
    for state in start(job):
        course.state = state
        course.messages += [state.message] if state.message else []
        course.history.add(state)
        course.seconds = time.monotonic() - started - waited
        yield clock.snapshot(job, state, course)
        pause = time.monotonic()
        while course.paused:
            time.sleep(0.02)
            yield None
        waited += time.monotonic() - pause
    if course.state is not None:
        yield clock.snapshot(job, course.state, course, last=True)


class _Clock:
    """Decides when a snapshot, and when a rendered image, is due."""

    def __init__(self) -> None:
        self._next = self._next_render = 0.0

    def snapshot(
        self, job: FitInput, state: FitState, course: _Course, *, last: bool = False
    ) -> Snapshot | None:
        now = time.monotonic()
        # A viewer that draws slowly gets fewer snapshots, not a queue of them.
        early = now < max(self._next, course.rest_until)
        if not last and (early or not course.shown):
            return None
        rendered = None
        if course.render and (last or now >= self._next_render):
            rendered = state.rendered()
            cost = time.monotonic() - now
            self._next_render = time.monotonic() + max(RENDER_EVERY, cost / RENDER_SHARE)
        self._next = time.monotonic() + INTERVAL
        course.shown = False
        rate = len(course.history.loss) / max(course.seconds, 1e-3)
        return Snapshot(state, job, rendered, rate)


def _failed(error: Exception, course: _Course) -> Outcome:
    shape = course.job.grid.shape if course.job else None
    reason = str(error if isinstance(error, InputError) else failure(error, shape))
    return Outcome("failed", reason, course.state, course.job, course.seconds)
