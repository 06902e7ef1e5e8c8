"""The accuracy dial, and what it stands for and costs here: predicted, or measured."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from qtpy.QtCore import QObject, Qt
from qtpy.QtWidgets import QComboBox, QListWidget, QListWidgetItem, QPushButton, QWidget

from ...accuracy.accuracy_chart import short
from ...accuracy.forecast import Forecast, RenewedForecast
from ...accuracy.machine_costs import costs
from ...accuracy.outlook import Outlook, SceneNow, outlook
from ...accuracy.rough_surfaces import points_of
from ...accuracy.tradeoff import Way, measure_ways
from ...common.words import duration
from ...errors import InputError
from ...fitting.model.default_accuracy import (
    PRESETS,
    Preset,
    accuracy_of,
    chosen,
    image_noise,
    relative,
)
from ...geometry import Mesh
from ..document import Document
from ..fit_choice import NORMAL
from ..running.worker import FitRun, Snapshot
from ..widgets import Note, Signal, be_as_high_as_rows, be_narrow, column
from ..window_words import as_tip
from ..work import Question

WAIT = 300  # ms without a change before the forecast is computed
_TIPS: dict[Preset, str] = {
    "quick": "Longer edges, an earlier end, no other neighbours tried there, and images that are "
    "less accurate than normal where that is safe. For a first look: the shape may be off by more "
    "than noise alone would cause, and more small contacts between cells are wrong.",
    "normal": "As accurate as the noise of this image warrants: more accurate renderings take "
    "longer and do not improve the shape.",
    "careful": "Edges so short that flat triangles add no error that matters beside the noise, "
    "images ten times more accurate than normal, a later end.",
    "exact": "The closed form at every wavevector of the grid: no approximation at all, and often "
    "hundreds of times slower. To check the others with.",
}
_TIP = (
    "How close the fit should come to the true shape, and so how long it takes. Choose a name, "
    "or type the error that the shape may have, such as 20nm, or the relative error that rendered "
    "images may have, such as 3e-3."
)

_TITLES = "Measure on this scene", "Stop measuring"
_MEASURES = (
    "Renders this scene at several accuracies and times each, to show what accuracy costs here. "
    "Takes some seconds in the background. Click a line to use that accuracy."
)
_STALE = "these times are for another image or PSF: measure again"
_ACCURACY = Qt.ItemDataRole.UserRole  # of a line
BUDGET = 2.0  # s: ways that take longer are left out; one under way cannot be interrupted


class AccuracyDial(QComboBox):
    """Quick, normal, careful, exact, or a number that is typed in."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setEditable(True)
        self.setInsertPolicy(QComboBox.InsertPolicy.NoInsert)
        for k, name in enumerate(PRESETS):
            self.addItem(name)
            self.setItemData(k, f"<qt>{_TIPS[name]}</qt>", Qt.ItemDataRole.ToolTipRole)
        rows = "".join(f"<br><b>{name}</b>: {_TIPS[name]}" for name in PRESETS)
        self.setToolTip(f"<qt>{_TIP}{rows}</qt>")
        be_narrow(self, 8)
        self.setMinimumWidth(104)  # napari's style asks for more, and the dock could not be narrow
        self.setCurrentText(NORMAL)

    def show_choice(self, choice: str) -> None:
        if chosen(self.currentText()) != choice:
            self.setCurrentText(choice)


