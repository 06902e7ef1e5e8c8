"""The fit: how careful, and, folded away, everything else that can be chosen of it."""

from __future__ import annotations

import weakref
from typing import Any

from qtpy.QtWidgets import QFormLayout, QGroupBox, QLabel, QToolButton, QVBoxLayout, QWidget

from ...accuracy.accuracy_chart import short
from ...common.description import described
from ...fitting.default_accuracy import PRESETS
from ...fitting.job import SIGMA_IN_VOXELS
from ...runs.settings import FitSettings, SceneSettings, validated
from ..document import Document
from ..fields import Form
from ..viewing.frame import voxel_size
from ..widgets import Fold, Note, column, filled, row
from .accuracy_forecast import AccuracyDial, AccuracyForecast, NoiseOf
from .accuracy_view import TradeoffView

# Where else than among those for experts a setting is shown.
_PSF, _BRIGHTNESS = ("fit_psf",), ("density",)
_OWN = ("accuracy", "shape_error", *_PSF, *_BRIGHTNESS)


class SettingsPanel(QGroupBox):
    """Everything of the settings that the widget shows.

    ``advanced`` is the part that is shown elsewhere, folded away.

    Parameters
    ----------
    optics, effects : the parts that hold the PSF and the corrections.
    """

    def __init__(
        self, doc: Document, optics: Any, effects: Any, parent: QWidget | None = None
    ) -> None:
        super().__init__("3  Fit", parent)
        self._doc, self._image = doc, doc.image
        doc.take_settings(self)
        self._sigma_given = False
        self._shown_for: Any = None  # a weak reference to the image that came with its PSF
        self.optics, self.effects = optics, effects
        self.sigma = self.optics.sigma
        experts = [name for name in described(FitSettings) if name not in _OWN]
        self.forms = [Form(FitSettings, names, self) for names in (_PSF, _BRIGHTNESS, experts)]
        self.fields = {name: field for form in self.forms for name, field in form.fields.items()}
        self.fit_psf, self.density = self.fields["fit_psf"], self.fields["density"]
        self.max_iterations = self.fields["max_iterations"]
        noise = NoiseOf(doc)
        self.accuracy = AccuracyDial(noise, self)
        self.accuracy_number = QLabel(self)  # what the dial stands for
        self.outlook, self.pace = Note(self), Note(self)  # predicted, and measured, times
        self.tradeoff = TradeoffView(doc, self)
        self.psf_button = QToolButton(self)
        self.advanced = self._lay_out()
        self.show_settings(FitSettings())
        typed: Any = self.accuracy.lineEdit()
        for signal in (
            *(form.edited for form in self.forms),
            self.effects.changed,
            self.accuracy.activated,
            typed.editingFinished,
        ):
            signal.connect(self._edited)
        doc.image.changed.connect(self._guess_sigma)
        self.sigma.edited.connect(self._sigma_given_by_user)
        self.optics.changed.connect(self._edited)
        for shown in (self._show_choices, self.effects.look, self.tradeoff.look):
            self.optics.described.connect(shown)
        self.effects.described.connect(self._show_choices)
        self.fit_psf.toggled.connect(self._show_choices)
        self.psf_button.clicked.connect(self._show_psf)
        self.tradeoff.chosen.connect(self._take_accuracy)
        self.forecast = AccuracyForecast(doc, self.accuracy, noise, self)
        self.forecast.predicts.connect(self.outlook.say)
        self.forecast.last_run.connect(self.pace.say)
        self.forecast.number_changed.connect(self._show_number)
        self._guess_sigma()
        self._show_choices()

    def estimate_all(self) -> None:
        """Let the fit find all that it can."""
        self.fit_psf.setChecked(True)
        self.density.setCurrentText("smooth")

    def fit_settings(self) -> FitSettings:
        """The settings shown. InputError names the field that is wrong."""
        chosen = {"accuracy": self.accuracy.setting(), "shape_error": self.accuracy.shape_error}
        return self.other_settings().model_copy(update=chosen)

    def other_settings(self) -> FitSettings:
        """The settings shown, without the accuracy."""
        values = {name: value for form in self.forms for name, value in form.values().items()}
        settings: FitSettings = validated(FitSettings, values)
        return settings

    def scene_settings(self) -> SceneSettings:
        """Voxel size of the image chosen, PSF and effects."""
        optics = self.optics.settings()
        values = {
            "voxel_size": self._image.frame().voxel_size,
            "sigma": self.sigma.value() if optics is None else None,
            "optics": optics,
            "effects": self.effects.effects(),
        }
        settings: SceneSettings = validated(SceneSettings, values)
        return settings

    @property
    def psf_is_open(self) -> bool:
        """Whether nobody has said what the PSF is: the image is to tell it when a fit starts."""
        return not self._sigma_given and self.optics.is_gaussian

    def show_settings(self, settings: FitSettings) -> None:
        for form in self.forms:
            form.show_values(settings)
        self.accuracy.show_fit(settings.accuracy, settings.shape_error)

    def show_sigma(self, sigma: tuple[float, float, float]) -> None:
        """Show PSF widths that are known, um."""
        self._sigma_given = True
        self.optics.show_sigma(sigma)

    def show_scene(self, scene: SceneSettings) -> None:
        """Show the PSF and the effects of settings, which belong to the image chosen."""
        layer = self._image.layer
        self._shown_for = None if layer is None else weakref.ref(layer)
        self.optics.show_settings(scene.optics)
        if scene.sigma is not None:
            self.show_sigma(scene.sigma)
        self.effects.show_effects(scene.effects)

    # ----------------------------------------------------------------------------------- inside

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

    def _show_choices(self, checked: bool = False) -> None:
        """What is chosen is told while its fields are folded away."""
        psf = self.optics.summary()
        fitted = ", then fitted with the shapes" if self.fit_psf.isChecked() else ""
        if self.psf_is_open:
            psf = "as wide as the blur of the image"
        self.psf_line.say(f"PSF: {psf}{fitted}")
        self.psf_fold.set_title(f"Microscope: {psf}")
        self.effects_fold.set_title(f"Corrections: {self.effects.summary()}")

    def _guess_sigma(self) -> None:
        if self._shown_for is not None and self._shown_for() is not self._image.layer:
            self._shown_for, self._sigma_given = None, False
            self.optics.show_settings(None)
        if self._image.layer is not None and not self._sigma_given:
            sizes = voxel_size(self._image.layer)
            self.optics.show_sigma([SIGMA_IN_VOXELS * d for d in sizes])
        self._show_choices()

    def _edited(self, value: Any = None) -> None:
        self._doc.settings_changed.emit()

    def _take_accuracy(self, accuracy: float) -> None:
        self.accuracy.show_fit(accuracy, "normal")
        self._edited()

    def _show_number(self, number: float | None) -> None:
        named = self.accuracy.choice in PRESETS
        text = f"{short(number) if number else 0}" if named and number is not None else ""
        self.accuracy_number.setText(text)
        self.tradeoff.show_accuracy(number)

    def _sigma_given_by_user(self) -> None:
        self._sigma_given, self._shown_for = True, None
        self._show_choices()
