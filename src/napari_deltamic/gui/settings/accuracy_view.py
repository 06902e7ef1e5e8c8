"""What accuracy costs on this scene: every way to render it is timed, and can be chosen."""

from __future__ import annotations

from collections.abc import Generator
from functools import partial

from qtpy.QtCore import Qt
from qtpy.QtWidgets import QListWidget, QListWidgetItem, QWidget

from ...accuracy.accuracy_chart import short
from ...accuracy.machine_costs import costs
from ...accuracy.outlook import SceneNow
from ...accuracy.tradeoff import Way, measure_ways
from ...common.words import duration
from ...fitting.default_accuracy import accuracy_of, image_noise
from ..document import Document
from ..widgets import Note, Signal, TaskButton, column
from ..work import Question
from .accuracy_forecast import scene_key, scene_now

_TITLES = "Measure on this scene", "Stop measuring"
_TIP = (
    "Renders this scene by every method and times each, to show what accuracy costs here. Takes "
    "about a minute in the background, and as much of the processor as a fit. Click a line to "
    "use that accuracy."
)
_STALE = "this is of another image or PSF: measure again"
BUDGET = 2.0  # s: ways that take longer are left out; one under way cannot be interrupted


class TradeoffView(QWidget):
    """Button and list; ``chosen`` brings the accuracy of a line that was clicked."""

    chosen = Signal(float)

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._doc = doc
        self._accuracy: float | None = None
        self.ways: list[Way] = []  # that are shown
        self.button = TaskButton(doc.work, _TITLES, _TIP, self._measurement, self)
        self.progress = Note(self)
        self.list = QListWidget(self)
        self.list.setAccessibleName("what accuracy costs")
        column(self.button, self.progress, self.list, of=self)
        self.list.hide()
        self.list.itemClicked.connect(self._clicked)
        for signal in (doc.image.changed, doc.settings.changed):
            signal.connect(self.look)
        self.button.began.connect(self._show)
        self.button.refused.connect(self.progress.say)

    def show_accuracy(self, accuracy: float | None) -> None:
        """Mark the accuracy that the dial stands for; None where that is not known."""
        self._accuracy = accuracy
        self._show()

    def _show(self) -> None:
        task = self.button.task
        self.ways = [] if task is None else list(task.found)
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

    def _measurement(self) -> Question:
        scene = scene_now(self._doc)
        accuracy_of(scene.choice, 0.0)
        return Question(
            "ways to render are being timed",
            partial(_timed, scene),
            self._look_for_more,
            self._ended,
            scene_key(self._doc),
            scene.grid.shape,
        )

    def _look_for_more(self) -> None:
        task = self.button.task
        if task is not None and len(task.found) > len(self.ways):
            self._show()

    def _ended(self, reason: str | None) -> None:
        self._show()
        slow = sum(not way.measured for way in self.ways)
        text = f"{slow} of {len(self.ways)} ways take longer than {BUDGET:g} s: left out"
        if reason is None:
            text = f"stopped: {len(self.ways)} ways were timed"
        elif reason:
            text = f"not measured: {reason}"
        self.progress.say(text if reason or reason is None or slow else "")

    def look(self) -> None:
        """Something was edited: are these the ways of what is shown?"""
        task = self.button.task
        if task is not None and self.ways and not task.running:
            stale = task.of != scene_key(self._doc)
            if stale or self.progress.text() == _STALE:
                self.progress.say(_STALE if stale else "")

    def _clicked(self, item: QListWidgetItem) -> None:
        self.chosen.emit(item.data(Qt.ItemDataRole.UserRole))


def _timed(scene: SceneNow, question: Question) -> Generator[None, None, str]:
    """Times each way to render a scene."""
    accuracy = accuracy_of(scene.choice, image_noise(scene.pixels()))

    def count(done: int, of: int) -> None:
        question.stage = f"{done} of {of} ways timed"

    known = costs(measure=True)
    given = scene.mesh(), scene.grid, scene.optics, accuracy
    for way in measure_ways(*given, budget=BUDGET, costs=known, progress=count):
        question.found.append(way)
        yield
    return ""


def _line(way: Way) -> str:
    error = short(float(f"{way.error or 0:.1e}"))
    time = duration(way.gradient or 0)
    return f"{short(way.accuracy or 0)}: {time} an image, error {error}"
