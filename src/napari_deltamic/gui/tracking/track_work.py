"""Tracking as a task: what its thread does, and what of that is shown."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Sequence
from typing import Any

from numpy.typing import NDArray

from ...common.doing import heard, listening
from ...common.words import counted
from ...fitting.job import FitInput
from ...results.judged import judged_track
from ...results.session_parts import SavedTracks
from ...results.timeline import explained
from ...runs.track_run import TrackRun
from ...tracking import FrameResult
from ..viewing.frame import Box, finite
from ..window_words import words_of
from ..work import Outcome, Task


class Frames:
    """The frames of an image layer, read when asked for; NaN where they are not finite.

    box : the region of each that is tracked; None for all of it.
    """

    def __init__(self, data: Any, box: Box | None = None) -> None:
        self._data = data
        self._region = tuple(slice(a, b) for a, b in box) if box is not None else ...

    def __len__(self) -> int:
        return len(self._data)

    def __getitem__(self, frame: int) -> NDArray[Any]:
        return finite(self._data[frame][self._region])


class TrackWork(Task):
    """One run of tracking.

    Parameters
    ----------
    prepare : puts the fit of the first frame together, in the thread; None where there is none.
    images : all frames.
    frames : those that are tracked.
    done : frames of an earlier run to go on from.
    on_frame : called for each frame that is done, with those up to it.
    on_end : called once with the outcome, unless the run was closed.

    Attributes
    ----------
    job : the fit of the first frame; None while it is prepared.
    results : of the frames done.
    seconds : s that it has taken.
    """

    title = "cells are being tracked"
    kept = "Cells are being tracked. Finished frames stay in the viewer; their table is lost."

    def __init__(
        self,
        prepare: Callable[[], FitInput | None],
        images: Frames,
        frames: range,
        done: Sequence[FrameResult],
        on_frame: Callable[[Sequence[FrameResult]], None],
        on_end: Callable[[Outcome], None],
    ) -> None:
        super().__init__()
        self.prepare, self.images, self.frames = prepare, images, frames
        self._on_frame, self._on_end = on_frame, on_end
        self._shown = len(done)  # frames
        self.job: FitInput | None = None
        self.results: list[FrameResult] = list(done)
        self.seconds = 0.0
        self.stage = "preparing the seeds"

    @classmethod
    def of_session(
        cls,
        job: FitInput | None,
        images: Frames,
        tracks: SavedTracks,
        on_frame: Callable[[Sequence[FrameResult]], None],
        on_end: Callable[[Outcome], None],
    ) -> TrackWork:
        """A run that a session kept, as if it had just ended; job : fit of its first frame."""
        left = range(tracks.settings.track.first, len(images))
        work = cls(lambda: job, images, left, tracks.results, on_frame, on_end)
        work.job, work.seconds, work.running = job, tracks.seconds, False
        return work

    @property
    def settings(self) -> TrackRun:
        """The settings of the whole run; only once it is prepared."""
        settings = None if self.job is None else self.job.settings
        assert isinstance(settings, TrackRun)
        return settings

    @property
    def shared_ground(self) -> bool:
        """Whether cells without a seed of their own would attract the others."""
        return self.job is not None and self.job.kind == "image"

    def look(self) -> None:
        while self._shown < len(self.results):
            self._shown += 1
            self._on_frame(self.results[: self._shown])

    def end(self, outcome: Outcome | None) -> None:
        self.look()
        self._on_end(outcome or Outcome("stopped", "stopped"))

    def failed(self, error: Exception) -> Outcome:
        return Outcome("failed", words_of(error))

    def steps(self) -> Generator[None, None, Outcome]:
        """Track in the thread; yields after every iteration."""
        began, done = time.monotonic(), list(self.results)
        with listening(self.step):
            job = self.job = self.prepare()
        yield
        assert job is not None, "is not offered without one"
        count = len(self.frames)
        for state in heard(judged_track(self.images, job, done), self.step):
            self.seconds = time.monotonic() - began
            fit = state.fit
            if state.done is not None:
                self.results.append(state.done)
            elif fit is not None:
                number = state.frame - self.frames.start
                self.share = (number + (fit.level - 1) / max(fit.levels, 1)) / count
                self.stage = (
                    f"time {state.frame} ({number + 1} of {count}): "
                    f"level {fit.level} of {fit.levels}, "
                    f"match {explained(fit.loss):.1f}%"
                )
            yield
        left_out = sum(result.mesh is None for result in self.results)
        text = times_tracked(self.results, len(self.images))
        if left_out:
            text += f", {left_out} of them skipped"
        return Outcome("done", text)


def times_tracked(results: Sequence[FrameResult], of: int) -> str:
    """A text on which times of a series of ``of`` were tracked."""
    first, last = results[0].frame, results[-1].frame
    if (first, last) == (0, of - 1):
        return f"{counted(of, 'time point')} tracked"
    which = f"time {first}" if first == last else f"times {first} to {last}"
    return f"{which} of 0 to {of - 1} tracked"
