"""Beside the dial: what it stands for and costs here, before a fit runs and while it does."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from qtpy.QtCore import QObject, QTimer

from ...accuracy.accuracy_chart import short
from ...accuracy.forecast import Forecast
from ...accuracy.machine_costs import costs
from ...accuracy.tradeoff import duration
from ...errors import InputError
from ...fitting.default_accuracy import PRESETS
from ..background import Background
from ..qt import Signal
from ..running.composition import Live, Panels
from ..running.run_control import RunControl
from ..running.run_progress import Snapshot
from ..running.worker import FitRun
from .accuracy_dial import accuracy_of, relative
from .accuracy_scene import NoiseOf, Outlook, outlook, scene_now
from .renewed_forecast import RenewedForecast

WAIT = 300  # ms without a change before the forecast is computed
_FEWEST = 3  # iterations of a level before its speed is told


class AccuracyForecast(QObject):
    """Keeps the lines under the dial up to date.

    Parameters
    ----------
    viewer : a napari viewer or its model.
    panels, live : of the widget.
    control : tells of runs.
    parent : Qt's.
    """

    number_changed = Signal(object)  # what the dial stands for; None where that is not known

    def __init__(
        self,
        viewer: Any,
        panels: Panels,
        live: Live,
        control: RunControl,
        parent: QObject | None = None,
    ) -> None:
        super().__init__(parent)
        self._viewer, self._panels, self._live = viewer, panels, live
        self._open = True
        self._asked_of: tuple[Any, ...] = ()  # the image whose noise comes with the forecast
        # Level, settings; iterations and s when it began with these.
        self._since: tuple[int, Any, int, float] | None = None
        self._last = ""  # how fast the run is, or was
        self._told: Forecast | None = None  # that of the run, as it is shown
        self.noise = panels.settings.accuracy.noise = NoiseOf(viewer, panels.image)
        self._background = Background(self._show, self._fail)
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(WAIT)
        self._timer.timeout.connect(self._ask)
        for signal in (
            panels.image.changed,
            panels.seeds.changed,
            panels.seeds.preview.changed,
            panels.settings.changed,
            panels.settings.accuracy.currentTextChanged,
        ):
            signal.connect(self.later)
        self._image: Any = panels.image.layer
        panels.image.changed.connect(self._image_changed)
        control.started.connect(self._started)
        control.shown.connect(self._running)
        control.ended.connect(self._ended)
        self.later()

    @property
    def busy(self) -> bool:
        """Whether a forecast is awaited."""
        return self._open and (self._timer.isActive() or self._background.busy)

    def later(self, text: str = "") -> None:
        """Something may be different: forecast anew, unless it changes again at once."""
        if self._open:
            self._show_number()
            self._timer.start()

    def close_links(self) -> None:
        """End what is under way."""
        self._open = False
        self._image = None
        self._background.close()

    def _image_changed(self) -> None:
        """How fast the last run was, is of its image."""
        run, image = self._live.run, self._panels.image.layer
        if image is not self._image and not (run is not None and run.running):
            self._panels.settings.pace.say("")
        self._image = image

    # --------------------------------------------------------------------------- before a run

    def _ask(self) -> None:
        run = self._live.run
        if not self._open or (run is not None and run.running):
            return  # the fit has a forecast of its own
        settings = self._panels.settings
        try:
            accuracy_of(settings.accuracy.choice, 0.0)
        except InputError as error:
            self._background.drop()
            settings.outlook.say(str(error))
            return
        try:
            scene = scene_now(self._viewer, self._panels, self._live)
        except InputError:
            self._background.drop()
            settings.outlook.say("")  # what is missing is said by its panel
            return
        self._asked_of = self.noise.key()
        if not costs().measured:
            settings.outlook.say("measuring this computer for the forecast (once, a second) ...")
        self._background.ask(partial(outlook, scene))

    def _show(self, found: Outlook) -> None:
        self.noise.learn(self._asked_of, found.noise)
        self._show_number()
        expected = found.forecast.after(self._live.experience)
        self._panels.settings.outlook.say(predicted(expected, found.guessed))

    def _fail(self, message: str) -> None:
        self._panels.settings.outlook.say(f"no forecast: {message}")

    def _number(self) -> float | None:
        """What the dial stands for; None where that is not known yet, or nothing."""
        choice, noise = self._panels.settings.accuracy.choice, self.noise.known
        if relative(choice) and noise is None:
            return None
        try:
            return accuracy_of(choice, noise or 0.0)
        except InputError:
            return None

    def _show_number(self) -> None:
        number, named = self._number(), self._panels.settings.accuracy.choice in PRESETS
        text = f"= {short(number) if number else 0}" if named and number is not None else ""
        self._panels.settings.accuracy_number.setText(text)
        self.number_changed.emit(number)

    # --------------------------------------------------------------------------- during a run

    def _started(self) -> None:
        self._timer.stop()
        self._background.drop()
        self.noise.held = self.noise.known is not None
        self._since, self._last, self._told = None, "", None
        self._panels.settings.outlook.say("")
        self._panels.settings.pace.say("")

    def _running(self, snapshot: Snapshot) -> None:
        run = self._live.run
        if run is None:
            return
        level, done, seconds = snapshot.state.level, len(run.history.loss), run.seconds
        settings = snapshot.job.settings.fit
        self._tell(run.forecast)
        if self._since is None or self._since[:2] != (level, settings):
            self._since = (level, settings, done, seconds)
            return
        count, took = done - self._since[2], seconds - self._since[3]
        if count >= _FEWEST and took > 0:
            self._last = pace(took / count, run.forecast, level)
            self._panels.settings.pace.say(self._last)

    def _tell(self, forecast: Any) -> None:
        """What the run itself forecasts; it knows its surfaces, and what was changed since."""
        whole = forecast.forecast if isinstance(forecast, RenewedForecast) else forecast
        if whole is not self._told and isinstance(whole, Forecast):
            self._told = whole
            self._panels.settings.outlook.say(predicted(whole))

    def _ended(self) -> None:
        self.noise.held = False
        run = self._live.run
        if self._last and run is not None:
            text = f"last run: {self._last}"
            if isinstance(run.forecast, Forecast):
                expected = duration(run.forecast.seconds)
                text += f"; {duration(run.seconds)} in all, {expected} predicted"
            self._panels.settings.pace.say(text)
        if run is not None and isinstance(run.forecast, Forecast):
            self._learn(run, run.forecast)
        self.later()

    def _learn(self, run: FitRun, forecast: Forecast) -> None:
        """From a run whose settings stayed as they were: the next is predicted by it."""
        state, old = run.state, self._live.experience
        new = None if state is None else forecast.experience(run.history, state, run.seconds)
        if new is not None:
            more = old.iterations if old.blurs == new.blurs else 1.0
            self._live.experience = replace(
                new, seconds=old.seconds * new.seconds, iterations=more * new.iterations
            )


def predicted(forecast: Forecast, guessed: bool = False) -> str:
    """A forecast in words; less certain where the size of the surfaces is a guess."""
    return f"takes {'about ' * guessed}{duration(forecast.seconds)}"


def pace(measured: float, forecast: Any, level: int) -> str:
    """How long an iteration takes, and how long it was predicted to, s at a level."""
    text = f"{duration(measured)} an iteration"
    for one in getattr(forecast, "levels", ()):
        if one.number == level:
            text += f", {duration(one.seconds_per_iteration)} predicted"
    return text
