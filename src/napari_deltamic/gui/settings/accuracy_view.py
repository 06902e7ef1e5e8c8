"""What accuracy costs on this scene: every way to render it is timed, and can be chosen."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

from qtpy.QtCore import Qt
from qtpy.QtWidgets import QListWidget, QListWidgetItem, QWidget

from ...accuracy.accuracy_chart import short
from ...accuracy.machine_costs import costs
from ...accuracy.tradeoff import Way, measure_ways
from ...common.words import duration
from ...errors import InputError
from ...fitting.default_accuracy import image_noise
from ..document import Document
from ..widgets import Note, Signal, button, column
from ..work import Task, words_of
from .accuracy_dial import accuracy_of
from .accuracy_scene import SceneNow, scene_key, scene_now

_START, _STOP = "Measure on this scene", "Stop measuring"
_TIP = (
    "Renders this scene in every way there is and times each: what accuracy costs here. Takes "
    "about a minute in the background, and as much of the processor as a fit. Click on a line to "
    "ask for that accuracy."
)
_STALE = "this is of another image or PSF: measure again"
BUDGET = 2.0  # s: ways that take longer are left out; one under way cannot be interrupted


class Measurement(Task):
    """Times each way to render a scene; ends where a fit is to start."""

    title = "ways to render are being timed"
    gives_way = True

    def __init__(
        self, scene: SceneNow, on_way: Callable[[], None], on_end: Callable[[str | None], None]
    ) -> None:
        super().__init__()
        self._scene, self._on_way, self._on_end = scene, on_way, on_end
        self.ways: list[Way] = []
        self._seen = 0
        self.stage = "preparing"

    def steps(self) -> Generator[None, None, str]:
        scene = self._scene
        accuracy = accuracy_of(scene.choice, image_noise(scene.pixels()))

        def count(done: int, of: int) -> None:
            self.stage = f"{done} of {of} ways timed"

        known = costs(measure=True)
        given = scene.mesh(), scene.grid, scene.optics, accuracy
        for way in measure_ways(*given, budget=BUDGET, costs=known, progress=count):
            self.ways.append(way)
            yield
        return ""

    def failed(self, error: Exception) -> str:
        return words_of(error, self._scene.grid.shape)

    def look(self) -> None:
        if len(self.ways) > self._seen:
            self._seen = len(self.ways)
            self._on_way()

    def end(self, outcome: str | None) -> None:
        self._on_end(outcome)


class TradeoffView(QWidget):
    """Button and list; ``chosen`` brings the accuracy of a line that was clicked."""

    chosen = Signal(float)

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._doc = doc
        self._task: Measurement | None = None
        self._of: tuple[Any, ...] = ()  # the scene that was measured
        self._accuracy: float | None = None
        self.ways: list[Way] = []
        self.button = button(_START, _TIP, self._pressed, self)
        self.progress = Note(self)
        self.list = QListWidget(self)
        self.list.setAccessibleName("what accuracy costs")
        column(self.button, self.progress, self.list, of=self)
        self.list.hide()
        self.list.itemClicked.connect(self._clicked)
        for signal in (doc.image.changed, doc.settings_changed):
            signal.connect(self.look)
        doc.work.changed.connect(self._work_changed)

    @property
    def busy(self) -> bool:
        return self._task is not None and self._task.running

    def start(self) -> None:
        """Measure the scene that is shown."""
        try:
            scene = scene_now(self._doc)
            accuracy_of(scene.choice, 0.0)
            task = Measurement(scene, self._show, self._ended)
            self._doc.work.start(task)
        except InputError as error:
            self.progress.say(str(error))
            return
        self._task, self._of, self.ways = task, scene_key(self._doc), []
        self._work_changed()
        self._show()

    def show_accuracy(self, accuracy: float | None) -> None:
        """Mark the accuracy that the dial stands for; None where that is not known."""
        self._accuracy = accuracy
        self._show()

    def _pressed(self) -> None:
        if self.busy:
            self._doc.work.stop(at_once=True)
        else:
            self.start()

    def _show(self) -> None:
        self.ways = list(self._task.ways) if self._task is not None else []
        planned = [way for way in self.ways if way.accuracy and way.measured]
        self.list.clear()
        for way in planned:
            item = QListWidgetItem(_line(way), self.list)
            item.setData(Qt.ItemDataRole.UserRole, way.accuracy)
            font = item.font()
            font.setBold(way.accuracy == self._accuracy)
            item.setFont(font)
        height = self.list.sizeHintForRow(0) * len(planned) + 2 * self.list.frameWidth()
        self.list.setFixedHeight(max(height, 0) + 4)
        self.list.setVisible(bool(planned))

    def _ended(self, reason: str | None) -> None:
        self._show()
        slow = sum(not way.measured for way in self.ways)
        text = f"{slow} of {len(self.ways)} ways take longer than {BUDGET:g} s: left out"
        if reason is None:
            text = f"stopped: {len(self.ways)} ways were timed"
        elif reason:
            text = f"not measured: {reason}"
        self.progress.say(text if reason or reason is None or slow else "")

    def _work_changed(self) -> None:
        self.button.setText(_STOP if self.busy else _START)
        self.button.setEnabled(self.busy or not self._doc.work.occupied)

    def look(self) -> None:
        """Something was edited: are these the ways of what is shown?"""
        if self.ways and not self.busy:
            stale = self._of != scene_key(self._doc)
            if stale or self.progress.text() == _STALE:
                self.progress.say(_STALE if stale else "")

    def _clicked(self, item: QListWidgetItem) -> None:
        self.chosen.emit(item.data(Qt.ItemDataRole.UserRole))


def _line(way: Way) -> str:
    error = short(float(f"{way.error or 0:.1e}"))
    time = duration(way.gradient or 0)
    return f"{short(way.accuracy or 0)}: {time} an image, error {error}"
