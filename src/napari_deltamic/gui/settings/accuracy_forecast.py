"""Beside the dial: what it stands for and costs here, before a fit runs and while it does."""

from __future__ import annotations

import weakref
from functools import partial
from typing import Any

import numpy as np
from qtpy.QtCore import QObject

from ...accuracy.forecast import Forecast
from ...accuracy.machine_costs import costs
from ...accuracy.outlook import Outlook, SceneNow, outlook
from ...accuracy.renewed_forecast import RenewedForecast
from ...accuracy.rough_surfaces import points_of
from ...common.words import duration
from ...errors import InputError
from ...fitting.default_accuracy import accuracy_of, image_noise, relative
from ...geometry import Mesh
from ..document import Document
from ..running.worker import FitRun, Snapshot
from ..widgets import Signal
from .accuracy_dial import AccuracyDial

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


class NoiseOf:
    """The noise of the image chosen, measured once for each image and time."""

    def __init__(self, doc: Document) -> None:
        self._doc = doc
        self._of: tuple[Any, ...] = ()
        self._noise: float | None = None
        self.held = False  # while a fit runs, that of its image counts

    def __call__(self) -> float:
        """The noise. InputError if there is no image."""
        known = self.known
        if known is None:
            known = image_noise(self._doc.image.stack())
            self.learn(self.key(), known)
        return known

    @property
    def known(self) -> float | None:
        """The noise where it was measured, else None."""
        return self._noise if self.held or self._of == self.key() else None

    def key(self) -> tuple[Any, ...]:
        """What it is the noise of."""
        image = self._doc.image
        if image.layer is None:
            return ()
        return weakref.ref(image.layer), id(image.layer.data), image.time, image.box

    def hold(self) -> None:
        """A fit begins."""
        self.held = self.known is not None

    def let_go(self) -> None:
        """It has ended."""
        self.held = False

    def learn(self, key: tuple[Any, ...], noise: float) -> None:
        """Take over what was measured elsewhere."""
        if key and not self.held:
            self._of, self._noise = key, noise


def scene_key(doc: Document) -> tuple[Any, ...]:
    """The same as long as image, voxel size and PSF are."""
    image = doc.image
    size = None if image.layer is None else tuple(image.layer.scale)
    return id(image.layer), image.time, image.box, size, doc.settings.optics.key()


def scene_now(doc: Document) -> SceneNow:
    """The scene as it is chosen; touches no voxel. InputError if something is missing."""
    image, frame = doc.image, doc.image.frame()
    seeds = doc.cells.seeds(frame, copied=False)
    return SceneNow(
        choice=doc.settings.accuracy.choice,
        image=image.unread(image.layer),
        grid=frame.grid(image.shape()),
        scene=doc.settings.scene_settings(),
        settings=doc.settings.other_settings(),
        seeds=seeds,
        known=_known_surfaces(doc, points_of(seeds)),
    )


def _known_surfaces(doc: Document, points: int) -> Mesh | None:
    """What the preview shows, else what the fit of this image has or found."""
    if doc.cells.preview_mesh is not None:
        return doc.cells.preview_mesh
    record = doc.record
    if record is None or record.link.image_layer is not doc.image.layer:
        return None
    state = doc.run.state if doc.running else record.state
    if state is None:
        return None
    mesh: Mesh = state.mesh
    return mesh if len(np.unique(mesh.regions[mesh.regions > 0])) == points else None
