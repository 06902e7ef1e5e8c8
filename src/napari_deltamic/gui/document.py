"""What the window is about. Panels and tools observe it, and change it by its methods alone.

The image, the cells, the settings, the work under way, what fits of each image have reached, and
the cells chosen.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray
from psygnal import Signal

from ..accuracy.experience import Learned
from ..errors import DoubtWarning, InputError
from ..evidence.first_sigma import with_first_psf
from ..evidence.sanity import tell_doubts
from ..evidence.tilted_ground import with_ground
from ..fitting import FitState
from ..fitting.checks import check_image
from ..fitting.job import FitInput, assemble, levelled
from ..measure import measure_cells
from ..results.judged import Judged
from ..results.report import History
from ..results.timeline import Moment, Timeline
from ..runs.seeds import Seeds
from ..runs.settings import FitSettings, RunSettings, SceneSettings
from .image_source import ImageSource, SecondSource
from .seeding.cell_source import CellSource
from .viewing.frame import Frame
from .viewing.listening import Connections
from .viewing.viewer_link import ViewerLink
from .work import Background, Work, attempt

View = Literal["image", "rendered", "residual", "side by side"]
VIEWS: tuple[View, ...] = get_args(View)


@dataclass(eq=False)
class Record:
    """What fits of one image have reached.

    words : how the last one ended: in a word, and in text.
    state, job : of the result; None before there is one.
    rows : measurements of its cells.
    judged : how good it is, once that is known.
    """

    link: ViewerLink
    timeline: Timeline = field(default_factory=Timeline)
    words: tuple[str, str] = ("", "")
    state: FitState | None = None
    job: FitInput | None = None
    history: History = field(default_factory=History)
    seconds: float = 0.0
    rows: Sequence[Mapping[str, Any]] = ()
    judged: Judged | None = None

    def of_fit(self) -> tuple[FitState, FitInput]:
        """State and job of the result. InputError where there is none."""
        if self.state is None or self.job is None:
            raise InputError("there is no result yet: run a fit first")
        return self.state, self.job

    def end(self, verdict: str, text: str) -> None:
        self.words = verdict, text

    def show(self, state: FitState, note: str = "", *, passing: bool = False) -> None:
        """The fit has come to a state, by what the user changed where there is a note."""
        self.timeline.add(state, note)
        self.link.show_mesh(state.mesh, passing=passing)

    def take(self, state: FitState, job: FitInput | None, history: History, seconds: float) -> None:
        """Take a state for the result; of how good it is, nothing is known yet."""
        self.state, self.job, self.history, self.seconds = state, job, history, seconds
        self.rows, self.judged = measure_cells(state.mesh), None

    def pin(self, pinned: NDArray[np.bool_]) -> None:
        """Note which vertices of the result are pinned, (V,), for a fit that goes on."""
        if self.state is not None:
            self.state = replace(self.state, pinned=pinned)

    def judge(self, judged: Judged) -> None:
        """Take over how good the result is, and what that says of each cell."""
        self.judged = judged
        self.rows = [{**row, **judged.cells.get(int(row["region"]), {})} for row in self.rows]


@dataclass(frozen=True, eq=False)
class Present:
    """What there is to change.

    running : whether a fit goes on from it.
    """

    state: FitState
    job: FitInput
    running: bool


class FitChoice(Protocol):
    """Gives what of a fit is chosen, and shows it; InputError names what cannot be used."""

    optics: Any
    effects: Any
    accuracy: Any

    @property
    def psf_is_open(self) -> bool:
        """Whether nobody has said what the PSF is: the image is to tell it when a fit starts."""

    def fit_settings(self) -> FitSettings:
        """Those of the fit."""

    def other_settings(self) -> FitSettings:
        """The same without the accuracy."""

    def scene_settings(self) -> SceneSettings:
        """Voxel size of the image chosen, PSF and effects."""

    def show_settings(self, settings: FitSettings) -> None:
        """Show those of a fit."""

    def show_scene(self, scene: SceneSettings) -> None:
        """Show a PSF and effects, which belong to the image chosen."""


class Document:
    """One for each window of the plugin."""

    cells_changed = Signal()  # those chosen, or what they hold
    settings_changed = Signal()  # by the user
    began = Signal(bool)  # the first state of a fit is there; whether it has another mesh
    shown = Signal(object)  # a Snapshot of the fit under way
    ended = Signal()  # a fit has ended
    result_changed = Signal()  # it is another one, or it was changed by hand
    judged = Signal()  # more is known of the result
    selection_changed = Signal()
    view_changed = Signal()
    said = Signal(str)  # what goes on
    noted = Signal(str)  # what came of something that the user did
    told = Signal(str)  # for a notification
    warned = Signal(str)
    failed = Signal(str)  # a fit could not start, or be shown
    finish_tools = Signal(object)  # the mouse is wanted by one: the others lay down theirs
    finish_placing = Signal(bool)  # cells are placed no more; whether their preview stays
    meshes_came = Signal()  # those of a fit: what would cover them is to be hidden
    clicks_wanted = Signal(object)  # at places, um in the image's frame

    settings: FitChoice

    def __init__(self, viewer: Any) -> None:
        self.viewer = viewer
        self.image = ImageSource(viewer)
        self.cells = CellSource(viewer, self.image)
        self.second = SecondSource(viewer, self.image)
        self.work = Work()
        self.work.remarked.connect(self.warned.emit)
        self.run: Any = None  # the last FitRun
        self.begun = False  # whether its first state was shown
        self.earlier = False  # whether an earlier moment of a fit is looked at
        self.records: dict[Any, Record] = {}  # by the layer of the image
        self.view: View = "image"
        self.selection: frozenset[int] = frozenset()
        self.learned = Learned()  # how long fits take on this machine
        self._last: list[Callable[[], None]] = []  # what is done when the window is closed
        self._of_run: Record | None = None
        self._fresh = True  # whether the run has a mesh of its own
        self._closed = False
        self._connections = Connections()
        self._connections.connect(viewer.layers.events.removed, self._layer_removed)

    # ---- what there is ------------------------------------------------------------------------

    @property
    def running(self) -> bool:
        return self.run is not None and bool(self.run.running)

    @property
    def record(self) -> Record | None:
        """That of the fit that runs, else that of the image chosen; without any, the last one."""
        layer = self.image.layer
        if layer is None or (self.running and self._of_run is not None):
            return self._of_run
        return self.records.get(layer)

    @property
    def result(self) -> Record | None:
        """The record where it has a result."""
        record = self.record
        return record if record is not None and record.state is not None else None

    @property
    def link(self) -> ViewerLink | None:
        """What shows it in the viewer."""
        record = self.record
        return None if record is None else record.link

    @property
    def timeline(self) -> Timeline:
        """Its moments."""
        record = self.record
        return Timeline() if record is None else record.timeline

    def present(self) -> Present | None:
        """What there is to change: the newest state of the fit, or its result."""
        run = self.run
        if self.running:
            if not self.begun or run.state is None or run.job is None:
                return None  # all that is known belongs to another mesh
            return Present(run.state, run.job, True)
        result = self.result
        if result is None or result.state is None or result.job is None:
            return None
        return Present(result.state, result.job, False)

    def run_settings(self, seeds: Seeds | None = None) -> RunSettings:
        """The whole run as it is chosen, the same object that the command line makes."""
        seeds = seeds or self.cells.seeds(self.image.frame())
        scene = self.settings.scene_settings()
        if self.settings.psf_is_open:
            scene = scene.model_copy(update={"sigma": None})
        return RunSettings(
            image=self.image.path(),
            channel=self.image.channel(),
            seeds=seeds.path,
            scene=scene,
            fit=self.settings.fit_settings(),
        )

    def prepared(self) -> tuple[Callable[[], FitInput], Frame]:
        """What puts together, in a thread, the fit that is chosen; and its frame."""
        image, frame = self.image, self.image.frame()
        seeds = self.cells.seeds(frame)
        settings = self.run_settings(seeds)
        read, second = image.reader(), self.second.pixels()
        grid = frame.grid(image.shape())

        def prepare() -> FitInput:
            pixels = read()
            check_image(pixels, grid)  # which takes a while where the image is large
            scene, uneven = with_ground(settings.scene, pixels)
            if uneven:
                warnings.warn(uneven, DoubtWarning, stacklevel=2)
            level = levelled(pixels, grid, scene.effects)
            scene, _ = with_first_psf(scene, level)
            whole = settings.model_copy(update={"scene": scene})
            start = seeds.make(level, grid)
            job = assemble(whole, pixels, grid, start, seeds.kind, second)
            tell_doubts(job)
            return job

        return prepare, frame

    # ---- what is done -------------------------------------------------------------------------

    def record_for(self, frame: Frame) -> Record:
        """The record of the image chosen, with a link whose layers are still of use."""
        layer = self.image.layer
        record = self.records.get(layer)
        if record is None:
            record = self.records[layer] = Record(self._link_for(layer, frame))
        elif record.link.frame == frame:
            self.mend_link(record)
            record.link.take_time()
        else:
            record.link.close()
            record.link = self._link_for(layer, frame)
        return record

    def mend_link(self, record: Record) -> None:
        """Show a record by new layers where the user has removed one: those left are of no use."""
        link = record.link
        if not link.whole:
            link.remove()
            record.link = self._link_for(link.image_layer, link.frame)
            record.link.take_time(link.time)
            if record.state is not None:
                record.link.show_mesh(record.state.mesh)

    def start(self, run: Any, record: Record, *, fresh: bool) -> None:
        """Start a fit of the image of a record; InputError where something else runs."""
        record.words, record.judged = ("", ""), None
        self.run, self._of_run, self.begun, self._fresh = run, record, False, fresh
        run.render = self.view != "image"
        self.work.start(run)
        self.said.emit("preparing the seeds ..." if fresh else "starting ...")

    def begin(self, record: Record) -> None:
        """The first state of a run is there: only now that before it is given up."""
        if not self.begun:
            self.begun = True
            if self._fresh:
                self.meshes_came.emit()
                record.timeline = Timeline()
            else:
                record.timeline.go_on()
            self.began.emit(self._fresh)

    def reopen(
        self,
        state: FitState,
        job: FitInput,
        history: History,
        seconds: float,
        moments: Iterable[Moment],
        words: tuple[str, str] = ("", ""),
    ) -> None:
        """Take over the result of an earlier fit of the image chosen, with its history."""
        record = self.record_for(self.image.frame())
        record.timeline, record.words = Timeline(moments), words
        self.meshes_came.emit()
        record.link.show_mesh(state.mesh)
        record.take(state, job, history, seconds)
        self.result_changed.emit()
        self.began.emit(True)
        self.ended.emit()

    def take_settings(self, settings: FitChoice) -> None:
        """Who knows what of a fit is chosen."""
        self.settings = settings

    def look_back(self, earlier: bool) -> None:
        """Whether an earlier moment of a fit is looked at."""
        self.earlier = earlier

    def select(self, regions: Sequence[int] | frozenset[int]) -> None:
        chosen = frozenset(regions)
        if chosen != self.selection:
            self.selection = chosen
            self.selection_changed.emit()

    def look(self, view: View) -> None:
        """Look at the image, or at what the fit says of it."""
        if view != self.view:
            self.view = view
            if self.run is not None:
                self.run.render = view != "image"
            self.view_changed.emit()

    def look_further(self) -> None:
        """At the image, the rendered one, the residual, or both images, in turn."""
        self.look(VIEWS[(VIEWS.index(self.view) + 1) % len(VIEWS)])

    def guarded(self, action: Callable[[], None]) -> None:
        """Run something that may fail; the user reads why, without a traceback."""
        attempt(action, self.refuse)

    def refuse(self, reason: str) -> None:
        """Tell why something was not done."""
        self.noted.emit(reason)
        self.warned.emit(reason)

    def background(self, on_error: Callable[[str], None]) -> Background:
        """Runs short functions, as long as there is a window."""
        made = Background(on_error)
        self.at_end(made.close)
        return made

    def listen(self, emitter: Any, slot: Callable[..., None]) -> None:
        """Connect a slot to events of the viewer, as long as there is a window."""
        self._connections.connect(emitter, slot)

    def at_end(self, *calls: Callable[[], None]) -> None:
        """What is to be done when the window is closed."""
        self._last += calls

    def would_end(self) -> str:
        """What closing the window would end, and what is kept of it; '' for nothing."""
        return "" if self.work.task is None else self.work.task.kept

    def close(self, gone: Any = None) -> None:
        """End everything; once is enough."""
        if self._closed:
            return
        self._closed = True
        self.work.close()
        for record in list(self.records.values()):
            record.link.close()
        self._connections.undo()
        for do in self._last:
            do()
        for source in (self.second, self.cells, self.image):
            source.close_links()
        self._last, self.run, self._of_run = [], None, None
        self.records.clear()
        vars(self).pop("settings", None)
        for signals in (self, self.image, self.cells, self.second, self.work):
            for name in dir(type(signals)):
                if isinstance(getattr(type(signals), name), Signal):
                    getattr(signals, name).disconnect()

    def _link_for(self, layer: Any, frame: Frame) -> ViewerLink:
        return ViewerLink(self.viewer, layer, frame, partial(self._lost, layer))

    def _lost(self, layer: Any, reason: str) -> None:
        """A layer that the fit needs is gone: end it, keep what it reached."""
        record = self.record
        lost = record is not None and record.link.image_layer is layer
        if lost and self.running and not self.run.stopping:
            self.work.stop()
            self.warned.emit(f"the fit ends, as {reason}; its result can still be saved")

    def _layer_removed(self, event: Any) -> None:
        """What is known of an image goes with it; of the last one fitted it can still be saved."""
        record = self.records.get(event.value)
        if record is not None and record is not self._of_run:
            record.link.close()
            del self.records[event.value]
