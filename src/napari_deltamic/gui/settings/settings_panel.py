"""The settings of a fit: how careful, and, folded away, everything else."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from qtpy.QtWidgets import QFormLayout, QGroupBox, QLabel, QToolButton, QVBoxLayout, QWidget
from superqt.utils import signals_blocked

from ...accuracy.accuracy_chart import short
from ...common.description import described
from ...errors import InputError
from ...fitting.model.default_accuracy import PRESETS, written
from ...runs.settings import FitSettings
from ..document import Document
from ..fields import Form
from ..widgets import Fold, Note, column, filled, row
from .accuracy_forecast import AccuracyDial, AccuracyForecast, TradeoffView

# Where else than among those for experts a setting is shown.
_PSF, _BRIGHTNESS = ("fit_psf",), ("density",)
_OWN = ("accuracy", "shape_error", *_PSF, *_BRIGHTNESS)


class SettingsPanel(QGroupBox):
    """Shows all settings of a fit.

    ``advanced`` is the part that is shown elsewhere, folded away.

    Parameters
    ----------
    optics, effects : the parts that hold the PSF and the corrections.
    """

    def __init__(self, doc: Document, optics: Any, effects: Any, parent: QWidget) -> None:
        super().__init__("3  Fit", parent)
        self._choice = doc.settings
        self.optics, self.effects = optics, effects
        self.sigma = self.optics.sigma
        experts = [name for name in described(FitSettings) if name not in _OWN]
        self.forms = [Form(FitSettings, names, self) for names in (_PSF, _BRIGHTNESS, experts)]
        self.fields = {name: field for form in self.forms for name, field in form.fields.items()}
        self.fit_psf, self.density = self.fields["fit_psf"], self.fields["density"]
        self.max_iterations = self.fields["max_iterations"]
        self.accuracy = AccuracyDial(self)
        self.accuracy_number = QLabel(self)  # what the dial stands for
        self.outlook, self.pace = Note(self), Note(self)  # predicted, and measured, times
        self.outlook.setToolTip(
            "Before the first fit of an image, this assumes a fit that settles quickly; where the "
            "image shows more than the model describes, it can take many times as long. After "
            "that, it goes by how long fits of this image took."
        )
        self.tradeoff = TradeoffView(doc, self)
        self.psf_button = QToolButton(self)
        self.advanced = self._lay_out()
        self._show()
        for form in self.forms:
            form.edited.connect(self._edited)
        typed: Any = self.accuracy.lineEdit()
        for signal in (self.accuracy.activated, typed.editingFinished):
            signal.connect(self._accuracy_edited)
        self.accuracy.currentTextChanged.connect(self._choice.type_accuracy)
        self._choice.changed.connect(self._show)
        for part in (self.optics, self.effects):
            part.described.connect(self._show_choices)
        self.psf_button.clicked.connect(self._show_psf)
        self.tradeoff.chosen.connect(self._take_accuracy)
        self.forecast = AccuracyForecast(doc, self.accuracy, self)
        self.forecast.predicts.connect(self.outlook.say)
        self.forecast.last_run.connect(self.pace.say)
        self.forecast.number_changed.connect(self._show_number)

    def estimate_all(self) -> None:
        """Let the fit find all that it can."""
        self.fit_psf.setChecked(True)
        self.density.setCurrentText("smooth")

    def _lay_out(self) -> Fold:
        # napari's style would draw it as one of its square icons.
        self.psf_button.setStyleSheet(
            "QToolButton { border: none; background: transparent; text-decoration: underline; }"
        )
        self.psf_button.setText("change")
        self.psf_button.setToolTip("Choose the PSF, and whether the fit estimates it.")
        self.psf_line = Note(self)
        dial = row(self.accuracy, (self.outlook, 1))
        filled(QVBoxLayout(self), dial, row((self.psf_line, 1), self.psf_button))
        self.optics.layout().addWidget(self.forms[0])
        self.psf_fold = Fold("", self.optics, self)
        self.effects_fold = Fold("", self.effects, self)
        speed = QWidget(self)
        rows = QFormLayout(speed)
        rows.setContentsMargins(0, 0, 0, 0)
        rows.addRow("error of the image", self.accuracy_number)
        rows.addRow(self.pace)
        rows.addRow(self.tradeoff)
        self.speed_fold = Fold("Speed: what accuracy costs here", speed, self)
        self.more = Fold("For experts", self.forms[2], self)
        inner = QWidget(self)
        parts = self.psf_fold, self.effects_fold, self.forms[1], self.speed_fold, self.more
        column(*parts, of=inner).setContentsMargins(8, 0, 0, 0)
        return Fold("Advanced: microscope, corrections, more", inner)

    def _show_psf(self) -> None:
        self.advanced.unfold()
        self.psf_fold.unfold()

    def _show_choices(self) -> None:
        """Summarise the choices while their fields are folded away."""
        psf = self.optics.summary()
        fitted = ", then fitted with the shapes" if self.fit_psf.isChecked() else ""
        if self._choice.psf_is_open:
            psf = "as wide as the blur of the image"
        self.psf_line.say(f"PSF: {psf}{fitted}")
        self.psf_fold.set_title(f"Microscope: {psf}")
        self.effects_fold.set_title(f"Corrections: {self.effects.summary()}")

    def _show(self, by_user: bool = False) -> None:
        if not by_user:
            with suppress(InputError):  # what was typed last stays
                settings = self._choice.other_settings()
                for form in self.forms:
                    with signals_blocked(form):
                        form.show_values(settings)
            self.accuracy.show_choice(self._choice.accuracy)
        self._show_choices()

    def _edited(self) -> None:
        values = (form.values() for form in self.forms)
        self._choice.edit_fit({name: value for part in values for name, value in part.items()})

    def _accuracy_edited(self) -> None:
        self._choice.edit_accuracy(self.accuracy.currentText())

    def _take_accuracy(self, accuracy: float) -> None:
        self.accuracy.show_choice(written(accuracy))
        self._accuracy_edited()

    def _show_number(self, number: float | None) -> None:
        named = self._choice.accuracy in PRESETS
        text = f"{short(number) if number else 0}" if named and number is not None else ""
        self.accuracy_number.setText(text)
        self.tradeoff.show_accuracy(number)
