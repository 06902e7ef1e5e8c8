"""Track and save a series, and the cells of the frame that is shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from qtpy.QtWidgets import QFileDialog, QGroupBox, QLabel, QVBoxLayout, QWidget

from ...common.words import counted, duration
from ...errors import InputError
from ...evidence.put_together import put_together, start_of
from ...evidence.reason import GRADES
from ...fitting.job import FitInput, optics_of
from ...measure import measure_cells
from ...results.session_parts import SavedTracks
from ...results.track_report import write_frame, write_tracks
from ...runs.seeds import SeedKind, Seeds
from ...runs.settings import validated
from ...runs.track_run import TrackRun
from ...scene import Grid
from ...tracking import FrameResult, TrackSettings
from ..cell_table import CellTable
from ..document import Document
from ..fields import Form
from ..layer_channels import origin_of
from ..viewing.frame import Frame, data_of
from ..widgets import Note, button, confirmed, filled, row
from ..window_words import attempt, for_window
from ..work import Outcome
from .layers import TrackLayers
from .track_work import Frames, TrackWork, times_tracked


class TrackPanel(QGroupBox):
    """Tracks the chosen series, and shows it in the viewer; visible only for images over time."""

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__("Track", parent)
        self._doc = doc
        self.work: TrackWork | None = None  # the last run, or that of a session
        self._before: TrackWork | None = None  # whose frames are shown until the last run has one
        self._place: tuple[Any, Frame] | None = None  # where that one will be shown
        self._kept: Sequence[FrameResult] = ()  # the frames that were saved last
        self._words = "", ""  # how the run that is shown ended, and its verdict
        self.layers: TrackLayers | None = None
        self._seeds: list[Any] = []  # layers that the run started from
        tip = (
            "Fit the time shown from the seeds, and every later one from the one before. Cells "
            "keep their numbers. Times that are tracked already stay until the first new one is "
            "done."
        )
        self.track_button = button("Track", tip, self.start, self)
        tip = "Go on after the last time that was tracked."
        self.go_on_button = button("Go on", tip, self.go_on, self)
        self.first, self.first_row = Note(self, "fair"), QWidget(self)
        tip = "Move the slider to the first time, so that tracking starts there."
        self.first_go = button("Go to time 0", tip, self._go_to_first, self)
        row((self.first, 1), self.first_go, of=self.first_row)
        form = Form(TrackSettings, ("divisions",), self)
        self.divisions = form.fields["divisions"]
        self.verdict, self.frame = Note(self, style="font-weight: bold;"), QLabel(self)
        self.frame.setWordWrap(True)
        self.table = CellTable(self)
        tip = "A mesh for each time, tracks.csv, surface.npz, report.json and run.toml."
        self.save_button = button("Save all times...", tip, self._ask_folder, self)
        tip = "Move to that time, and to where the surface still moves."
        self.worst_button = button("", tip, self.go_to_worst, self)
        buttons = row(self.track_button, self.go_on_button, form)
        shown = self.verdict, self.worst_button, self.frame, self.table, self.save_button
        filled(QVBoxLayout(self), buttons, self.first_row, *shown)
        self.table.chosen.connect(self._chosen)
        doc.image.changed.connect(self._image_changed)
        doc.work.changed.connect(self._work_changed)
        for show in (self._show_first, self._show_frame):
            doc.listen(doc.viewer.dims.events.current_step, show)
        doc.at_end(self._let_go)
        doc.ask_before_losing(self._unsaved)
        self.worst_button.hide()
        self._image_changed()
        self._show_frame()

    @property
    def results(self) -> list[FrameResult]:
        """The results of the run that is shown."""
        return [] if self._shown is None else list(self._shown.results)

    @property
    def _shown(self) -> TrackWork | None:
        """The run whose frames are shown."""
        return self._before or self.work

    def start(self) -> None:
        """Track from the frame shown; if something is missing, the user is told what."""
        if not self._doc.busy():
            attempt(self._start, self._complain)

    def go_on(self) -> None:
        """Track the frames after those that are done."""
        work = self.work
        if not self._doc.busy() and work is not None:
            self._launch(work.prepare, work.images, work.frames, self.results)

    def go_to_worst(self) -> None:
        """Go to the frame with the least certain surfaces, and if they still move, to where."""
        worst, layers = worst_of(self.results), self.layers
        if worst is not None and layers is not None:
            layers.go_to_frame(worst.frame, worst.moving)

    def save(self, folder: str) -> None:
        """Write what the command line would. InputError if it cannot be written."""
        work, results = self._shown, self.results
        if work is None or work.job is None or not results:
            raise InputError("there is no time point to save")
        for result in results:
            write_frame(folder, result)
        write_tracks(folder, results, work.job.grid, work.settings, work.seconds)
        self.note_saved(results)
        self._doc.told.emit(f"saved {folder}")

    def saved(self) -> SavedTracks | None:
        """What a session keeps of the chosen series; None if it was not tracked."""
        work, layers = self._shown, self.layers
        if layers is None or work is None or work.job is None or not work.results:
            return None
        layer, frame = self._doc.image.layer, self._doc.image.frame()
        if layers.image_layer is not layer or layers.frame != frame:
            return None
        pixels, box = data_of(layer), frame.box
        return SavedTracks(
            pixels=pixels if box is None else pixels[(..., *(slice(a, b) for a, b in box))],
            time=(float(layer.scale[-4]), float(layer.translate[-4]), str(layer.units[-4])),
            results=tuple(work.results),
            settings=work.settings,
            seconds=work.seconds,
            shared_ground=work.shared_ground,
        )

    def reopen(self, tracks: SavedTracks) -> None:
        """Show what a session kept of the chosen image, as if it had just been tracked."""
        image, images = self._doc.image, Frames(tracks.pixels)
        frame, tracking = image.frame(), tracks.settings.track
        job = _reopened(tracks, frame, images)
        told = self._frame_done, self._ended
        self.work = TrackWork.of_session(job, images, tracks, *told)
        self.divisions.setChecked(tracking.divisions)
        self._before, self._place = None, None
        self._show_in(image.layer, frame).show(tracks.results)
        self._end("done", times_tracked(tracks.results, len(images)))
        self.note_saved(tracks.results)

    def note_saved(self, results: Sequence[FrameResult]) -> None:
        """Note that these frames are saved in files."""
        self._kept = tuple(results) or self._kept

    def _unsaved(self) -> str:
        """What closing the window would lose, in words; '' for nothing, or if a run tells it."""
        known = {id(result) for result in self._kept}
        if isinstance(self._doc.work.task, TrackWork) or all(id(r) in known for r in self.results):
            return ""
        return "The table of the tracked times would be lost; their surfaces stay in the viewer."

    def _let_go(self) -> None:
        """Close the layers, as the window is closed."""
        if self.layers is not None:
            self.layers.close()

    # ------------------------------------------------------------------------------------- runs

    def _start(self) -> None:
        image = self._doc.image
        layer, frame = image.layer, image.frame()
        data = data_of(layer)
        first, stop = int(self._doc.viewer.dims.current_step[-4]), len(data)
        if stop < 2:
            raise InputError("tracking needs two time points or more; the image has one")
        if stop - first < 2:
            raise InputError("this is the last time point: move to an earlier one, or run a fit")
        seeds = self._doc.cells.seeds(frame)
        settings = self._settings(seeds, first, float(layer.scale[-4]))
        images, grid = Frames(data, frame.box), frame.grid(image.shape())
        self._place = layer, frame
        self._doc.finish_placing.emit(True)
        self._seeds = self._doc.cells.ticked
        prepare = partial(_prepared, settings, images, grid, seeds)
        self._launch(prepare, images, range(first, stop), ())

    def _settings(self, seeds: Seeds, first: int, scale: float) -> TrackRun:
        run = self._doc.run_settings(seeds.path)
        tracking = TrackSettings(
            first=first,
            divisions=self.divisions.isChecked(),
            time_step=scale if scale > 0 else 1.0,
        )
        image = self._doc.image
        # No file holds a region alone.
        path, channel = origin_of(image.layer) if image.box is None else ("", None)
        values = {**dict(run), "image": path, "channel": channel, "track": tracking}
        return validated(TrackRun, values)

    def _launch(
        self,
        prepare: Callable[[], FitInput | None],
        images: Frames,
        frames: range,
        done: Sequence[FrameResult],
    ) -> None:
        before = self._shown if self.results else None
        work = TrackWork(prepare, images, frames, done, self._frame_done, self._ended)
        self._doc.work.start(work)
        self.work, self._before = work, before

    def _show_in(self, image_layer: Any, frame: Frame) -> TrackLayers:
        """New layers in place of those of an earlier run, else two surfaces would overlap."""
        if self.layers is not None:
            self.layers.remove()
        self.layers = TrackLayers(self._doc.viewer, image_layer, frame)
        return self.layers

    def _frame_done(self, results: Sequence[FrameResult]) -> None:
        if self._place is not None:  # only now what was tracked before is given up
            self._show_in(*self._place)
        self._before, self._place = None, None
        self.verdict.say("", "")
        self.worst_button.hide()
        if len(results) == 1:
            self._doc.meshes_came.emit()
            for layer in self._seeds:  # they are of one time, and would cover the cells
                layer.visible = False
        if self.layers is not None:
            self.layers.show(results)
        if results[-1].mesh is None:
            self._doc.warned.emit(results[-1].message)
        self._show_frame()

    def _ended(self, outcome: Outcome) -> None:
        before, self._before, self._place = self._before, None, None
        if before is None:
            self._end(outcome.verdict, outcome.message)
        else:  # no new time was tracked
            self.work = before
            self._work_changed()
            self._show_worst(*self._words)
            self._show_frame()
        if outcome.verdict == "failed":
            self._doc.warned.emit(outcome.message)

    def _end(self, verdict: str, text: str) -> None:
        """Show how it ended, and whether it can go on."""
        work = self.work
        self._work_changed()
        if work is not None and work.results:
            n = len(work.results)
            kept = "" if verdict == "done" else f"{counted(n, 'time point')} kept, "
            text += f" ({kept}{duration(work.seconds)})"
        self._words = text, verdict
        self._show_worst(text, verdict)
        self._show_frame()

    def _show_worst(self, text: str, verdict: str) -> None:
        """Show how it ended, in the colour of the worst frame."""
        worst = worst_of(self.results)
        self.worst_button.setVisible(worst is not None)
        if worst is not None:
            told: list[str] = [worst.grade] if worst.grade in GRADES[1:] else []
            verdict = [*told, "fair"][0] if verdict == "done" else verdict
            told += [] if worst.moving is None else ["the surface still moves"]
            text += f"; worst at time {worst.frame}: {', '.join(told)}"
            self.worst_button.setText(f"Show time {worst.frame}")
        self.verdict.say(text, verdict)

    # ---------------------------------------------------------------------------- what is shown

    def _image_changed(self) -> None:
        layer = self._doc.image.layer
        self.setVisible(layer is not None and layer.ndim == 4)
        self._work_changed()

    def _work_changed(self) -> None:
        work, layers, can_go_on = self.work, self.layers, False
        # Without a job, no frame of a session has a mesh to go on from.
        if work is not None and work.job is not None and work.results and layers is not None:
            left = work.results[-1].frame < work.frames.stop - 1
            can_go_on = left and layers.image_layer is self._doc.image.layer
        allowed = not self._doc.work.occupied
        for one in (self.track_button, self.divisions, self.save_button):
            one.setEnabled(allowed)
        self.go_on_button.setVisible(can_go_on and allowed)
        self._show_first()

    def _show_first(self, event: Any = None) -> None:
        """Say which times would be left out, as tracking starts at the one shown."""
        doc, layers = self._doc, self.layers
        time = (0,) if doc.image.layer is None else doc.image.time
        tracked = layers is not None and layers.image_layer is doc.image.layer and layers.results
        left_out = 0 if doc.work.occupied or tracked or not time else time[-1]
        before = "time 0 is" if left_out == 1 else f"times 0 to {left_out - 1} are"
        text = f"Tracking starts at time {left_out}, the one shown: {before} left out."
        self.first.say(text if left_out else "")
        self.first_row.setVisible(left_out > 0)

    def _go_to_first(self) -> None:
        self._doc.viewer.dims.set_current_step(self._doc.viewer.dims.ndim - 4, 0)

    def _show_frame(self, event: Any = None) -> None:
        """Show the cells of the frame shown, and what happened in it."""
        layers = self.layers
        result = None if layers is None else layers.result
        for widget in (self.frame, self.save_button):
            widget.setVisible(layers is not None and bool(layers.results))
        self.table.setVisible(result is not None and result.mesh is not None)
        if layers is None or result is None:
            self.frame.setText("not tracked at this time")
        elif result.mesh is None:
            self.frame.setText(for_window(result.message))
        else:
            self.table.show_rows(measure_cells(result.mesh), layers.frame.length)
            self.table.show_swatches(layers.contours.colours_of)
            told = [*(event.text for event in result.events), result.message]
            text = f"time {result.frame}: {counted(len(result.cells), 'cell')}"
            told = [text, result.judgement, *told]
            self.frame.setText(for_window("; ".join(filter(None, told))))

    def _chosen(self, regions: tuple[int, ...], by_hand: bool) -> None:
        """Go to the cell chosen last."""
        if self.layers is not None and by_hand and regions:
            self.layers.go_to_frame(self.layers.number, self.table.center(regions[-1]))

    def _ask_folder(self) -> None:
        folder = QFileDialog.getExistingDirectory(self, "Folder for all times")
        if folder and self._may_replace(folder):
            self._doc.attempt(partial(self.save, folder))

    def _may_replace(self, folder: str) -> bool:
        """Whether the tracks of another run in a folder, if any, may be replaced."""
        text = f"{folder} holds the tracks of another run."
        there = (Path(folder) / "tracks.csv").exists()
        return not there or confirmed(self, "Replace them?", text, "Replace them", "Keep them")

    def _complain(self, message: str) -> None:
        self.verdict.say(message, "failed")
        self._doc.warned.emit(message)


def worst_of(results: Sequence[FrameResult]) -> FrameResult | None:
    """The frame with the least certain surfaces; None if all rest, and are good or not judged."""

    def doubt(result: FrameResult) -> tuple[int, bool]:
        grade = GRADES.index(result.grade) if result.grade in GRADES else 0
        return grade, result.moving is not None

    worst = max(results, key=doubt, default=None)
    return None if worst is None or doubt(worst) == (0, False) else worst


def _reopened(tracks: SavedTracks, frame: Frame, images: Frames) -> FitInput | None:
    """The job of a session; None if no frame has a mesh."""
    mesh = next((r.mesh for r in tracks.results if r.mesh is not None), None)
    if mesh is None:
        return None
    settings = tracks.settings
    image, optics = images[settings.track.first], optics_of(settings.scene)
    kind: SeedKind = "image" if tracks.shared_ground else "rough"
    return FitInput(settings, image, frame.grid(image.shape), mesh, optics, None, kind=kind)


def _prepared(settings: TrackRun, images: Frames, grid: Grid, seeds: Seeds) -> FitInput:
    """The job, put together in the thread."""
    pixels = images[settings.track.first]
    return put_together(settings, pixels, grid, partial(start_of, seeds), ground=False)
