"""``napari-deltamic track``: cells through a series of images, in a folder."""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..common.choices import AUTO
from ..common.doing import heard
from ..common.words import counted
from ..common.writing import own_folder, written_together
from ..errors import PROGRAM, InputError, failure
from ..evidence.reason import GRADES
from ..fitting.job import FitInput
from ..images.padding import without_padding
from ..images.series import ImageSeries, open_series
from ..results.judged import judged_track
from ..results.track_report import (
    FILES,
    forget_others,
    mesh_name,
    read_results,
    write_frame,
    write_tracks,
)
from ..runs.settings import validated
from ..runs.track_run import TrackRun
from ..scene import Grid
from ..tracking import FrameResult
from .arguments.track_arguments import track_values
from .folders import check_folder
from .inputs import CHANNEL, fit_of, run_values, usable, voxel_size_of
from .messages import INTERRUPTED, Bar, Notes, tell

_PRECIOUS = (*FILES, mesh_name(0))


def run(arguments: argparse.Namespace, notes: Notes) -> int:
    """Read, track and write; prints the path of each result."""
    folder = Path(arguments.output)
    resumed = arguments.resume is not None and Path(arguments.resume).absolute()
    check_folder(folder, _PRECIOUS, overwrite=arguments.overwrite or resumed == folder.absolute())
    try:
        tracking = _gather(arguments, folder, notes)
    except (MemoryError, RuntimeError) as error:
        raise failure(error) from error
    with own_folder(folder):
        notes.release()
        return tracking.complete()


def _gather(arguments: argparse.Namespace, folder: Path, notes: Notes) -> _Run:
    values = run_values(arguments, notes, TrackRun)
    if str(values.get("seeds")).startswith(f"{AUTO}@"):
        raise InputError(
            f"{values['seeds']}: nuclei of another channel are looked for in single stacks only: "
            "give labels of the first frame"
        )
    images = open_series(values["image"], values.get("channel"), CHANNEL)
    if len(images) < 2:
        raise InputError(f"{values['image']}: tracking needs two frames or more, not {len(images)}")
    scene = values["scene"]
    scene["voxel_size"] = voxel_size_of(
        scene.get("voxel_size"), images.voxel_size, values["image"], notes
    )
    values["track"] = {**values.get("track", {}), **track_values(arguments)}
    settings: TrackRun = validated(TrackRun, values)
    first = settings.track.first
    if first >= len(images):
        raise InputError(
            f"frame {first} is not there: the series has frames 0 to {len(images) - 1}"
        )
    shape = images.shape[1:]
    grid = Grid((shape[0], shape[1], shape[2]), settings.scene.voxel_size, settings.scene.origin)
    image = _seeded(images, first, arguments.missing_nan, notes)
    job = fit_of(settings, image, grid, notes, ground=False)
    done = read_results(arguments.resume) if arguments.resume is not None else []
    return _Run(images, job, done, arguments.missing_nan, folder, notes)


def _seeded(
    images: ImageSeries, first: int, missing_nan: bool, notes: Notes
) -> NDArray[np.float32]:
    """The frame to which the seeds belong, (Z, Y, X); InputError if all of it is missing."""
    image = np.asarray(images[first])
    if not np.isfinite(image).any():
        raise InputError(
            f"every voxel of frame {first}, to which the seeds belong, is missing: start from "
            "another one with --frames A:B"
        )
    image, padded = without_padding(usable(image, missing_nan, notes, f"frame {first}"))
    if padded:
        notes.add(f"frame {first}: {padded}")
    return image


@dataclass
class _Run:
    """Tracking under way: follows it, writes its files, and ends it.

    first : the fit of the first frame.
    results : one for each frame done, including those of a previous run.
    """

    images: ImageSeries
    first: FitInput
    results: list[FrameResult]
    missing_nan: bool
    folder: Path
    notes: Notes
    started: float = 0.0  # s, of the monotonic clock
    alone: bool = False  # whether files that an earlier run left in the folder are gone

    @property
    def settings(self) -> TrackRun:
        """The settings of the whole run."""
        assert isinstance(self.first.settings, TrackRun)
        return self.first.settings

    def complete(self) -> int:
        """Track until the end, or until interrupted; the exit code."""
        self.started = time.monotonic()
        if self.results:  # of a previous run, perhaps in another folder
            with written_together(self.folder / FILES[-1]):
                for result in self.results:
                    write_frame(self.folder, result)
                self._write(surface=False)
        code = 0
        try:
            self._follow()
        except KeyboardInterrupt:
            code = INTERRUPTED
        except Exception as error:
            if self.results:
                self._write(surface=True)
            if isinstance(error, InputError):
                raise
            raise failure(error, self.first.grid.shape) from error
        if not self.results:
            print("interrupted before the first frame was done: nothing to save", file=sys.stderr)
            return code
        for result in self.results:
            if result.mesh is not None:
                tell(self.folder / mesh_name(result.frame))
        try:
            for path in self._write(surface=True):
                tell(path)
        except KeyboardInterrupt:
            code = INTERRUPTED
        print(f"shapes: {_grades(self.results)}", file=sys.stderr)
        if code:
            words = [PROGRAM, "track", "--settings", self.folder / "run.toml"]
            words += ["--resume", self.folder, "-o", self.folder]
            words += ["--missing-nan"] if self.missing_nan else []
            print(f"interrupted; to go on: {shlex.join(map(str, words))}", file=sys.stderr)
        return code

    def _follow(self) -> None:
        tracking, done = self.settings.track, tuple(self.results)
        stop = len(self.images) if tracking.stop is None else min(tracking.stop, len(self.images))
        states = judged_track(self.images, self.first, done)
        with Bar(
            total=stop - tracking.first, initial=len(done), unit="frame", file=sys.stderr
        ) as bar:
            for state in heard(states, bar.tell):
                if state.fit is not None:
                    bar.set_postfix_str(
                        f"frame {state.frame}, level {state.fit.level}/{state.fit.levels}, "
                        f"loss {state.fit.loss:.4g}",
                        refresh=False,
                    )
                    bar.update(0)
                if state.done is not None:
                    self._take(state.done)
                    bar.update()

    def _take(self, result: FrameResult) -> None:
        self.results.append(result)
        for event in result.events:
            self.notes.add(f"frame {result.frame}: {event.text}")
        if result.message:
            text = result.message
            self.notes.add(text if result.mesh is None else f"frame {result.frame}: {text}")
        # So that a report never lies beside meshes of another run.
        with written_together(self.folder / FILES[-1]):
            write_frame(self.folder, result)
            self._write(surface=False)
        if not self.alone:  # not before there is something in its place
            forget_others(self.folder, self.results)
            self.alone = True

    def _write(self, *, surface: bool) -> list[Path]:
        seconds = time.monotonic() - self.started
        return write_tracks(
            self.folder,
            self.results,
            self.first.grid,
            self.settings,
            seconds,
            warnings=self.notes.texts,
            surface=surface,
        )


def _grades(results: Sequence[FrameResult]) -> str:
    """How many frames have which grade, and the worst of them with its reasons."""
    seen = [r for r in results if r.mesh is not None and r.grade in GRADES]
    counts = {grade: sum(r.grade == grade for r in seen) for grade in GRADES}
    text = ", ".join(f"{counted(n, 'frame')} {grade}" for grade, n in counts.items() if n)
    poorest = max(seen, key=lambda r: GRADES.index(r.grade), default=None)
    if poorest is None:
        return "not judged"
    why = "" if poorest.grade == GRADES[0] else f"; frame {poorest.frame}: {poorest.judgement}"
    return text + why
