"""``napari-deltamic fit``: from an image and seeds to meshes, in a folder."""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from ..common.doing import heard
from ..common.writing import interrupts_held, own_folder, write_atomically
from ..errors import PROGRAM, InputError, failure
from ..evidence import analyse_residual, recommend_for
from ..evidence.fit_facts import verdict_of
from ..evidence.sanity import tell_doubts
from ..fitting import FitState
from ..fitting.history import History
from ..fitting.job import FitInput, following, start
from ..images.stacks import write_image
from ..results.report import write_results
from ..runs.fit_settings import asked_error
from .arguments.fit_arguments import CHECKPOINT
from .inputs import gather
from .messages import INTERRUPTED, Bar, Notes, tell
from .recommending import (
    as_plain,
    residual_as_plain,
    verdict,
)
from .second_view_input import check_second_view

CHECKPOINT_EVERY = 5.0  # s: what a crash may cost; writing a checkpoint takes far less
_CLEARLY = 1.1  # times the error asked for: predictions are not exact enough for less to count
# Share of the signal. A fit with effects has more freedom, so it should not explain less. Chosen:
# this much may differ, as each fit is judged near its own surfaces.
_LESS = 0.01


def run(arguments: argparse.Namespace, notes: Notes) -> int:
    """Read, fit and write; prints the path of each result."""
    folder = Path(arguments.output)
    auto = arguments.effects == "auto"
    try:
        job = gather(arguments, notes)
        check_second_view(job.settings.scene)
        doubts = tell_doubts(job)
        _tell_outlook(job, notes)
        course = _Run(job, folder, notes, auto, arguments.residual)
        states = start(job, arguments.resume)
    except (MemoryError, RuntimeError) as error:
        raise failure(error) from error
    with own_folder(folder):
        notes.release()
        course.further["sanity"] = [asdict(doubt) for doubt in doubts]
        return course.complete(states)


def _tell_outlook(job: FitInput, notes: Notes) -> None:
    """Add a note if the image does not allow the shape error that is asked for."""
    asked = asked_error(job.settings.fit.shape_error)
    if asked is not None and job.predicted is not None and job.predicted > _CLEARLY * asked:
        notes.add(
            f"this image does not allow a shape error of {1000 * asked:.0f} nm: about "
            f"{1000 * job.predicted:.0f} nm can be expected"
        )


