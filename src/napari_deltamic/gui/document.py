"""What the window is about. Panels and tools observe it, and change it by its methods alone.

The image, the cells, the settings, the work under way, what fits of each image have reached, and
the cells chosen.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Generator, Sequence
from functools import partial
from typing import Any, Literal, get_args

from psygnal import Signal

from ..accuracy.experience import Learned
from ..common.doing import doing
from ..errors import DoubtWarning, listed
from ..evidence.put_together import put_together, start_of
from ..evidence.sanity import tell_doubts
from ..fitting.job import FitInput
from ..fitting.model.checks import check_image
from ..results.session_parts import SavedResult
from ..results.timeline import Moment, Timeline
from ..runs.settings import RunSettings, SceneSettings
from .cell_source import CellSource
from .fit_choice import FitChoice
from .image_source import ImageSource, SecondSource
from .record import Fitted, Present, Record
from .viewing.frame import Frame
from .viewing.listening import Connections, reference
from .viewing.viewer_link import ViewerLink
from .window_words import attempt
from .work import Background, Work

# What of an image may be another than when it was fitted.
Other = Literal["", "size", "pixels", "place"]
View = Literal["image", "rendered", "residual", "side by side"]
VIEWS: tuple[View, ...] = get_args(View)


class Document:
    """One for each window of the plugin."""

    cells_changed = Signal()  # those chosen, or what they hold
    began = Signal(bool)  # the first state of a fit is there; whether it has another mesh
    shown = Signal(object)  # a Snapshot of the fit under way
    ended = Signal()  # a fit has ended
    result_changed = Signal()  # it is another one, or it was changed by hand
    judged = Signal()  # more is known of the result
    grading = Signal(bool)  # whether it soon will be
    selection_changed = Signal()
    view_changed = Signal()
    looked_back = Signal()  # at an earlier moment of a fit, or at its end again
    said = Signal(str)  # what goes on
    noted = Signal(str)  # what came of something that the user did
    told = Signal(str)  # for a notification
    warned = Signal(str)
    failed = Signal(str)  # a fit could not start, or be shown
    finish_tools = Signal(object)  # the mouse is wanted by one: the others lay down theirs
    finish_placing = Signal(bool)  # cells are placed no more; whether their preview stays
    meshes_came = Signal()  # those of a fit: what would cover them is to be hidden
    points_wanted = Signal(object)  # in things, each of some places (um in the image's frame)
    unnoted = Signal(str)  # what was noted holds no more

    def __init__(self, viewer: Any) -> None:
        self.viewer = viewer
        self.image = ImageSource(viewer)
        self.cells = CellSource(viewer, self.image)
        self.second = SecondSource(viewer, self.image)
        self.settings = FitChoice(self.image, self.second)
        self.work = Work()
        self.work.remarked.connect(lambda warning: self.warned.emit(str(warning)))
        self.run: Any = None  # the last FitRun
        self.begun = False  # whether its first state was shown
        self.moment: Moment | None = None  # of a fit, that is looked at; None: its newest state
        self.records: dict[Any, Record] = {}  # by the layer of the image
        self.view: View = "image"
        self.selection: frozenset[int] = frozenset()
        self.learned = Learned()  # how long fits take on this machine
        self._last: list[Callable[[], None]] = []  # what is done when the window is closed
        self._at_stake: list[Callable[[], str]] = []  # tell what would be lost then
        self._of_run: Record | None = None
        self._rescued: Record | None = None  # its image went while it was fitted
        # That the last fit was started for, and what gives the voxels of its image.
        self._place: tuple[Frame, tuple[int, ...], Callable[[], Any]]
        self._fresh = True  # whether the run has a mesh of its own
        self._connections = Connections()
        self._connections.connect(viewer.layers.events.removed, self._layer_removed)
        for news in (self.image.changed, self.image.looked):
            news.connect(self._follow_image)

    # ---- what there is ------------------------------------------------------------------------

    @property
    def running(self) -> bool:
        return self.run is not None and bool(self.run.running)

    @property
    def record(self) -> Record | None:
        """The record of the running fit, else the rescued one, else that of the chosen image."""
        if self.running and self._of_run is not None:
            return self._of_run
        return self.rescued or self.records.get(self.image.layer)

    @property
    def rescued(self) -> Record | None:
        """The record of a fit whose image was removed meanwhile, until it is let go; else None."""
        record = self._rescued
        if record is None or self.running or record.link.image_layer in self.viewer.layers:
            return None
        return record if record.state is not None or self.image.layer is None else None

    @property
    def in_sight(self) -> bool:
        """Whether a fit runs, or an image is chosen and no rescued record is shown instead."""
        return self.running or (self.image.layer is not None and self.rescued is None)

    @property
    def result(self) -> Record | None:
        """The record if it has a result, else None."""
        record = self.record
        return record if record is not None and record.state is not None else None

    @property
    def link(self) -> ViewerLink | None:
        """The link that shows the record in the viewer; None without a record."""
        record = self.record
        return None if record is None else record.link

    def of_image(self, record: Record) -> bool:
        """Whether a record belongs to the chosen image, or its image is gone."""
        layer = record.link.image_layer
        return layer is self.image.layer or layer not in self.viewer.layers

    def name_of_other(self, record: Record | None) -> str:
        """The name of a record's image in quotes if another image is chosen; else ''."""
        if record is None or self.of_image(record):
            return ""
        return f"'{record.link.image_layer.name}'"

    @property
    def timeline(self) -> Timeline:
        """The moments of the record; an empty timeline without one."""
        record = self.record
        return Timeline() if record is None else record.timeline

    @property
    def other_size(self) -> str:
        """The fitted voxel size in words if the image has another one now; else ''.

        That of the fit which runs, or else of the result.
        """
        link = self.link
        return link.frame.size_in_words if link is not None and self.other == "size" else ""

    @property
    def other(self) -> Other:
        """How the image now differs from the one that was fitted, in a word; '' for not at all."""
        record = self.record
        if record is None or (self.running and not self.begun):
            return ""
        frame, layer = record.link.frame, record.link.image_layer
        if layer not in self.viewer.layers:
            return ""
        if not frame.has_size_of(layer):
            return "size"
        if record.pixels is not None and record.pixels() is not layer.data:
            return "pixels"
        return "" if frame.has_place_of(layer) else "place"

    def result_of_image(self) -> tuple[Record, Present] | None:
        """The result of the chosen image, or the newest state of its fit; None if it has none."""
        record = self.records.get(self.image.layer)
        if record is None:
            return None
        if record is self.record:
            present = self.present()
        else:
            present = None if record.state is None else Present(*record.of_fit(), False)
        return None if present is None else (record, present)

    def present(self) -> Present | None:
        """What can be changed: the newest state of the fit, or its result; None for nothing."""
        run = self.run
        if self.running:
            reached, job = run.reached, run.job
            if not self.begun or reached is None or job is None:
                return None  # all that is known belongs to another mesh
            return Present(reached[0], job, True, changes=reached[1])
        return None if self.result is None else Present(*self.result.of_fit(), False)

    def run_settings(self, seeds: str = "") -> RunSettings:
        """The settings of the whole run as chosen, the same object that the command line makes.

        seeds : their file; '' where they are in none.
        """
        scene, (path, channel) = self.settings.scene_settings(), self.image.file()
        if self.settings.psf_is_open:
            scene = scene.model_copy(update={"sigma": None})
        fit = self.settings.fit_settings()
        return RunSettings(image=path, channel=channel, seeds=seeds, scene=scene, fit=fit)

    def prepared(self) -> tuple[Callable[[], FitInput], Frame]:
        """A function that puts the chosen fit together, to run in a thread; and the fit's frame."""
        image, frame = self.image, self.image.frame()
        seeds = self.cells.seeds(frame)
        settings = self.run_settings(seeds.path)
        read, second = image.reader(), self.second.pixels()
        grid = frame.grid(image.shape())

        def prepare() -> FitInput:
            doing("reading the image")
            pixels = read()
            check_image(pixels, grid)  # which takes a while where the image is large
            start, tell = partial(start_of, seeds), _tell_ground
            job = put_together(settings, pixels, grid, start, tell=tell, second=second)
            tell_doubts(job)
            return job

        return prepare, frame

    # ---- what is done -------------------------------------------------------------------------

    def record_for(self, frame: Frame) -> Record:
        """The record of the chosen image, or a new one, for a fit in a frame at the time shown."""
        layer = self.image.layer
        time = tuple(self.viewer.dims.current_step[:-3])
        self._place = frame, time, reference(layer.data)
        record = self.records.get(layer)
        if record is None:
            record = self.records[layer] = Record(self._link_for(layer, frame))
        elif record.link.frame == frame:
            self.mend_link(record)
        return record

    def mend_link(self, record: Record) -> None:
        """Show a record in new layers if the user has removed one: those left are of no use."""
        link = record.link
        if not link.whole:
            link.remove()
            record.link = self._link_for(link.image_layer, link.frame)
            record.link.take_time(link.time)
            if record.state is not None:
                record.link.show_mesh(record.state.mesh)

    def start(self, run: Any, record: Record, *, fresh: bool) -> None:
        """Start a fit of the image of a record; InputError if something else runs."""
        self._forget_rescued()
        self.run, self._of_run, self.begun, self._fresh = run, record, False, fresh
        run.render = self.view != "image"
        self.work.start(run)
        self.said.emit("preparing the seeds ..." if fresh else "starting ...")

    def begin(self, record: Record) -> None:
        """Note that a run has its first state; only now what was there before is given up."""
        if not self.begun:
            self.begun = True
            record.begin(self._fresh)
            if self._fresh:
                self.meshes_came.emit()
                self._place_link(record)
            self.began.emit(self._fresh)

    def reopen(self, result: SavedResult, job: FitInput) -> Generator[None]:
        """Take over the result of an earlier fit of the chosen image, with its history.

        Where it yields, the window may do what waits.
        """
        self.let_go_rescued()
        record = self.record_for(self.image.frame())
        record.reopen(result)
        self.meshes_came.emit()
        self._place_link(record)
        record.link.show_mesh(result.state.mesh)
        yield
        record.take(result.state, job, result.history, result.seconds)
        self.note_saved(record, record.reached)
        for tell in (self.result_changed.emit, partial(self.began.emit, True), self.ended.emit):
            tell()
            yield

    def note_saved(self, record: Record, result: Fitted | None) -> None:
        """Note that a session file holds this result; None: it holds an intermediate state only."""
        record.saved = result or record.saved

    def let_go_rescued(self) -> None:
        """Drop the rescued record, and show again what is known about the chosen image."""
        if self._forget_rescued():
            self.image.changed.emit()

    def _forget_rescued(self) -> bool:
        """Drop the rescued record; returns whether there was one."""
        record, self._rescued = self._rescued, None
        if record is None or record.link.image_layer in self.viewer.layers:
            return False
        record.link.remove(but=self.cells.ticked)
        self.records.pop(record.link.image_layer, None)
        return True

    def look_back(self, moment: Moment | None) -> None:
        """Look at an earlier moment of a fit; None: at its newest state again."""
        self.moment = moment
        self.looked_back.emit()

    def select(self, regions: Sequence[int] | frozenset[int]) -> None:
        chosen = frozenset(regions)
        if chosen != self.selection:
            self.selection = chosen
            self.selection_changed.emit()

    def look(self, view: View) -> None:
        """Show the image, or what the fit says about it; view : one of ``VIEWS``."""
        if view != self.view:
            self.view = view
            if self.run is not None:
                self.run.render = view != "image"
            self.view_changed.emit()

    def look_further(self) -> None:
        """Show the next of ``VIEWS`` in turn."""
        self.look(VIEWS[(VIEWS.index(self.view) + 1) % len(VIEWS)])

    def busy(self) -> bool:
        """Whether something runs that must be stopped first; if so, the user is told."""
        if self.work.occupied:
            self.told.emit(self.work.occupied)
        return bool(self.work.occupied)

    def guarded(self, action: Callable[[], None], checked: bool = False) -> None:
        """Run an action about the fit; if it fails, the user reads why, without a traceback."""
        attempt(action, self.refuse)

    def attempt(self, action: Callable[[], None], checked: bool = False) -> None:
        """The same for actions that do not concern the fit shown, such as those on files."""
        attempt(action, self.warned.emit)

    def refuse(self, reason: str) -> None:
        """Tell the user why something was not done."""
        self.noted.emit(reason)
        self.warned.emit(reason)

    def background(self, on_error: Callable[[str], None]) -> Background:
        """An object that runs short functions in a thread, until the window is closed."""
        made = Background(on_error)
        self.at_end(made.close)
        return made

    def listen(self, emitter: Any, slot: Callable[..., None], **how: Any) -> None:
        """Connect a slot to events of the viewer until the window is closed."""
        self._connections.connect(emitter, slot, **how)

    def at_end(self, *calls: Callable[[], None]) -> None:
        """Register calls to be made when the window is closed."""
        self._last += calls

    def would_end(self) -> str:
        """A text on what closing the window would end or lose, and what is kept; '' for nothing."""
        ends = "" if self.work.task is None else self.work.task.kept
        tell = (self._unsaved_results, *self._at_stake)
        loses = [text for text in (one() for one in tell) if text]
        if loses:
            loses.append("To keep all of it, choose More > Save session first.")
        return "\n\n".join(filter(None, (ends, " ".join(loses))))

    def ask_before_losing(self, tell: Callable[[], str]) -> None:
        """Register a function that tells in a sentence what else would be lost; '' for nothing."""
        self._at_stake.append(tell)

    def _unsaved_results(self) -> str:
        names = [f"'{r.link.image_layer.name}'" for r in self.records.values() if r.unsaved]
        if not names:
            return ""
        return (
            f"Grade, table and history of {listed('image', names)} would be lost; the meshes stay "
            "in the viewer."
        )

    def close(self, gone: Any = None) -> None:
        """End everything; further calls do nothing."""
        self.work.close()
        for record in list(self.records.values()):
            record.link.close()
        self._connections.undo()
        for do in self._last:
            do()
        for source in (self.second, self.cells, self.image):
            source.close_links()
        self._last, self.run, self._of_run, self._rescued = [], None, None, None
        self._at_stake = []
        self.records.clear()
        for signals in (self, self.image, self.cells, self.second, self.settings, self.work):
            for name in dir(type(signals)):
                if isinstance(getattr(type(signals), name), Signal):
                    getattr(signals, name).disconnect()

    def _place_link(self, record: Record) -> None:
        """Place what is shown of a record where its last fit was started, and at that time."""
        frame, time, record.pixels = self._place
        if record.link.frame != frame:
            old, record.link = record.link, self._link_for(record.link.image_layer, frame)
            # What it showed lies elsewhere now; cells of another fit start there, perhaps.
            old.remove(but=self.cells.ticked)
        record.link.take_time(time)
        self._follow_image()

    def _link_for(self, layer: Any, frame: Frame) -> ViewerLink:
        link = ViewerLink(self.viewer, layer, frame)
        link.follow_image(layer is self.image.layer)
        return link

    def _follow_image(self) -> None:
        """Show only the fit of the chosen image, and only as long as it lies on that."""
        for record in self.records.values():
            link = record.link
            on_it = link.image_layer not in self.viewer.layers or link.frame.lies_on(
                link.image_layer
            )
            link.follow_image(on_it and self.of_image(record))

    def _layer_removed(self, event: Any) -> None:
        """Drop the record of a removed image; if it was being fitted, rescue it for saving."""
        layer, record = event.value, self.records.get(event.value)
        if self.running and self._of_run is not None:
            self._end_without(layer, self._of_run)
        if record is not None and self.running and record is self._of_run:
            self._rescued = record
        elif record is not None:
            record.link.close()
            del self.records[layer]

    def _end_without(self, layer: Any, record: Record) -> None:
        """Stop the fit if it needs a layer that was removed; what it reached is kept."""
        needed = {
            record.link.image_layer: "image layer",
            record.link.surface: "layer of the meshes",
        }
        if layer in needed and not self.run.stopping:
            self.work.stop()
            text = (
                f"the fit ends, as the {needed[layer]} was removed; its result can still be saved"
            )
            self.warned.emit(text)


def _tell_ground(scene: SceneSettings, uneven: str, told: bool) -> None:
    if uneven:
        warnings.warn(uneven, DoubtWarning, stacklevel=2)
