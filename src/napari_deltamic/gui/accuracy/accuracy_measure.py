"""Times every way to render the scene that the panels show, in a thread."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

from qtpy.QtCore import QObject

from ...accuracy.machine_costs import costs
from ...accuracy.tradeoff import Way, measure_ways
from ...errors import InputError
from ...fitting.default_accuracy import image_noise
from ..attempt import words_of
from ..background import BackgroundSteps
from ..running.composition import Live, Panels
from ..running.inquiry import Inquiry
from ..running.run_control import RunControl
from .accuracy_dial import accuracy_of
from .accuracy_forecast import AccuracyForecast
from .accuracy_scene import SceneNow, scene_now

_STALE = "the chart is of another image or PSF: measure again"
BUDGET = 2.0  # s: ways that take longer are left out; one under way cannot be interrupted


@dataclass(frozen=True)
class Step:
    """A way that was measured, and how many of how many are done."""

    way: Way
    done: int
    of: int


class MeasureControl(Inquiry):
    """Starts and ends measurements, and hands what they find to the view.

    Parameters
    ----------
    viewer : a napari viewer or its model.
    panels, live : of the widget.
    control : tells of runs.
    forecast : knows the noise, and so what the dial stands for.
    parent : Qt's.
    """

    def __init__(
        self,
        viewer: Any,
        panels: Panels,
        live: Live,
        control: RunControl,
        forecast: AccuracyForecast,
        parent: QObject | None = None,
    ) -> None:
        self._view = view = panels.settings.tradeoff
        self._measuring: BackgroundSteps | None = None
        self._ways: list[Way] = []
        super().__init__(panels, live, control, view.allow, parent)
        self._viewer = viewer
        view.start.connect(self.start)
        view.stop.connect(self.stop)
        view.chosen.connect(self._chosen)
        forecast.number_changed.connect(view.show_accuracy)

    @property
    def busy(self) -> bool:
        """Whether something is being measured."""
        return self._measuring is not None

    def start(self) -> None:
        """Measure the scene that is shown."""
        if not self.possible:
            return
        try:
            scene = scene_now(self._viewer, self._panels, self._live)
            accuracy_of(scene.choice, 0.0)
        except InputError as error:
            self._view.progress.say(str(error))
            return
        self._ways = []
        self.note_asked()
        self._view.clear()
        self._view.set_measuring(True)
        self._view.progress.say("preparing ...")
        self._measuring = BackgroundSteps(_steps, (scene,), self._step, self._end, words_of)
        self._measuring.start()

    def stop(self, why: str = "stopped") -> None:
        """End what is under way; what was measured stays."""
        if self._measuring is not None:
            self._measuring.close()
            self._measuring = None
            self._view.set_measuring(False)
            self._view.progress.say(f"{why}: {len(self._ways)} ways were measured")

    def close_links(self) -> None:
        """End what is under way; the view is not touched."""
        super().close_links()
        if self._measuring is not None:
            self._measuring.close()
            self._measuring = None

    def _step(self, step: Step) -> None:
        self._ways.append(step.way)
        self._view.show_ways(self._ways)
        self._view.progress.say(f"{step.done} of {step.of} ways measured ...")

    def _end(self, reason: str | None) -> None:
        self._measuring = None
        self._view.set_measuring(False)
        slow = sum(not way.measured for way in self._ways)
        left_out = f"{slow} of {len(self._ways)} ways take longer than {BUDGET:g} s: left out"
        self._view.progress.say(f"not measured: {reason}" if reason else left_out if slow else "")

    def look(self) -> None:
        """Something was edited: is the chart still of what is shown?"""
        if self._view.ways and not self.busy:
            stale = self.stale
            if stale or self._view.progress.text() == _STALE:
                self._view.progress.say(_STALE if stale else "")

    def _chosen(self, accuracy: float) -> None:
        settings = self._panels.settings
        settings.accuracy.show_accuracy(accuracy)
        settings.changed.emit()


def _steps(scene: SceneNow) -> Generator[Step, None, str]:
    """What the thread runs; returns why it failed, '' if it did not."""
    try:
        accuracy = accuracy_of(scene.choice, image_noise(scene.pixels()))
        known = costs(measure=True)
        counts = [0, 0]

        def count(done: int, of: int) -> None:
            counts[:] = done, of

        for way in measure_ways(
            scene.mesh(),
            scene.grid,
            scene.optics,
            accuracy,
            budget=BUDGET,
            costs=known,
            progress=count,
        ):
            yield Step(way, *counts)
    except Exception as error:
        return words_of(error, scene.grid.shape)
    return ""
