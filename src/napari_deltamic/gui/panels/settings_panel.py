"""The settings of a fit: PSF, accuracy, density and the rest, each explained by its field."""

from __future__ import annotations

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

from ...inference.default_accuracy import image_noise
from ...job import SIGMA_IN_VOXELS
from ...settings import (
    EFFECT_HELP,
    DensityModel,
    FitSettings,
    Likelihood,
    SceneSettings,
    validated,
)
from ..accuracy.accuracy_dial import AccuracyDial
from ..accuracy.accuracy_view import TradeoffView
from ..qt import Signal
from .fields import TripleField
from .fold import Fold
from .note import Note

_RARE = ("density", "likelihood", "max_iterations")
_SWITCHES = {
    "fit_psf": "fit the PSF too",
    "remesh": "remesh slivers",
    "collisions": "surfaces never cross",
}


class SettingsPanel(QGroupBox):
    """Everything of the settings that the widget shows; ``changed`` comes from the user."""

    changed = Signal()

    def __init__(self, image_panel: Any, parent: QWidget | None = None) -> None:
        super().__init__("Optics and fit", parent)
        self._image = image_panel
        self._sigma_given = False
        self.sigma = TripleField(_tip(SceneSettings, "sigma"), self)
        self.switches = {name: QCheckBox(text, self) for name, text in _SWITCHES.items()}
        self.fit_psf = self.switches["fit_psf"]
        self.effects = {name: QCheckBox(name.replace("_", " "), self) for name in EFFECT_HELP}
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
        more = QWidget()
        inner = QFormLayout(more)
        inner.setContentsMargins(0, 0, 0, 0)
        dial = QHBoxLayout()
        dial.addWidget(self.accuracy, 1)
        dial.addWidget(self.accuracy_number)
        layout.addRow("accuracy", dial)
        for row in (self.outlook, self.pace):
            layout.addRow(row)
        inner.addRow(self.tradeoff)
        # In a row of its own: the dock may be narrow.
        inner.addRow(QLabel("PSF sigma, um", self))
        inner.addRow(self.sigma)
        inner.addRow("", self.fit_psf)
        for k, (name, box) in enumerate(self.effects.items()):
            box.setToolTip(_rich(EFFECT_HELP[name]))
            inner.addRow("" if k else "effects", box)
        for name in _RARE:
            inner.addRow(name.replace("_", " "), getattr(self, name))
        for name in ("remesh", "collisions"):
            inner.addRow("", self.switches[name])
        self.more = Fold("PSF, density and more", more, self)
        layout.addRow(self.more)
        for name in _RARE:
            getattr(self, name).setToolTip(_tip(FitSettings, name))
        for name, box in self.switches.items():
            box.setToolTip(_tip(FitSettings, name))
        self.show_settings(FitSettings())
        typed: Any = self.accuracy.lineEdit()
        for signal in (
            *(box.toggled for box in (*self.switches.values(), *self.effects.values())),
            self.accuracy.activated,
            typed.editingFinished,
            self.density.currentTextChanged,
            self.likelihood.currentTextChanged,
            self.max_iterations.valueChanged,
        ):
            signal.connect(self._edited)
        self.max_iterations.setKeyboardTracking(False)
        image_panel.changed.connect(self._guess_sigma)
        self.sigma.edited.connect(self._sigma_edited)
        self._guess_sigma()

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
        values = {
            "voxel_size": self._image.frame().voxel_size,
            "sigma": self.sigma.value(),
            "effects": tuple(name for name, box in self.effects.items() if box.isChecked()),
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
        self.sigma.set_value(sigma)

    def show_effects(self, effects: tuple[str, ...]) -> None:
        """Tick effects."""
        for name, box in self.effects.items():
            box.setChecked(name in effects)

    def _guess_sigma(self) -> None:
        if self._image.layer is not None and not self._sigma_given:
            self.sigma.set_value([SIGMA_IN_VOXELS * d for d in self._image.voxel_size.value()])

    def _edited(self, value: Any = None) -> None:
        self.changed.emit()

    def _sigma_edited(self) -> None:
        self._sigma_given = True
        self.changed.emit()


def _tip(model: Any, name: str) -> str:
    return _rich(str(model.model_fields[name].description))


def _rich(text: str) -> str:
    return f"<qt>{text[0].upper()}{text[1:]}.</qt>"  # rich text is wrapped
