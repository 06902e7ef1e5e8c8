"""What the window is about. Panels and tools read and write it; none of them knows another.

The image, the cells, the settings, the work under way, what fits of each image have reached, and
the cells chosen. It knows no widget: the panels that choose cells and settings are known to it by
what they give.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from psygnal import Signal

from ..accuracy.experience import Learned
from ..errors import InputError
from ..evidence.first_sigma import with_first_psf
from ..evidence.sanity import tell_doubts
from ..evidence.tilted_ground import with_ground
from ..fitting import FitState
from ..fitting.checks import check_image
from ..fitting.job import FitInput, assemble, levelled
from ..results.judged import Judged
from ..results.report import History
from ..results.timeline import Timeline
from ..runs.seeds import Seeds
from ..runs.settings import RunSettings
from .attempt import attempt
from .image_source import ImageSource
from .viewing.connections import Connections
from .viewing.frame import Frame
from .viewing.viewer_link import ViewerLink
from .work import Work

View = Literal["image", "rendered", "residual", "side by side"]
VIEWS: tuple[View, ...] = get_args(View)


@dataclass(eq=False)
class Record:
    """What fits of one image have reached.

    words : how the last one ended: in a word, and in text.
    state, job : of the result; None before there is one.
    rows : measurements of its cells.
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


@dataclass(frozen=True, eq=False)
class Present:
    """What there is to change.

    running : whether a fit goes on from it.
    """

    state: FitState
    job: FitInput
    running: bool


class Document:
    """One for each window of the plugin.

    Parameters
    ----------
    viewer : a napari viewer or its model.
    """

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

    cells: Any  # the panel that chooses them
    settings: Any  # the panel that chooses what of a fit can be chosen

    def __init__(self, viewer: Any) -> None:
        self.viewer = viewer
        self.image = ImageSource(viewer)
        self.work = Work()
        self.work.remarked.connect(self.warned.emit)
        self.run: Any = None  # the last FitRun
        self.begun = False  # whether its first state was shown
        self.earlier = False  # whether an earlier moment of a fit is looked at
        self.records: dict[Any, Record] = {}  # by the layer of the image
        self.view: View = "image"
        self.selection: frozenset[int] = frozenset()
        self.learned = Learned()  # how long fits take on this machine
        self.parts: list[Any] = []  # that end with the window
        self._of_run: Record | None = None
        self._closed = False
        self._connections = Connections()
        self._connections.connect(viewer.layers.events.removed, self._layer_removed)

    # ---- what there is ------------------------------------------------------------------------

    @property
    def running(self) -> bool:
        """Whether a fit runs."""
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
        read, second = image.reader(), self.settings.effects.second.pixels()
        grid = frame.grid(image.shape())

        def prepare() -> FitInput:
            pixels = read()
            check_image(pixels, grid)  # which takes a while where the image is large
            scene, _ = with_ground(settings.scene, pixels)
            level = levelled(pixels, grid, scene)
            scene, _ = with_first_psf(scene, level)
            whole = settings.model_copy(update={"scene": scene})
            start = seeds.make(level, grid)
            job = assemble(whole, pixels, grid, start, seeds.kind, second)
            tell_doubts(job)
            return job

        return prepare, frame

    # ---- what is done -------------------------------------------------------------------------

    def record_for(self, frame: Frame, on_lost: Callable[[str], None]) -> Record:
        """The record of the image chosen, with a link whose layers are still of use."""
        layer = self.image.layer
        record = self.records.get(layer)
        if record is not None:
            link = record.link
            if link.frame == frame and link.surface in (None, *self.viewer.layers):
                link.take_time()
                return record
            link.close()
            record.link = ViewerLink(self.viewer, layer, frame, on_lost)
            return record
        record = self.records[layer] = Record(ViewerLink(self.viewer, layer, frame, on_lost))
        return record

    def take_run(self, run: Any, record: Record) -> None:
        """A fit is to start, of the image of a record."""
        self.run, self._of_run, self.begun = run, record, False

    def select(self, regions: Sequence[int] | frozenset[int]) -> None:
        """Choose cells."""
        chosen = frozenset(regions)
        if chosen != self.selection:
            self.selection = chosen
            self.selection_changed.emit()

    def look(self, view: View) -> None:
        """Look at the image, or at what the fit says of it."""
        if view != self.view:
            self.view = view
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
        for part in (*self.parts, self.image):
            part.close_links()
        self.parts, self.run, self._of_run = [], None, None
        self.records.clear()
        for name in ("cells", "settings"):
            vars(self).pop(name, None)
        for signals in (self, self.image, self.work):
            for name in dir(type(signals)):
                if isinstance(getattr(type(signals), name), Signal):
                    getattr(signals, name).disconnect()

    def _layer_removed(self, event: Any) -> None:
        """What is known of an image goes with it; of the last one fitted it can still be saved."""
        record = self.records.get(event.value)
        if record is not None and record is not self._of_run:
            record.link.close()
            del self.records[event.value]


def missing_cells() -> InputError:
    """No cells were chosen."""
    return InputError("no cells yet: press 'Find cells', or 'Click cells' and click inside each")
