"""Tracking in a background thread: what it reports, and how it is stopped."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...fitting.job import FitInput
from ...runs.track_run import TrackRun
from ...tracking import FrameResult, track
from ..attempt import words_of
from ..background import BackgroundRun, BackgroundSteps

_INTERVAL = 0.15  # s between two reports of progress


class Frames:
    """The frames of an image layer, read when asked for; NaN where they are not finite."""

    def __init__(self, data: Any) -> None:
        self._data = data

    def __len__(self) -> int:
        return len(self._data)

    def __getitem__(self, frame: int) -> NDArray[Any]:
        image = np.asarray(self._data[frame])
        if np.issubdtype(image.dtype, np.floating) and not np.isfinite(image).all():
            return np.where(np.isfinite(image), image, np.nan)
        return image


@dataclass(frozen=True)
class TrackJob:
    """What is tracked: the fit of the first frame, all frames, and settings of the whole."""

    first: FitInput
    frames: Frames
    settings: TrackRun
    shared_ground: bool


@dataclass(frozen=True)
class Tracked:
    """What a run has reached; of ``seconds`` s.

    job : None while it is prepared.
    """

    job: TrackJob | None = None
    results: tuple[FrameResult, ...] = ()
    seconds: float = 0.0


@dataclass(frozen=True)
class Progress:
    """Where tracking is: frame, level of its fit, iterations and loss."""

    frame: int
    level: int
    levels: int
    iteration: int
    loss: float


@dataclass(frozen=True)
class TrackOutcome:
    """How it ended, in plain words too."""

    verdict: Literal["done", "stopped", "failed"]
    message: str


@dataclass
class _Course:
    """What the thread and its watcher share; written by the thread."""

    job: TrackJob | None = None
    seconds: float = 0.0
    results: list[FrameResult] = field(default_factory=list)


class TrackWork(BackgroundRun):
    """One run of tracking. Made and used on the main thread.

    Parameters
    ----------
    prepare : puts the job together, in the thread.
    done : frames of an earlier run to go on from.
    on_progress : called with where it is, a few times a second.
    on_frame : called with each frame that is done.
    on_end : called once with the outcome, unless the run was closed.
    """

    def __init__(
        self,
        prepare: Callable[[], TrackJob],
        done: Sequence[FrameResult],
        on_progress: Callable[[Progress], None],
        on_frame: Callable[[FrameResult], None],
        on_end: Callable[[TrackOutcome], None],
    ) -> None:
        self._course = _Course(results=list(done))
        self._on_progress, self._on_frame, self._on_end = on_progress, on_frame, on_end
        given = (prepare, list(done), self._course)
        self._thread = BackgroundSteps(_steps, given, self._show, self._finish, _failed)

    @property
    def job(self) -> TrackJob | None:
        """What is tracked; None while it is prepared."""
        return self._course.job

    @property
    def results(self) -> list[FrameResult]:
        """The frames that are done."""
        return list(self._course.results)

    @property
    def seconds(self) -> float:
        """s; how long it has taken."""
        return self._course.seconds

    def _show(self, report: Progress | FrameResult | None) -> None:
        if isinstance(report, Progress):
            self._on_progress(report)
        elif report is not None:
            self._on_frame(report)

    def _finish(self, outcome: TrackOutcome | None) -> None:
        self._on_end(outcome or TrackOutcome("stopped", "stopped by you"))


def _steps(prepare: Callable[[], TrackJob], done: list[FrameResult], course: _Course) -> Any:
    """The generator that the thread runs; it can only be stopped where it yields."""
    began = time.monotonic()
    try:
        job = course.job = prepare()
        yield None
        due = 0.0
        first = job.first
        for state in track(
            job.frames,
            first.grid,
            first.mesh,
            first.optics,
            first.settings.fit,
            tracking=job.settings.track,
            effects=first.settings.scene.effects,
            shared_ground=job.shared_ground,
            done=done,
        ):
            course.seconds = time.monotonic() - began
            if state.done is not None:
                course.results.append(state.done)
                yield state.done
            elif state.fit is not None and time.monotonic() >= due:
                due = time.monotonic() + _INTERVAL
                fit = state.fit
                yield Progress(state.frame, fit.level, fit.levels, fit.iteration, fit.loss)
            else:
                yield None
    except Exception as error:
        return _failed(error)
    left_out = sum(result.mesh is None for result in course.results)
    text = f"{len(course.results)} frames tracked"
    if left_out:
        text += f", {left_out} of them left out"
    return TrackOutcome("done", text)


def _failed(error: Exception) -> TrackOutcome:
    return TrackOutcome("failed", words_of(error))
