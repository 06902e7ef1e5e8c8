"""What drives a run: its start, pause and stop, what it shows in the viewer, and how it ends."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QObject

from ...accuracy.forecast import Experience, Forecast
from ...errors import InputError
from ...evidence.sanity import tell_doubts
from ...fitting import Change, FitState
from ...fitting.checks import check_image
from ...fitting.job import FitInput, assemble, scene_with
from ...geometry import Mesh
from ...results.report import History
from ...results.timeline import Moment, Timeline
from ...runs.seeds import Seeds
from ...runs.settings import NEAR_LEVELS, RunSettings
from ..attempt import attempt
from ..editing.edits import Present, changed_by_hand
from ..qt import Signal
from ..viewing.frame import Frame
from ..viewing.viewer_link import ViewerLink
from .composition import Live, Panels
from .overlays import Overlays
from .run_progress import INTERVAL, Forecaster, Outcome, Snapshot
from .waiting import usable
from .worker import FitRun, expected


class RunControl(QObject):
    """One run at a time, from the panels to the viewer.

    Parameters
    ----------
    viewer : a napari viewer or its model.
    panels : what to run, and where it is shown.
    live : what ends with the widget.
    tell, warn : show the user a sentence.
    forecaster : see ``FitRun``.
    parent : Qt's.
    """

    started = Signal()
    began = Signal(bool)  # the first state of a run is there; whether it has another mesh
    shown = Signal(object)  # a Snapshot
    ended = Signal()
    mesh_changed = Signal()  # in the result, by hand

    def __init__(
        self,
        viewer: Any,
        panels: Panels,
        live: Live,
        tell: Callable[[str], None],
        warn: Callable[[str], None],
        forecaster: Callable[[FitInput], Forecaster | None] | None = expected,
        parent: QObject | None = None,
    ) -> None:
        super().__init__(parent)
        self.timeline = Timeline()
        self.interval = INTERVAL  # s between two updates of the viewer, at least
        self._forecaster = forecaster
        self._asked: list[tuple[int, str]] = []  # changes by number, until the fit has them
        self._lets_go = False
        # Weak references to the image layers of the result, and of what the run panel says.
        self._result_of: Any = None
        self._words_of: Any = None
        self._words = ("", "")  # the verdict, while another image is chosen
        self._fresh: bool | None = None  # whether the run has a new mesh; None once it has begun
        self._viewer, self._panels, self._live = viewer, panels, live
        self._tell, self._warn = tell, warn
        running = panels.running
        running.run.connect(self.start)
        running.pause.connect(self.pause)
        running.stop.connect(self.stop)
        panels.image.changed.connect(self._image_changed)
        self._overlays = Overlays(panels, live, warn, self)

    def run_settings(self, seeds: Seeds | None = None) -> RunSettings:
        """The whole run as it is shown, the same object that the command line makes."""
        panels = self._panels
        seeds = seeds or panels.seeds.seeds(panels.image.frame())
        return RunSettings(
            image=panels.image.path(),
            seeds=seeds.path,
            scene=panels.settings.scene_settings(),
            fit=panels.settings.fit_settings(),
        )

    def start(self) -> None:
        """Start a fit of what is chosen; says in plain words what is missing."""
        occupied = self._live.occupied
        if occupied:
            self._tell(occupied)
            return
        self.guarded(self._start)

    def pause(self, paused: bool) -> None:
        """Let the fit wait, or go on."""
        if self._live.run is not None:
            self._live.run.pause(paused)

    def stop(self) -> None:
        """End the fit; what it reached is kept."""
        if self._live.run is not None:
            self._live.run.stop()
            self._panels.running.say("stopping ...")

    def guarded(self, action: Callable[[], None]) -> None:
        """Run something that may fail; the user reads why, without a traceback."""
        attempt(action, self._complain)

    def tried(self, action: Callable[[], None]) -> None:
        """The same for something that says nothing about how the fit ended."""
        attempt(action, self._refused)

    # ------------------------------------------------------------------- changes on the way

    def present(self) -> Present | None:
        """What there is to change: the newest state of the fit, or its result."""
        run, last = self._live.run, self._panels.results.last
        if run is not None and run.running:
            if self._fresh is not None or run.state is None or run.job is None:
                return None  # it has not begun: all that is known belongs to another mesh
            return Present(run.state, run.job, True)
        if last is None or not self._of_link:
            return None
        return Present(last[0], last[1], False)

    @property
    def _of_link(self) -> bool:
        """Whether the result is of the image that the link shows, and not of one before it."""
        link, of = self._live.link, self._result_of
        return link is not None and of is not None and of() is link.image_layer

    def ask(self, change: Change, note: str, of: Mesh) -> int:
        """Let the fit go on from something else, made of a mesh; the note is told when it does.

        Snapshots include it from the number returned on.
        """
        assert self._live.run is not None, "there is a fit to change"
        number = self._live.run.change(change, of)
        self._asked.append((number, note))
        return number

    def ask_shift(self, shift: NDArray[np.float64], note: str, of: Mesh) -> None:
        """Let the fit go on with its vertices moved, (V, 3) um."""
        if self._live.run is not None:
            self._asked.append((self._live.run.shift(shift, of), note))

    def replace_result(self, state: FitState, note: str) -> None:
        """Take a state for the result: it was changed by hand."""
        last = self._panels.results.last
        if last is None:
            return
        self.timeline.add(state, note)
        if self._live.link is not None:
            self._live.link.show_mesh(state.mesh)
        self._panels.running.psf.show_sigma("now", state.optics.sigma_um)
        self._panels.running.numbers.show_fit(state, last[1])
        self._panels.results.show_result(state, *last[1:])
        self._panels.running.tell(f"{note}: the result was changed by hand")
        self._overlays.show_result()
        self.mesh_changed.emit()

    def pin_result(self, pinned: NDArray[np.bool_]) -> None:
        """Note which vertices of the result are pinned, (V,) bool, for a fit that goes on."""
        results = self._panels.results
        if results.last is not None:
            results.last = (replace(results.last[0], pinned=pinned), *results.last[1:])

    def reopen(
        self,
        state: FitState,
        job: FitInput,
        history: History,
        seconds: float,
        moments: Iterable[Moment],
    ) -> None:
        """Take over the result of an earlier fit of the image chosen, with its history."""
        running = self._panels.running
        self._link_to(self._panels.image.frame())
        self._show_result(state, job, history, seconds)
        self._fresh = True
        self._begin()
        self.timeline = Timeline(moments)
        if self._live.link is not None:
            self._live.link.show_mesh(state.mesh)
        running.curve.show_losses(history.loss, history.level, history.first)
        running.psf.show_sigma("now", state.optics.sigma_um)
        running.numbers.show_fit(state, job)
        self._overlays.show_result()
        self.ended.emit()

    def go_on_from(self, mesh: Mesh, optics: Any, pinned: NDArray[np.bool_] | None) -> None:
        """Start a fit from a state of the last one, with little blur. InputError if it cannot."""
        last, link = self._panels.results.last, self._live.link
        if self._live.occupied:
            raise InputError(self._live.occupied)
        if last is None or link is None or not self._of_link:
            raise InputError("there is no fit of this image to go on from")
        if link.image_layer not in self._viewer.layers:
            raise InputError("the image of that fit is no longer open")
        fit = self._panels.settings.fit_settings().model_copy(update={"levels": NEAR_LEVELS})
        old = last[1].settings
        # The seeds of that fit would not repeat this one.
        scene = scene_with(old.scene, optics)
        settings = old.model_copy(update={"fit": fit, "scene": scene, "seeds": ""})
        job = replace(last[1], settings=settings, mesh=mesh, optics=optics)
        first = None
        if pinned is not None and pinned.any():
            first = Change(mesh=mesh, pinned=pinned)
        if link.surface not in self._viewer.layers:
            link.close()
            self._live.link = ViewerLink(self._viewer, link.image_layer, link.frame, self._lost)
        self._launch(lambda: job, fresh=False, first=first)

    def hold(self, mesh: Mesh) -> None:
        """Show a mesh, whatever the fit does, until ``let_go``."""
        self._lets_go = False
        if self._live.link is not None:
            self._live.link.hold(mesh)

    def let_go(self) -> None:
        """Show the newest mesh again, as soon as the fit has taken over all changes."""
        self._lets_go = bool(self._asked)
        if self._live.link is not None and not self._lets_go:
            self._live.link.let_go()

    # ------------------------------------------------------------------------------------- runs

    def _start(self) -> None:
        image = self._panels.image
        frame = image.frame()
        seeds = self._panels.seeds.seeds(frame)
        settings = self.run_settings(seeds)
        pixels, second = image.stack(), self._panels.settings.effects.second.pixels()
        grid = frame.grid(pixels.shape)

        def prepare() -> FitInput:
            check_image(pixels, grid)  # which takes a while where the image is large
            start = seeds.make(pixels, grid)
            job = assemble(settings, pixels, grid, start, seeds.kind, second)
            tell_doubts(job)
            return job

        self._link_to(frame)
        self._panels.seeds.finish_placing(keep_preview=True)
        self._launch(prepare, fresh=True)

    def _launch(
        self,
        prepare: Callable[[], FitInput],
        *,
        fresh: bool,
        first: Change | None = None,
    ) -> None:
        running = self._panels.running
        assert self._live.link is not None
        self._words_of = weakref.ref(self._live.link.image_layer)
        self._fresh, self._asked = fresh, []
        self._overlays.forget()
        run = FitRun(
            prepare,
            self._show,
            self._ended,
            self._warn,
            self._not_taken,
            self._forecaster and partial(_after, self._live.experience, self._forecaster),
            first,
        )
        self._live.run = run
        run.show_rendered(self._overlays.wanted)
        run.update_every(self.interval)
        running.set_running(True)
        running.say("preparing the seeds ..." if fresh else "starting ...")
        self.started.emit()
        run.start()

    def _link_to(self, frame: Frame) -> None:
        """A link for the image chosen; that of the last run if its layers are still of use."""
        image = self._panels.image.layer
        old = self._live.link
        if old is not None:
            same = old.image_layer is image and old.frame == frame
            if same and old.surface in self._viewer.layers:
                old.take_time()
                return
            old.close()
        self._live.link = ViewerLink(self._viewer, image, frame, self._lost)

    def _begin(self) -> None:
        """The first state of a run is there: only now that before it is given up."""
        fresh, self._fresh = self._fresh, None
        if fresh is None:
            return
        run = self._live.run
        if run is not None and run.job is not None:
            self._panels.running.psf.show_sigma("start", run.job.optics.sigma_um)
        if fresh:
            self._panels.seeds.make_room()
            self.timeline = Timeline()
        else:
            self.timeline.go_on()
        self.began.emit(fresh)

    def _show(self, snapshot: Snapshot) -> None:
        run, link = self._live.run, self._live.link
        if run is None or link is None:
            return
        self._begin()
        state, running = snapshot.state, self._panels.running
        note = self._taken_over(snapshot)
        self.timeline.add(state, note)
        link.show_mesh(state.mesh, passing=True)
        if self._lets_go:
            self.let_go()
        self._overlays.show_snapshot(snapshot)
        running.numbers.show_fit(state, snapshot.job)
        running.show_progress(
            run.history,
            state.level,
            state.levels,
            snapshot.iterations_per_second,
            snapshot.remaining,
        )
        if note:
            running.tell(f"{note} from iteration {state.iteration}")
        self.shown.emit(snapshot)

    def _taken_over(self, snapshot: Snapshot) -> str:
        """What the fit has taken over since the last snapshot, in words."""
        notes = [note for number, note in self._asked if number <= snapshot.changes]
        self._asked = [(n, note) for n, note in self._asked if n > snapshot.changes]
        return ", ".join(dict.fromkeys(notes))

    def _not_taken(self, reason: str) -> None:
        self._asked = []
        self.let_go()
        self._refused(reason)

    def _refused(self, reason: str) -> None:
        self._panels.running.tell(reason)
        self._warn(reason)

    def _ended(self, outcome: Outcome) -> None:
        self.guarded(lambda: self._end(outcome))
        self.ended.emit()

    def _end(self, outcome: Outcome) -> None:
        run, link, state = self._live.run, self._live.link, outcome.state
        running = self._panels.running
        running.set_running(False)
        running.say("")
        text, *remarks = outcome.message.split("\n")
        if state is not None:
            text += f" ({state.iteration} iterations, {outcome.seconds:.1f} s)"
        running.show_verdict(outcome.verdict, "\n".join([text, *remarks]))
        if outcome.verdict == "failed":
            self._complain(outcome.message)
        if state is None or outcome.job is None or run is None or link is None:
            self._show_own()  # the last result may be that of another image
            return
        self._begin()
        self.timeline.add(state)
        link.show_mesh(state.mesh)
        running.numbers.show_fit(state, outcome.job)
        self._show_result(state, outcome.job, run.history, outcome.seconds)
        late, notes = run.left, ", ".join(note for _, note in self._asked)
        self._asked = []
        if late is not None and (late.mesh is not None or late.optics is not None):
            usable(late, state.mesh, state.optics, outcome.job)
            self.replace_result(changed_by_hand(state, outcome.job, late), notes)
        elif late is not None and late.pinned is not None:
            self.pin_result(late.pinned)
        self._overlays.show_result()
        if self._lets_go:
            self.let_go()

    def _image_changed(self) -> None:
        """Words of the last run are of its image; of another one, nothing is known."""
        run, running, of = self._live.run, self._panels.running, self._words_of
        if (run is not None and run.running) or of is None:
            return
        if self._panels.image.layer is not of():
            if running.last_verdict[1]:
                self._words = running.last_verdict
            running.show_verdict("", "")
            running.say("")
            running.tell("")
        elif not running.last_verdict[1]:
            running.show_verdict(*self._words)
        self._show_own()

    def _show_own(self) -> None:
        """A result is shown with its image, and not with another one."""
        of = self._result_of
        if of is not None:
            own = of() is not None and self._panels.image.layer is of()
            self._panels.running.show_fit(own)
            self._panels.results.setVisible(own)

    def _show_result(self, state: FitState, job: FitInput, history: History, s: float) -> None:
        """Take a state for the result of the image that the link shows."""
        assert self._live.link is not None
        self._result_of = weakref.ref(self._live.link.image_layer)
        self._panels.results.show_result(state, job, history, s)
        self._words_of = self._result_of
        self._show_own()

    def _lost(self, reason: str) -> None:
        """A layer that the fit needs is gone: end it, keep what it reached."""
        run = self._live.run
        if run is not None and run.running and not run.stopping:
            run.stop()
            self._warn(f"the fit ends, as {reason}; its result can still be saved")

    def _complain(self, message: str) -> None:
        self._panels.running.show_verdict("failed", message)
        self._warn(message)


def _after(
    experience: Experience, forecaster: Callable[[FitInput], Forecaster | None], job: FitInput
) -> Forecaster | None:
    """A forecast that knows how the last run went."""
    found = forecaster(job)
    return found.after(experience) if isinstance(found, Forecast) else found