class _Run:
    """A fit under way: follows it, writes checkpoints, and ends it."""

    def __init__(
        self,
        job: FitInput,
        folder: Path,
        notes: Notes,
        auto: bool = False,
        residual: bool = False,
    ) -> None:
        self.job, self.folder, self.notes = job, folder, notes
        self.auto, self.residual = auto, residual  # whether to add effects, to write the map
        self.further: dict[str, Any] = {}  # sections of the report
        self.checkpoint = folder / CHECKPOINT
        self.history = History()
        self.last: FitState | None = None
        self.started = time.monotonic()
        self.has_settings = self.has_results = False  # whether the folder has them

    def complete(self, states: Iterator[FitState]) -> int:
        """Run the fit until it ends or is interrupted, and write the results; the exit code."""
        try:
            self._follow(states)
            if self.auto:
                self._follow_with_effects()
            assert self.last is not None, "a fit yields at least one state"
            self._write(self.last)
        except KeyboardInterrupt:
            return self._interrupted()
        except Exception as error:
            raise self._failed(error) from error
        return 0

    def _follow_with_effects(self) -> None:
        """Continue with the effects that the fit calls for; undo that if it explains less."""
        assert self.last is not None, "a fit yields at least one state"
        job, last, history = self.job, self.last, self.history
        self._follow(self._with_recommended())
        if self.job is job:
            return
        # Not the loss: effects change which voxels count.
        without, explained = self._explained(job, last), self._explained(self.job, self.last)
        if explained < without - _LESS:
            self.notes.add(
                f"effects left out: the fit explains {explained:.1%} with them, and {without:.1%} "
                "without"
            )
            self._take_over(job)
            self.last, self.history = last, history

    @staticmethod
    def _explained(job: FitInput, state: FitState) -> float:
        """Share of the signal around the surfaces that is explained; 0 if there is only noise."""
        left = analyse_residual(job.image, job.grid, state, counted=job.counted)
        return left.explained or 0.0

    def _with_recommended(self) -> Iterator[FitState]:
        """The fit with the effects that the last one calls for; empty if it calls for none."""
        assert self.last is not None, "a fit yields at least one state"
        found = recommend_for(self.job, self.last, progress=self.notes.add)
        self.further["recommendation"] = as_plain(found)
        for line in verdict(found):
            self.notes.add(line)
        if not found.recommended:
            return iter(())
        scene = self.job.settings.scene.model_copy(update={"effects": found.effects})
        self._take_over(self.job.with_settings(scene=scene))
        self.history = History()
        self.last = replace(self.last, message="")  # its message is not about the next fit
        return start(self.job)

    def _follow(self, states: Iterator[FitState]) -> None:
        saved = time.monotonic()
        terminal = sys.stderr.isatty()
        # The number of iterations is not known, so the bar shows no percentage and no time left.
        with Bar(unit="it", file=sys.stderr, mininterval=0.2 if terminal else 10.0) as bar:
            for state in heard(states, bar.tell):
                if self.last is not None and self.last.message:
                    self.notes.add(self.last.message)
                self.last = state
                self._take_over(following(self.job, state))
                self.history.add(state)
                bar.set_description_str(f"level {state.level}/{state.levels}", refresh=False)
                bar.set_postfix_str(f"loss {state.loss:.4g}", refresh=False)
                bar.update()
                if time.monotonic() - saved > CHECKPOINT_EVERY:
                    self._keep(state)
                    saved = time.monotonic()

    def _take_over(self, job: FitInput) -> None:
        """Continue with this job; if it is a new one, the settings on disk are out of date."""
        self.has_settings = self.has_settings and job is self.job
        self.job = job

    def _keep(self, state: FitState) -> None:
        """Write a checkpoint, and the settings, without which it is of no use."""
        with interrupts_held():
            if not self.has_settings:
                toml = self.folder / "run.toml"
                write_atomically(toml, self.job.settings.to_toml().encode())
                self.has_settings = True
            state.save(self.checkpoint)

    def _write(self, state: FitState) -> None:
        job = self.job
        seconds = time.monotonic() - self.started
        left = analyse_residual(job.image, job.grid, state, counted=job.counted)
        self.further["residual"] = residual_as_plain(left)
        found = verdict_of(job, state, left)
        paths = write_results(
            self.folder,
            state,
            job.image,
            job.grid,
            job.settings,
            self.history,
            seconds,
            warnings=self.notes.texts,
            further=self.further,
            explained=left.shares(),
            verdict=found,
        )
        tif = self.folder / "residual.tif"
        if self.residual:
            write_image(tif, left.map, job.grid.voxel_size)
            paths.append(tif)
        else:
            tif.unlink(missing_ok=True)  # left by an earlier fit
        how = state.message or ("converged" if state.converged else "ended")
        print(
            f"{how} ({state.iteration} iterations, {seconds:.1f} s, loss {state.loss:.4g})",
            file=sys.stderr,
        )
        print(f"shapes: {found.sentence()}", file=sys.stderr)
        with interrupts_held():
            if state.converged:
                self.checkpoint.unlink(missing_ok=True)
            else:
                self._keep(state)
                paths.append(self.checkpoint)
            self.has_results = True
        for path in paths:
            tell(path)

    def _interrupted(self) -> int:
        if self.last is None:
            print("interrupted before the first iteration: nothing to save", file=sys.stderr)
            return INTERRUPTED
        if self.has_results:
            return INTERRUPTED
        self._keep(self.last)
        print(f"interrupted; the state is in {self.checkpoint}", file=sys.stderr)
        done = self.last.converged
        try:
            self._write(self.last if done else replace(self.last, message="interrupted"))
        except KeyboardInterrupt:
            print("interrupted again: there are no results", file=sys.stderr)
        except Exception as error:
            raise self._failed(error) from error
        if done and self.has_results:
            return INTERRUPTED
        toml = self.folder / "run.toml"
        words = [PROGRAM, "fit", "--settings", toml, "--resume", self.checkpoint]
        # Options that are not part of the settings must be given again.
        words += ["--missing-nan"] if self.job.has_missing else []
        words += ["--residual"] if self.residual else []
        words += ["--overwrite", "-o", self.folder]
        if self.auto and "recommendation" not in self.further:
            ask = shlex.join([PROGRAM, "effects", "--settings", str(toml)])
            print(f"not yet checked for effects; to check: {ask}", file=sys.stderr)
        print(f"to go on: {shlex.join(map(str, words))}", file=sys.stderr)
        return INTERRUPTED

    def _failed(self, error: Exception) -> Exception:
        """The error to raise instead; saves the last state, from which the fit can go on."""
        reason = error if isinstance(error, InputError) else failure(error, self.job.grid.shape)
        if self.last is None:
            return reason
        try:
            self._keep(self.last)
        except InputError:
            return reason
        return type(reason)(
            f"{reason}; the state after {self.last.iteration} iterations is in {self.checkpoint}"
        )
