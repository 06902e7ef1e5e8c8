"""Which corrections are computed, and what the image says about them."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace
from functools import partial
from typing import Any

from qtpy.QtWidgets import QFormLayout, QHBoxLayout, QPushButton, QVBoxLayout, QWidget

from ...errors import InputError
from ...evidence import Recommendation, recommend
from ...evidence.camera import Camera
from ...evidence.candidates import CONSIDERED
from ...fitting import FitState
from ...fitting.job import FitInput, optics_of, start
from ...runs.settings import NEAR_LEVELS, RunSettings
from ...scene.effects import KINDS, Effects, ViewEffect, kind_of
from ..document import Document
from ..fields import TripleField
from ..viewing.listening import Connections
from ..widgets import LayerChooser, Note, Signal, column, show_row
from ..work import Task, words_of
from .accuracy_scene import scene_key
from .effects_table import EffectsTable, spoken

_START, _STOP = "Check this image", "Stop checking"
_TIP = (
    "<qt>Asks the image: fits it (or takes the present fit), and tells for each effect how clearly "
    "it is seen, by how much the surface is off without it, and what it costs. Takes as long as a "
    "fit, often longer, in the background. Nothing is added before you tick it.</qt>"
)
_STALE = "this was of another image or PSF: check again"


class Check(Task):
    """Asks which effects an image calls for; ends where a fit is to start.

    Parameters
    ----------
    prepare : puts the fit together, in the thread.
    fitted : its last state, where there is one of these very settings.
    on_step : called with what is being done.
    on_end : called with what was found, or why nothing was; None where it was stopped.
    """

    title = "corrections are being checked"
    gives_way = True

    def __init__(
        self,
        prepare: Callable[[], FitInput],
        fitted: FitState | None,
        on_step: Callable[[str], None],
        on_end: Callable[[Recommendation | str | None], None],
    ) -> None:
        super().__init__()
        self.prepare, self.fitted = prepare, fitted
        self._on_step, self._on_end = on_step, on_end
        self.stage = "preparing"

    def steps(self) -> Generator[None, None, Recommendation]:
        state = self.fitted
        job = self.prepare()
        yield
        if state is None:
            for state in start(job):
                self.step(f"fitting: iteration {state.iteration}")
                yield
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
            progress=self.step,
        )

    def failed(self, error: Exception) -> str:
        return words_of(error)

    def look(self) -> None:
        self._on_step(f"{self.stage} ...")

    def end(self, outcome: Recommendation | str | None) -> None:
        self._on_end(outcome)


class EffectsPanel(QWidget):
    """Button, table and reasons; ``changed`` says that the user wants other effects."""

    changed = Signal()
    described = Signal()  # :meth:`summary` may be another

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._doc = doc
        self._effects = Effects()  # without the second view, which is chosen by its layer
        self._task: Check | None = None
        self._kept: Recommendation | None = None  # what was found, also of another image
        self._of: tuple[Any, ...] = ()
        self.found: Recommendation | None = None
        self.button = QPushButton(_START, self)
        self.button.setToolTip(_TIP)
        self.take_button = QPushButton("Use recommended", self)
        self.take_button.setToolTip("Tick the effects that are recommended.")
        self.progress, self.reason, self.remarks = Note(self), Note(self), Note(self)
        self.table = EffectsTable(CONSIDERED, self)
        self.second = SecondViewFields(doc, self)
        buttons = QHBoxLayout()
        for button in (self.button, self.take_button):
            buttons.addWidget(button)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addLayout(buttons)
        for widget in (self.progress, self.table, self.reason, self.remarks, self.second):
            layout.addWidget(widget)
        self.button.clicked.connect(self._pressed)
        self.take_button.clicked.connect(self.take_recommended)
        self.table.ticked.connect(self._ticked)
        self.table.looked_at.connect(self._explain)
        doc.second.edited.connect(self._second_edited)
        doc.work.changed.connect(self._work_changed)
        for signal in (doc.image.changed, doc.settings_changed):
            signal.connect(self.look)
        self._show_outcome()

    # -------------------------------------------------------------------------------- effects

    def effects(self) -> Effects:
        """Those ticked, with their numbers, and the second view.

        Raises
        ------
        InputError
            If the layer of the second view cannot be used.
        """
        return self._effects.in_role(ViewEffect, self._doc.second.view())

    @property
    def own(self) -> Effects:
        """The effects ticked, without the second view."""
        return self._effects

    def show_effects(self, effects: Effects) -> None:
        """Tick effects, without a signal; the second view, which is a layer, stays as it is."""
        self._effects = effects.in_role(ViewEffect, None)
        self.table.show_present(self._effects.names)
        self._show_outcome()

    def take_recommended(self) -> None:
        """Tick what is recommended."""
        for name in self._open_recommendations():
            self.table.tick(name)

    def summary(self) -> str:
        """The present choice in a few words."""
        view = [kind_of(ViewEffect).name] if self._doc.second.layer else []
        chosen = [*self._effects.names, *view]
        names = ", ".join(spoken(name) for name in chosen)
        more = self._open_recommendations()
        if more:
            recommended = spoken(more[0]) if len(more) == 1 else str(len(more))
            return f"{names or 'none'}; {recommended} recommended"
        if names or self.found is not None:
            return names or "none; no evidence for any"
        return "none; check this image"

    # ------------------------------------------------------------------------------- evidence

    @property
    def busy(self) -> bool:
        """Whether something is being checked."""
        return self._task is not None and self._task.running

    def start(self) -> None:
        """Check the image that is chosen."""
        try:
            task = self.asked()
            self._doc.work.start(task)
        except InputError as error:
            self.progress.say(str(error))
            return
        self._task, self._kept, self._of = task, None, scene_key(self._doc)
        self._work_changed()
        self.show_found(None)
        self.progress.say(f"{task.stage} ...")

    def asked(self) -> Check:
        """Of the fit of this image where there is one, else of the cells. InputError if neither."""
        doc, record = self._doc, self._doc.result
        frame, scene = doc.image.frame(), doc.settings.scene_settings()
        link = None if record is None else record.link
        if record is None or link is None or link.frame != frame or not link.at_time:
            return Check(doc.prepared()[0], None, self.progress.say, self._ended)
        state, job = record.of_fit()
        # Only the end of a fit with this PSF and these effects needs no other one.
        before = job.settings.scene
        if doc.settings.psf_is_open:  # the image has told it
            scene = scene.model_copy(update={"sigma": before.sigma})
        same = (
            state.converged
            and (before.sigma, before.optics) == (scene.sigma, scene.optics)
            and state.effects.names == scene.effects.names
        )
        if same:
            return Check(partial(_as_it_was, job), state, self.progress.say, self._ended)
        fit = job.settings.fit.model_copy(update={"levels": NEAR_LEVELS})
        changed = job.settings.model_copy(update={"scene": scene, "fit": fit})
        job = replace(job, second=doc.second.pixels())
        prepare = partial(_from_there, job, state, changed)
        return Check(prepare, None, self.progress.say, self._ended)

    def show_found(self, found: Recommendation | None) -> None:
        """Show what the image calls for; None: nothing is known."""
        self.found = found
        self.table.show_evidence(found.evidence if found else ())
        lines = [] if found is None else [*found.remarks, *_camera(found.camera)]
        self.remarks.say("; ".join(lines))
        self._explain("")
        self._show_outcome()

    # ----------------------------------------------------------------------------------- inside

    def _pressed(self) -> None:
        if self.busy:
            self._doc.work.stop(at_once=True)
        else:
            self.start()

    def _work_changed(self) -> None:
        self.button.setText(_STOP if self.busy else _START)
        self.button.setEnabled(self.busy or not self._doc.work.occupied)

    def _ended(self, outcome: Recommendation | str | None) -> None:
        if outcome is None or isinstance(outcome, str):
            self.progress.say(f"not checked: {outcome}" if outcome else "stopped")
        else:
            self._kept = outcome
            self.show_found(outcome)
            self.look()

    def look(self) -> None:
        """Something was edited: evidence of something else is put away, until that is back."""
        if self._kept is None or self.busy:
            return
        if self._of != scene_key(self._doc):
            self.show_found(None)
            self.progress.say(_STALE)
        elif self.found is None:
            self.show_found(self._kept)

    def _open_recommendations(self) -> list[str]:
        """What is recommended and not ticked."""
        found = self.found.recommended if self.found is not None else ()
        return [name for name in found if name not in self._effects.names]

    def _show_outcome(self) -> None:
        names = self._open_recommendations()
        self.take_button.setVisible(bool(names))
        if self.found is not None:
            text = ", ".join(spoken(name) for name in names)
            self.progress.say(
                f"recommended: {text}; choose a row to read why"
                if names
                else "the image gives no evidence for other corrections"
            )
        self.described.emit()

    def _second_edited(self) -> None:
        self.described.emit()
        self.changed.emit()

    def _ticked(self, name: str, on: bool) -> None:
        found = None if self.found is None else getattr(self.found.effects, name)
        try:
            added = (found or KINDS[name]()) if on else None
            effects = self._effects.replace(**{name: added})
        except (InputError, ValueError) as error:
            self.reason.say(f"{spoken(name)} cannot be added: {error}")
            self.table.show_present(self._effects.names)
            return
        self.reason.say("")
        self.show_effects(effects)
        self.changed.emit()

    def _explain(self, name: str) -> None:
        if not name:
            self.reason.say("")
            return
        known = {e.name: e.reason for e in (self.found.evidence if self.found else ())}
        self.reason.say(f"{spoken(name)}: {known.get(name) or KINDS[name].help}")


def _as_it_was(job: FitInput) -> FitInput:
    return job


def _from_there(job: FitInput, state: FitState, settings: RunSettings) -> FitInput:
    """The fit of other settings that starts where an earlier one ended."""
    return replace(job, settings=settings, mesh=state.mesh, optics=optics_of(settings.scene))


def _camera(camera: Camera) -> list[str]:
    """What the image tells about its camera, in a line; none where it tells nothing."""
    numbers = (("gain", camera.gain), ("read noise", camera.read_noise), ("offset", camera.offset))
    told = [f"{name} {finding.value:.3g}" for name, finding in numbers if finding.value is not None]
    return [f"camera, from the image: {', '.join(told)}"] if told else []


class SecondViewFields(QWidget):
    """Shows the second view of the document, and lets the user choose it."""

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.source = doc.second
        self.chooser = LayerChooser(doc.second, self)
        helped = kind_of(ViewEffect).help
        self.chooser.setToolTip(f"<qt>{helped[0].upper()}{helped[1:]}.</qt>")
        self.sigma = TripleField(
            "Standard deviations of the second view's PSF, um: known, or measured on a bead. "
            "They are held during a fit.",
            self,
        )
        self.note = Note(self, wrong=True)
        self._form = QFormLayout()
        self._form.setContentsMargins(0, 0, 0, 0)
        self._form.addRow("second view", self.chooser)
        self._form.addRow("its PSF, um", self.sigma)
        column(self._form, self.note, of=self)  # a form would cut a text of several lines
        self._of_layers = Connections()  # where the two layers lie
        doc.second.shown.connect(self._show)
        doc.at_end(self._of_layers.undo)
        self.sigma.edited.connect(self._sized)
        self._show()

    def _sized(self) -> None:
        self.source.resize(self.sigma.value())

    def _show(self) -> None:
        self._of_layers.undo()
        for layer in self.source.both():
            for moved in (layer.events.scale, layer.events.translate):
                self._of_layers.connect(moved, self._check)
        self.sigma.set_value(self.source.sigma)
        show_row(self._form, self.sigma, self.source.layer is not None)
        self._check()

    def _check(self, event: Any = None) -> None:
        """Say what is wrong with the layer, if anything."""
        try:
            self.source.view()
        except InputError as error:
            self.note.say(str(error))
        else:
            self.note.say("")
