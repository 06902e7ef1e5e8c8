"""Beside the dial: what it stands for and costs here, before a fit runs and while it does."""

from __future__ import annotations

import weakref
from functools import partial
from typing import Any

from qtpy.QtCore import QObject

from ...accuracy.forecast import Forecast
from ...accuracy.machine_costs import costs
from ...accuracy.renewed_forecast import RenewedForecast
from ...common.words import duration
from ...errors import InputError
from ..document import Document
from ..running.worker import FitRun, Snapshot
from ..widgets import Signal
from .accuracy_dial import AccuracyDial, accuracy_of, relative
from .accuracy_scene import NoiseOf, Outlook, outlook, scene_now

WAIT = 300  # ms without a change before the forecast is computed


class AccuracyForecast(QObject):
    """Says what the dial stands for, how long a fit will take, and how long an iteration does."""

    number_changed = Signal(object)  # what the dial stands for; None where that is not known
    predicts = Signal(str)
    last_run = Signal(str)  # how long it took

    def __init__(
        self, doc: Document, dial: AccuracyDial, noise: NoiseOf, parent: QObject | None = None
    ) -> None:
        super().__init__(parent)
        self._doc, self._dial = doc, dial
        self._asked_of: tuple[Any, ...] = ()  # the image whose noise comes with the forecast
        self._told: Forecast | None = None  # that of the run, as it is shown
        self.noise = noise
        self._background = doc.background(self._show, self._fail)
        for signal in (doc.image.changed, doc.cells_changed, doc.settings_changed):
            signal.connect(self.later)
        dial.currentTextChanged.connect(self.later)
        self._image: Any = None  # a weak reference to the one that was chosen
        doc.image.changed.connect(self._image_changed)
        doc.work.changed.connect(self._work_changed)
        doc.shown.connect(self._running)
        doc.ended.connect(self._ended)
        self.later()

    @property
    def busy(self) -> bool:
        return self._background.busy

    def later(self) -> None:
        """Something may be different: forecast anew, unless it changes again at once."""
        self._show_number()
        self._background.soon(self._ask, WAIT)

    def _image_changed(self) -> None:
        """How fast the last run was, is of its image."""
        image, before = self._doc.image.layer, self._image
        if (before is None or before() is not image) and not self._doc.running:
            self.last_run.emit("")
        self._image = None if image is None else weakref.ref(image)

    # --------------------------------------------------------------------------- before a run

    def _ask(self) -> None:
        if self._doc.running:
            return  # the fit has a forecast of its own
        try:
            accuracy_of(self._dial.choice, 0.0)
        except InputError as error:
            self.predicts.emit(str(error))
            return
        try:
            scene = scene_now(self._doc)
        except InputError:
            self.predicts.emit("")  # what is missing is said by its panel
            return
        self._asked_of = self.noise.key()
        if not costs().measured:
            self.predicts.emit("measuring this computer for the forecast (once, a second) ...")
        self._background.ask(partial(outlook, scene))

    def _show(self, found: Outlook) -> None:
        self.noise.learn(self._asked_of, found.noise)
        self._show_number()
        expected = found.forecast
        known = self._doc.learned.about(expected.kind)
        self.predicts.emit(predicted(expected.after(known), found.guessed))

    def _fail(self, message: str) -> None:
        self.predicts.emit(f"no forecast: {message}")

    def _number(self) -> float | None:
        """What the dial stands for; None where that is not known yet, or nothing."""
        choice, noise = self._dial.choice, self.noise.known
        if relative(choice) and noise is None:
            return None
        try:
            return accuracy_of(choice, noise or 0.0)
        except InputError:
            return None

    def _show_number(self) -> None:
        self.number_changed.emit(self._number())

    # --------------------------------------------------------------------------- during a run

    def _work_changed(self) -> None:
        """A fit starts."""
        if self._doc.running and not self.noise.held:
            self._background.drop()
            self.noise.hold()
            self._told = None
            self.predicts.emit("")
            self.last_run.emit("")

    def _running(self, snapshot: Snapshot) -> None:
        self._tell(self._doc.run.forecast)

    def _tell(self, forecast: Any) -> None:
        """What the run itself forecasts; it knows its surfaces, and what was changed since."""
        whole = forecast.forecast if isinstance(forecast, RenewedForecast) else forecast
        if whole is not self._told and isinstance(whole, Forecast):
            self._told = whole
            self.predicts.emit(predicted(whole))

    def _ended(self) -> None:
        self.noise.let_go()
        run = self._doc.run
        if run is not None and isinstance(run.forecast, Forecast):
            expected = duration(run.forecast.seconds)
            self.last_run.emit(f"the last fit took {duration(run.seconds)}, {expected} predicted")
            self._learn(run, run.forecast)
        self.later()

    def _learn(self, run: FitRun, forecast: Forecast) -> None:
        """From a run whose settings stayed as they were: the next is predicted by it."""
        state = run.state
        found = None if state is None else forecast.experience(run.history, state, run.seconds)
        # A fit that was stopped tells nothing of how many iterations it needs.
        if state is not None and found is not None and state.message:
            self._doc.learned.learn(forecast.kind, found)


def predicted(forecast: Forecast, guessed: bool = False) -> str:
    """A forecast in words; less certain where the size of the surfaces is a guess."""
    return f"takes {'about ' * guessed}{duration(forecast.seconds)}"
