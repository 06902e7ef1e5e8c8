"""The settings of a fit: PSF, accuracy, density and the rest, each explained by its field."""

from __future__ import annotations

import weakref
from typing import Any, get_args

from qtpy.QtWidgets import (
    QCheckBox,
    QComboBox,
    QFormLayout,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QSpinBox,
    QWidget,
)

from ...common.choices import DensityModel, Likelihood
from ...fitting.default_accuracy import image_noise
from ...fitting.job import SIGMA_IN_VOXELS
from ...runs.settings import FitSettings, SceneSettings, validated
from ...scene.effects import Effects
from ..accuracy.accuracy_dial import AccuracyDial
from ..accuracy.accuracy_view import TradeoffView
from ..effects.effects_panel import EffectsPanel
from ..optics.optics_panel import OpticsPanel
from ..qt import Signal
from .fold import Fold
from .note import Note

_RARE = ("density", "likelihood", "max_iterations")
_SWITCHES = {
    "fit_psf": "fit the PSF too",
    "remesh": "remesh slivers",
    "collisions": "surfaces never cross",
    "topology": "cells may change neighbours",
}


class SettingsPanel(QGroupBox):
    """Everything of the settings that the widget shows; ``changed`` comes from the user."""

    changed = Signal()

    def __init__(self, viewer: Any, image_panel: Any, parent: QWidget | None = None) -> None:
        super().__init__("Optics and fit", parent)
        self._image = image_panel
        self._sigma_given = False
        self._shown_for: Any = None  # a weak reference to the image that came with its PSF
        self.optics = OpticsPanel(viewer, _tip(SceneSettings, "sigma"), self)
        self.sigma = self.optics.sigma
        self.switches = {name: QCheckBox(text, self) for name, text in _SWITCHES.items()}
        self.fit_psf = self.switches["fit_psf"]
        self.effects = EffectsPanel(viewer, image_panel, self)
        self.accuracy = AccuracyDial(lambda: image_noise(image_panel.stack()), self)
        self.accuracy_number = QLabel(self)  # what the dial stands for
        self.outlook, self.pace = Note(self), Note(self)  # predicted, and measured, times
        self.tradeoff = TradeoffView(self)
        self.density = QComboBox(self)
        self.density.addItems(get_args(DensityModel))
        self.likelihood = QComboBox(self)
        self.likelihood.addItems(get_args(Likelihood))
        self.max_iterations = QSpinBox(self)
        self.max_iterations.setRange(1, 1_000_000)
        layout = QFormLayout(self)
        dial = QHBoxLayout()
        dial.addWidget(self.accuracy, 1)
        dial.addWidget(self.accuracy_number)
        layout.addRow("accuracy", dial)
        for row in (self.outlook, self.pace):
            layout.addRow(row)
        self.optics.layout().addWidget(self.fit_psf)  # type: ignore[union-attr]
        self.psf_fold = Fold("", self.optics, self)
        self.effects_fold = Fold("", self.effects, self)
        self.more = Fold("Density, cost and more", self._rest(), self)
        for fold in (self.psf_fold, self.effects_fold, self.more):
            layout.addRow(fold)
        for name in _RARE:
            getattr(self, name).setToolTip(_tip(FitSettings, name))
        for name, box in self.switches.items():
            box.setToolTip(_tip(FitSettings, name))
        self.show_settings(FitSettings())
        typed: Any = self.accuracy.lineEdit()
        for signal in (
            *(box.toggled for box in self.switches.values()),
            self.effects.changed,
            self.accuracy.activated,
            typed.editingFinished,
            self.density.currentTextChanged,
            self.likelihood.currentTextChanged,
            self.max_iterations.valueChanged,
        ):
            signal.connect(self._edited)
        self.max_iterations.setKeyboardTracking(False)
        image_panel.changed.connect(self._guess_sigma)
        self.sigma.edited.connect(self._sigma_given_by_user)
        self.optics.changed.connect(self._edited)
        self.optics.described.connect(self._show_choices)
        self.effects.described.connect(self._show_choices)
        self._guess_sigma()
        self._show_choices()

    def fit_settings(self) -> FitSettings:
        """The settings shown. InputError names the field that is wrong."""
        return self.other_settings().model_copy(update={"accuracy": self.accuracy.setting()})

    def other_settings(self) -> FitSettings:
        """The settings shown, without the accuracy."""
        values = {
            **{name: box.isChecked() for name, box in self.switches.items()},
            "density": self.density.currentText(),
            "likelihood": self.likelihood.currentText(),
            "max_iterations": self.max_iterations.value(),
        }
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

    def show_settings(self, settings: FitSettings) -> None:
        """Show settings."""
        for name, box in self.switches.items():
            box.setChecked(getattr(settings, name))
        self.accuracy.show_accuracy(settings.accuracy)
        self.density.setCurrentText(settings.density)
        self.likelihood.setCurrentText(settings.likelihood)
        self.max_iterations.setValue(settings.max_iterations)

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
        self.show_effects(scene.effects)

    def show_effects(self, effects: Effects) -> None:
        """Tick effects."""
        self.effects.show_effects(effects)

    def _rest(self) -> QWidget:
        rest = QWidget()
        inner = QFormLayout(rest)
        inner.setContentsMargins(0, 0, 0, 0)
        inner.addRow(self.tradeoff)
        for name in _RARE:
            inner.addRow(name.replace("_", " "), getattr(self, name))
        for name in ("remesh", "collisions", "topology"):
            inner.addRow(self.switches[name])  # across both columns: a narrow dock has no room
        return rest

    def _show_choices(self) -> None:
        """What is chosen is told while its fields are folded away."""
        self.psf_fold.set_title(f"PSF: {self.optics.summary()}")
        self.effects_fold.set_title(f"Effects: {self.effects.summary()}")

    def _guess_sigma(self) -> None:
        if self._shown_for is not None and self._shown_for() is not self._image.layer:
            self._shown_for, self._sigma_given = None, False
            self.optics.show_settings(None)
        if self._image.layer is not None and not self._sigma_given:
            sizes = self._image.voxel_size.value()
            self.optics.show_sigma([SIGMA_IN_VOXELS * d for d in sizes])

    def _edited(self, value: Any = None) -> None:
        self.changed.emit()

    def _sigma_given_by_user(self) -> None:
        self._sigma_given, self._shown_for = True, None


def _tip(model: Any, name: str) -> str:
    return _rich(str(model.model_fields[name].description))


def _rich(text: str) -> str:
    return f"<qt>{text[0].upper()}{text[1:]}.</qt>"  # rich text is wrapped