class AccuracyForecast(QObject):
    """Says what the dial stands for, and how long a fit and an iteration will take."""

    number_changed = Signal(object)  # what the dial stands for; None where that is not known
    predicts = Signal(str)
    last_run = Signal(str)  # how long it took

    def __init__(self, doc: Document, dial: AccuracyDial, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._doc, self._choice = doc, doc.settings
        self.noise = doc.settings.noise
        # The seeds, or the fit once started, say why there is none.
        self.background = doc.background(lambda why: self.predicts.emit(""))
        for signal in (doc.image.changed, doc.cells_changed, doc.settings.changed):
            signal.connect(self.later)
        dial.currentTextChanged.connect(self.later)
        self._fitted: tuple[Any, ...] = ()  # that of the last run
        doc.image.replaced.connect(self._image_replaced)
        doc.work.changed.connect(self._work_changed)
        doc.shown.connect(self._running)
        doc.ended.connect(self._ended)
        self.later()

    def later(self) -> None:
        """Forecast again after a possible change, once nothing changes any more."""
        self._show_number()
        self.background.soon(self._ask, WAIT)

    def _image_replaced(self) -> None:
        """Clear the speed of the last run, which was of another image."""
        if not self._doc.running:
            self.last_run.emit("")

    # --------------------------------------------------------------------------- before a run

    def _ask(self) -> None:
        if self._doc.running:
            return  # the fit has a forecast of its own
        try:
            accuracy_of(self._choice.accuracy, 0.0)
        except InputError as error:
            self.predicts.emit(str(error))
            return
        try:
            scene = scene_now(self._doc)
        except InputError:
            self.predicts.emit("")  # what is missing is said by its panel
            return
        if not costs().measured:
            self.predicts.emit("measuring this computer for the forecast (once, a second) ...")
        self.background.ask(partial(outlook, scene), partial(self._show, self._doc.image.key()))

    def _show(self, key: tuple[Any, ...], found: Outlook) -> None:
        self.noise.learn(key, found.noise)
        self._show_number()
        expected = found.forecast
        known = self._doc.learned.about(expected.kind, key)
        self.predicts.emit(predicted(expected.after(known)))

    def _show_number(self) -> None:
        """Show the number that the dial stands for, if it is known."""
        choice, noise, number = self._choice.accuracy, self.noise.known, None
        if noise is not None or not relative(choice):
            with suppress(InputError):
                number = accuracy_of(choice, noise or 0.0)
        self.number_changed.emit(number)

    # --------------------------------------------------------------------------- during a run

    def _work_changed(self) -> None:
        """React to the start of a fit."""
        if self._doc.running:
            self.background.drop()
            self._fitted = self._doc.image.key()
            self.noise.hold(True)
            self.predicts.emit("")
            self.last_run.emit("")

    def _running(self, snapshot: Snapshot) -> None:
        """Show the forecast of the run itself, which knows its surfaces and later changes."""
        forecast = self._doc.run.forecast
        whole = forecast.forecast if isinstance(forecast, RenewedForecast) else forecast
        if isinstance(whole, Forecast):
            self.predicts.emit(predicted(whole))

    def _ended(self) -> None:
        self.noise.hold(False)
        run = self._doc.run
        first = None if run is None else run.first_forecast
        if isinstance(first, Forecast):
            expected = duration(first.seconds)
            self.last_run.emit(f"the last fit took {duration(run.seconds)}, {expected} predicted")
            if not run.settings_changed:
                self._learn(run, first)
        self.later()

    def _learn(self, run: FitRun, forecast: Forecast) -> None:
        """Learn from a run whose settings did not change, to predict the next one."""
        state = run.state
        found = None if state is None else forecast.experience(run.history, state, run.seconds)
        # A fit that was stopped tells nothing of how many iterations it needs.
        if state is not None and found is not None and state.message:
            self._doc.learned.learn(forecast.kind, found, self._fitted)


class TaskButton(QPushButton):
    """Starts a task about the scene chosen, and ends it while it runs.

    Parameters
    ----------
    titles : while it can be started, and while it runs.
    make : makes it. InputError where something is missing.

    Attributes
    ----------
    progress : a note, to be laid out below: why it did not start, and what the panel says.
    """

    began = Signal()

    def __init__(
        self,
        doc: Document,
        titles: tuple[str, str],
        tip: str,
        make: Callable[[], Question],
        parent: QWidget,
    ) -> None:
        super().__init__(titles[0], parent)
        self.setToolTip(as_tip(tip))
        self.progress = Note(parent)
        self._doc, self._titles, self._make = doc, titles, make
        self._of: tuple[Any, ...] = ()  # the scene of the last task
        self.task: Question | None = None  # the last one
        self.clicked.connect(self._pressed)
        doc.work.changed.connect(self._show)

    @property
    def busy(self) -> bool:
        return self.task is not None and self.task.running

    @property
    def stale(self) -> bool:
        """Whether the last task was about another scene than is chosen now."""
        return self._of != scene_key(self._doc)

    def start(self) -> None:
        """Start a task, unless one runs that does not give way."""
        try:
            task, of = self._make(), scene_key(self._doc)
            self._doc.work.start(task)
        except InputError as error:
            self.progress.say(str(error))
            return
        self.task, self._of = task, of
        self._show()
        self.began.emit()

    def _pressed(self) -> None:
        if self.busy:
            self._doc.work.stop()
        else:
            self.start()

    def _show(self) -> None:
        self.setText(self._titles[self.busy])
        self.setEnabled(self.busy or not self._doc.work.occupied)


class TradeoffView(QWidget):
    """Button and list; ``chosen`` brings the accuracy of a line that was clicked."""

    chosen = Signal(float)

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._doc = doc
        self._accuracy: float | None = None
        self.ways: list[Way] = []  # that are shown
        self.button = TaskButton(doc, _TITLES, _MEASURES, self._measurement, self)
        self.progress = self.button.progress
        self.list = QListWidget(self)
        self.list.setAccessibleName("what accuracy costs")
        be_as_high_as_rows(self.list)
        column(self.button, self.progress, self.list, of=self)
        self.list.hide()
        self.list.itemClicked.connect(lambda line: self.chosen.emit(line.data(_ACCURACY)))
        for signal in (doc.image.changed, doc.settings.changed):
            signal.connect(self.look)
        self.button.began.connect(self._show)
        doc.work.looked.connect(self._look_for_more)

    def show_accuracy(self, accuracy: float | None) -> None:
        """Mark the accuracy that the dial stands for; None if it is not known."""
        self._accuracy = accuracy
        self._show()

    def _show(self) -> None:
        task = self.button.task
        self.ways = [] if task is None else list(task.found)
        # What the others are compared with is far too fine to fit with.
        planned = [w for w in self.ways if w.accuracy and w.measured and not w.reference]
        self.list.clear()
        for way in planned:
            item = QListWidgetItem(_line(way), self.list)
            item.setData(_ACCURACY, way.accuracy)
            font = item.font()
            font.setBold(way.accuracy == self._accuracy)
            item.setFont(font)
        self.list.setVisible(bool(planned))

    def _measurement(self) -> Question:
        scene = scene_now(self._doc)
        accuracy_of(scene.choice, 0.0)
        title, steps = "ways to render are being timed", partial(_timed, scene)
        return Question(title, steps, self._ended, scene.grid.shape)

    def _look_for_more(self) -> None:
        task = self.button.task
        if task is not None and len(task.found) > len(self.ways):
            self._show()

    def _ended(self, reason: str | None) -> None:
        self._show()
        asked = [way for way in self.ways if way.accuracy and not way.reference]
        slow = sum(not way.measured for way in asked)
        text = f"{slow} of {len(asked)} left out: an image takes longer than {BUDGET:g} s"
        if reason is None:
            text = f"stopped: {len(self.ways)} ways were timed"
        elif reason:
            text = f"not measured: {reason}"
        self.progress.say(text if reason or reason is None or slow else "")

    def look(self) -> None:
        """After an edit, mark the ways as outdated unless they belong to what is shown."""
        if self.ways and not self.button.busy:
            stale = self.button.stale
            if stale or self.progress.text() == _STALE:
                self.progress.say(_STALE if stale else "")


def predicted(forecast: Forecast) -> str:
    """A forecast in words.

    Before the first fit of an image it is the least: that of one which settles at once.
    """
    time = duration(forecast.seconds, whole=forecast.seconds > 2)
    return f"takes about {time}" if forecast.learned.single else f"takes {time} or more"


def scene_key(doc: Document) -> tuple[Any, ...]:
    """A key that is equal as long as image, voxel size and PSF are the same."""
    layer = doc.image.layer
    size = None if layer is None else tuple(layer.scale)
    return *doc.image.key(), size, doc.settings.psf_key()


def scene_now(doc: Document) -> SceneNow:
    """The scene as chosen, without reading voxels. InputError if something is missing."""
    image, frame = doc.image, doc.image.frame()
    seeds = doc.cells.seeds(frame, copied=False)
    return SceneNow(
        choice=doc.settings.accuracy,
        image=image.unread(image.layer),
        grid=frame.grid(image.shape()),
        scene=doc.settings.scene_settings(),
        settings=doc.settings.other_settings(),
        seeds=seeds,
        known=_known_surfaces(doc, points_of(seeds)),
    )


def _known_surfaces(doc: Document, points: int) -> Mesh | None:
    """The surfaces of a preview, else those of this image's fit, if of as many cells; else None."""
    if doc.cells.preview_mesh is not None:
        return doc.cells.preview_mesh
    present, link = doc.present(), doc.link
    if present is None or link is None or link.image_layer is not doc.image.layer:
        return None
    mesh = present.state.mesh
    return mesh if len(np.unique(mesh.regions[mesh.regions > 0])) == points else None


def _timed(scene: SceneNow, question: Question) -> Generator[None, None, str]:
    """Time each way to render a scene; runs in a thread."""
    accuracy = accuracy_of(scene.choice, image_noise(scene.pixels()))

    def count(done: int, of: int) -> None:
        question.stage = f"{done} of {of} ways timed"

    known = costs(measure=True)
    given = scene.mesh(), scene.grid, scene.optics, accuracy
    for way in measure_ways(*given, by_hand=False, budget=BUDGET, costs=known, progress=count):
        question.found.append(way)
        yield
    return ""


def _line(way: Way) -> str:
    error = short(float(f"{way.error or 0:.1e}"))
    time = duration(way.gradient or 0)
    return f"{short(way.accuracy or 0)}: {time} an image, error {error}"
