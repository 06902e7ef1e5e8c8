"""Asks, in a thread, which effects the image chosen calls for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

from qtpy.QtCore import QObject, QTimer

from ...errors import InputError
from ...evidence import Recommendation, recommend
from ...fitting import FitState
from ...fitting.checks import check_image
from ...fitting.job import FitInput, assemble, optics_of, start
from ...runs.settings import NEAR_LEVELS, RunSettings
from ..background import Background
from ..running.composition import Live, Panels
from ..running.inquiry import Inquiry
from ..running.run_control import RunControl
from ..viewing.frame import shape_of

_STALE = "this was of another image or PSF: check again"
_POLL = 200  # ms between two looks at how far the thread is


@dataclass
class Steps:
    """What the thread and its watcher share; each field is written by one of them."""

    stopped: bool = False  # by the watcher
    text: str = "preparing"  # by the thread

    def tell(self, text: str) -> None:
        """Note what is being done; ends the thread where that was asked for."""
        if self.stopped:
            raise InputError("stopped")
        self.text = text


@dataclass(frozen=True, eq=False)
class Question:
    """What is asked; nothing in it knows of a widget.

    prepare : puts the fit together.
    fitted : its last state, where there is one of these very settings.
    """

    prepare: Callable[[], FitInput]
    fitted: FitState | None
    steps: Steps = field(default_factory=Steps)


class EffectsCheck(Inquiry):
    """Starts and ends checks, and hands what they find to the panel.

    Parameters
    ----------
    panels, live : of the widget.
    control : tells of runs.
    parent : Qt's.
    """

    def __init__(
        self, panels: Panels, live: Live, control: RunControl, parent: QObject | None = None
    ) -> None:
        self._view = view = panels.settings.effects
        self._question: Question | None = None
        self._found: Recommendation | None = None
        super().__init__(panels, live, control, view.allow, parent)
        self._control = control
        self._background = Background(self._show, self._fail)
        self._timer = QTimer(self)
        self._timer.setInterval(_POLL)
        self._timer.timeout.connect(self._look_in)
        view.check.connect(self.start)
        view.stop.connect(self.stop)

    @property
    def busy(self) -> bool:
        """Whether something is being checked."""
        return self._question is not None

    def start(self) -> None:
        """Check the image that is chosen."""
        if not self.possible:
            return
        try:
            question = self._question = self._asked()
        except InputError as error:
            self._view.progress.say(str(error))
            return
        self.note_asked()
        self._found = None
        self._view.show_found(None)
        self._view.set_checking(True)
        self._look_in()
        self._timer.start()
        self._background.ask(partial(_answer, question))

    def stop(self, why: str = "stopped") -> None:
        """End what is under way; its thread ends at its next step."""
        if self._question is not None:
            self._question.steps.stopped = True
            self._background.drop()
            self._finish()
            self._view.progress.say(why)

    def close_links(self) -> None:
        """End what is under way; the view is not touched."""
        super().close_links()
        self._timer.stop()
        if self._question is not None:
            self._question.steps.stopped = True
        self._background.close()

    # ----------------------------------------------------------------------------------- inside

    def _asked(self) -> Question:
        """Of the fit of this image where there is one, else of the seeds."""
        image, settings = self._panels.image, self._panels.settings
        link, last = self._live.link, self._panels.results.last
        frame = image.frame()
        scene = settings.scene_settings()
        if (
            last is None
            or self._control.present() is None
            or link is None
            or link.image_layer is not image.layer
            or link.frame != frame
            or not link.at_time
        ):
            seeds = self._panels.seeds.seeds(frame)
            run, read = self._control.run_settings(seeds), image.reader()
            grid, second = frame.grid(shape_of(image.layer)), self._view.second.pixels()

            def prepare() -> FitInput:
                pixels = read()
                check_image(pixels, grid)
                start = seeds.make(pixels, grid)
                return assemble(run, pixels, grid, start, seeds.kind, second)

            return Question(prepare, None)
        state, job = last[:2]
        # Only the end of a fit with this PSF and these effects needs no other one.
        before = job.settings.scene
        same = (
            state.converged
            and (before.sigma, before.optics) == (scene.sigma, scene.optics)
            and state.effects.names == scene.effects.names
        )
        if same:
            return Question(lambda: job, state)
        fit = job.settings.fit.model_copy(update={"levels": NEAR_LEVELS})
        changed = job.settings.model_copy(update={"scene": scene, "fit": fit})
        job = replace(job, second=self._view.second.pixels())
        return Question(partial(_from_there, job, state, changed), None)

    def _look_in(self) -> None:
        if self._question is not None:
            self._view.progress.say(f"{self._question.steps.text} ...")

    def _show(self, found: Recommendation) -> None:
        self._finish()
        self._found = found
        self._view.show_found(found)
        self.look()

    def _fail(self, message: str) -> None:
        self._finish()
        self._view.progress.say(f"not checked: {message}")

    def _finish(self) -> None:
        self._question = None
        self._timer.stop()
        self._view.set_checking(False)

    def look(self) -> None:
        """Something was edited: evidence of something else is put away, until that is back."""
        if self._found is None or self.busy:
            return
        if self.stale:
            self._view.show_found(None)
            self._view.progress.say(_STALE)
        elif self._view.found is None:
            self._view.show_found(self._found)


def _from_there(job: FitInput, state: FitState, settings: RunSettings) -> FitInput:
    """The fit of other settings that starts where an earlier one ended."""
    return replace(job, settings=settings, mesh=state.mesh, optics=optics_of(settings.scene))


def _answer(question: Question) -> Recommendation:
    """What the thread does. InputError where it cannot, or was stopped."""
    steps, state = question.steps, question.fitted
    job = question.prepare()
    if state is None:
        for state in start(job):
            steps.tell(f"fitting: iteration {state.iteration}")
    assert state is not None, "a fit yields at least one state"
    return recommend(
        job.image,
        job.grid,
        job.mesh,
        job.optics,
        job.settings.fit,
        counted=job.counted,
        effects=state.effects,
        fitted=state,
        progress=steps.tell,
    )
