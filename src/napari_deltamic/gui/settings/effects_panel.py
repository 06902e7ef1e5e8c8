"""Which corrections are computed, and what the image says about them."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace
from functools import partial
from typing import Any

from qtpy.QtWidgets import QFormLayout, QWidget

from ...common.doing import heard
from ...common.words import sentence
from ...errors import InputError
from ...evidence import Recommendation, recommend_for
from ...evidence.camera import Camera
from ...fitting import FitState
from ...fitting.job import FitInput, optics_of, start
from ...runs.settings import NEAR_LEVELS
from ...scene.effects import KINDS, Effects, ViewEffect, kind_of
from ..document import Document
from ..fields import TripleField
from ..viewing.listening import Connections
from ..widgets import LayerChooser, Note, Signal, button, column, row
from ..window_words import as_tip
from ..work import Question
from .accuracy_forecast import TaskButton
from .effects_table import EffectsTable, spoken

_TITLES = "Check this image", "Stop checking"
_TIP = (
    "Tests which corrections the image needs: fits it (or uses the current fit), and says for each "
    "one how clearly it is seen, how far off the surface is without it, and what it costs. "
    "Takes at least as long as a fit, in the background. Nothing is added until you tick it."
)
_STALE = "these results are for another image or PSF: check again"


class EffectsPanel(QWidget):
    """Button, table and reasons."""

    described = Signal()  # :meth:`summary` may be another

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._doc, self._choice = doc, doc.settings
        self._shown: Effects | None = None
        self._kept: Recommendation | None = None  # what was found, also of another image
        self.found: Recommendation | None = None
        self.reason, self.remarks = Note(self), Note(self)
        self.button = TaskButton(doc, _TITLES, _TIP, self._question, self)
        self.progress = self.button.progress
        tip = "Tick those that are recommended."
        self.take_button = button("Use recommended", tip, self.take_recommended, self)
        self.table = EffectsTable(self)
        self.second = SecondViewFields(doc, self)
        said = self.progress, self.table, self.reason, self.remarks, self.second
        column(row(self.button, self.take_button), *said, of=self)
        self.button.began.connect(self._began)
        doc.work.looked.connect(self._show_stage)
        self.table.ticked.connect(self._ticked)
        self.table.looked_at.connect(self._explain)
        self._choice.changed.connect(self._show)
        for signal in (doc.image.changed, self._choice.changed):
            signal.connect(self.look)
        self._show()

    # -------------------------------------------------------------------------------- effects

    def take_recommended(self) -> None:
        for name in self._open_recommendations():
            self.table.tick(name)

    def summary(self) -> str:
        """The present choice in a few words."""
        view = [kind_of(ViewEffect).name] if self._doc.second.layer else []
        chosen = [*self._choice.effects.names, *view]
        names = ", ".join(spoken(name) for name in chosen)
        more = self._open_recommendations()
        if more:
            recommended = spoken(more[0]) if len(more) == 1 else str(len(more))
            return f"{names or 'none'}; {recommended} recommended"
        if names or self.found is not None:
            return names or "none; no evidence for any"
        return "none; check this image"

    # ------------------------------------------------------------------------------- evidence

    def asked(self) -> tuple[Callable[[], FitInput], FitState | None]:
        """A function that puts a fit together, and its last state if it has the same settings.

        That is the fit of this image, else one of the cells. InputError where there is neither.
        """
        doc, record = self._doc, self._doc.result
        frame, scene = doc.image.frame(), doc.settings.scene_settings()
        link = None if record is None else record.link
        here = link is not None and link.image_layer is doc.image.layer and link.frame == frame
        if record is None or link is None or not here or not link.at_time:
            return doc.prepared()[0], None
        state, job = record.of_fit()
        # Only the end of a fit with this PSF and these effects needs no other one.
        before = job.settings.scene
        if self._choice.psf_is_open:  # the image has told it
            scene = scene.model_copy(update={"sigma": before.sigma})
        same = (
            state.converged
            and (before.sigma, before.optics) == (scene.sigma, scene.optics)
            and state.effects.names == scene.effects.names
        )
        if same:
            return (lambda: job), state
        fit = job.settings.fit.model_copy(update={"levels": NEAR_LEVELS})
        job = job.with_settings(scene=scene, fit=fit)
        # It starts where the earlier one ended; its PSF is computed in the thread.
        start_there = partial(replace, job, mesh=state.mesh, second=doc.second.pixels())
        return (lambda: start_there(optics=optics_of(scene))), None

    def show_found(self, found: Recommendation | None) -> None:
        """Show what the image calls for; None if that is not known."""
        self.found = found
        self.table.show_evidence(found.evidence if found else ())
        lines = [] if found is None else [*found.remarks, *_camera(found.camera)]
        self.remarks.say("; ".join(lines))
        self._explain("")
        self._show_outcome()

    def _question(self) -> Question:
        steps = partial(_check, *self.asked())
        return Question("corrections are being checked", steps, self._ended)

    def _began(self) -> None:
        self._kept = None
        self.show_found(None)
        self._show_stage()

    def _show_stage(self) -> None:
        if self.button.busy and self.button.task is not None:
            self.progress.say(f"{self.button.task.stage} ...")

    def _ended(self, outcome: Recommendation | str | None) -> None:
        if outcome is None or isinstance(outcome, str):
            self.progress.say(f"not checked: {outcome}" if outcome else "stopped")
        else:
            self._kept = outcome
            self.show_found(outcome)
            self.look()

    def look(self) -> None:
        """After an edit, put away evidence that belongs to other settings, until these are back."""
        if self._kept is None or self.button.busy:
            return
        if self.button.stale:
            self.show_found(None)
            self.progress.say(_STALE)
        elif self.found is None:
            self.show_found(self._kept)

    def _open_recommendations(self) -> list[str]:
        """The effects that are recommended but not ticked."""
        found = self.found.recommended if self.found is not None else ()
        return [name for name in found if name not in self._choice.effects.names]

    def _show_outcome(self) -> None:
        names = self._open_recommendations()
        self.take_button.setVisible(bool(names))
        if self.found is not None:
            text, ticked = ", ".join(map(spoken, names)), self._choice.effects.names
            self.progress.say(
                f"recommended: {text}; choose a row to read why"
                if names
                else f"the image gives no evidence for {'other' if ticked else 'any'} corrections"
            )
        self.described.emit()

    def _show(self, by_user: bool = False) -> None:
        if self._choice.effects is not self._shown:
            self._shown = self._choice.effects
            self.table.show_present(self._shown.names)
            self._show_outcome()

    def _ticked(self, name: str, on: bool) -> None:
        found = None if self.found is None else getattr(self.found.effects, name)
        try:
            added = (found or KINDS[name]()) if on else None
            effects = self._choice.effects.replace(**{name: added})
        except (InputError, ValueError) as error:
            self.reason.say(f"{spoken(name)} cannot be added: {error}")
            self.table.show_present(self._choice.effects.names)
            return
        self.reason.say("")
        self._choice.edit_effects(effects)

    def _explain(self, name: str) -> None:
        if not name:
            self.reason.say("")
            return
        known = {e.name: e.reason for e in (self.found.evidence if self.found else ())}
        self.reason.say(f"{spoken(name)}: {known.get(name) or KINDS[name].help}")


def _check(
    prepare: Callable[[], FitInput], fitted: FitState | None, question: Question
) -> Generator[None, None, Recommendation]:
    """Judge which effects an image calls for; runs in a thread.

    prepare : puts the fit together.
    fitted : its last state, where there is one of these very settings.
    """
    state, job = fitted, prepare()
    yield
    if state is None:
        for state in heard(start(job), lambda what: question.step(what and f"fitting: {what}")):
            question.step(f"fitting: iteration {state.iteration}")
            yield
    assert state is not None, "a fit yields at least one state"
    return recommend_for(job, state, progress=question.step)


def _camera(camera: Camera) -> list[str]:
    """Lines on what the image tells about its camera: one, or none."""
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
        self.chooser.setToolTip(as_tip(sentence(helped)))
        self.sigma = TripleField(
            "Standard deviations of the second view's PSF, um: known, or measured on a bead. "
            "They are held during a fit.",
            self,
        )
        self.note = Note(self, "poor")
        self._form = QFormLayout()
        self._form.setContentsMargins(0, 0, 0, 0)
        self._form.addRow("second view", self.chooser)
        self._form.addRow("its PSF, µm", self.sigma)
        column(self._form, self.note, of=self)  # a form would cut a text of several lines
        self._of_layers = Connections()  # where the two layers lie
        doc.second.shown.connect(self._show)
        doc.at_end(self._of_layers.undo)
        self.sigma.edited.connect(doc.second.resize)
        self._show()

    def _show(self) -> None:
        self._of_layers.undo()
        for layer in self.source.both():
            for moved in (layer.events.scale, layer.events.translate):
                self._of_layers.connect(moved, self._check)
        self.sigma.set_value(self.source.sigma)
        self._form.setRowVisible(self.sigma, self.source.layer is not None)
        self._check()

    def _check(self, event: Any = None) -> None:
        """Say what is wrong with the layer, if anything."""
        try:
            self.source.view()
        except InputError as error:
            self.note.say(sentence(str(error)))
        else:
            self.note.say("")
