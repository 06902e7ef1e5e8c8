"""The settings of a fit: PSF, accuracy, density and the rest, each explained by its field."""

from __future__ import annotations

from typing import Any, get_args

from qtpy.QtWidgets import QCheckBox, QComboBox, QFormLayout, QGroupBox, QSpinBox, QWidget
from superqt import QCollapsible

from ..job import SIGMA_IN_VOXELS
from ..settings import DensityModel, FitSettings, Likelihood, SceneSettings, validated
from .fields import TripleField
from .qt import Signal

_RARE = ("likelihood", "max_iterations")
ACCURACIES = ("1e-2", "3e-3", "1e-3", "3e-4", "1e-4", "1e-5", "0")


class SettingsPanel(QGroupBox):
    """Everything of the settings that the widget shows; ``changed`` comes from the user."""

    changed = Signal()

    def __init__(self, image_panel: Any, parent: QWidget | None = None) -> None:
        super().__init__("Optics and fit", parent)
        self._image = image_panel
        self._sigma_given = False
        self.sigma = TripleField(_tip(SceneSettings, "sigma"), self)
        self.fit_psf = QCheckBox("fit the PSF too", self)
        self.accuracy = QComboBox(self)
        self.accuracy.setEditable(True)
        self.accuracy.addItems(ACCURACIES)
        self.density = QComboBox(self)
        self.density.addItems(get_args(DensityModel))
        self.likelihood = QComboBox(self)
        self.likelihood.addItems(get_args(Likelihood))
        self.max_iterations = QSpinBox(self)
        self.max_iterations.setRange(1, 1_000_000)
        layout = QFormLayout(self)
        layout.addRow("PSF sigma, um", self.sigma)
        layout.addRow("", self.fit_psf)
        more = QWidget()
        inner = QFormLayout(more)
        inner.setContentsMargins(0, 0, 0, 0)
        for form, names in ((layout, ("accuracy", "density")), (inner, _RARE)):
            for name in names:
                form.addRow(name.replace("_", " "), getattr(self, name))
        folded = QCollapsible("more", self)
        folded.setContent(more)
        folded.collapse(animate=False)
        layout.addRow(folded)
        for name in ("fit_psf", "accuracy", "density", "likelihood", "max_iterations"):
            getattr(self, name).setToolTip(_tip(FitSettings, name))
        self.show_settings(FitSettings())
        image_panel.changed.connect(self._guess_sigma)
        self.sigma.edited.connect(self._sigma_edited)
        self._guess_sigma()

    def fit_settings(self) -> FitSettings:
        """The settings shown. InputError names the field that is wrong."""
        values = {
            "accuracy": self.accuracy.currentText(),
            "fit_psf": self.fit_psf.isChecked(),
            "density": self.density.currentText(),
            "likelihood": self.likelihood.currentText(),
            "max_iterations": self.max_iterations.value(),
        }
        settings: FitSettings = validated(FitSettings, values)
        return settings

    def scene_settings(self) -> SceneSettings:
        """Voxel size of the image chosen, and PSF."""
        values = {"voxel_size": self._image.frame().voxel_size, "sigma": self.sigma.value()}
        settings: SceneSettings = validated(SceneSettings, values)
        return settings

    def show_settings(self, settings: FitSettings) -> None:
        """Show settings."""
        self.fit_psf.setChecked(settings.fit_psf)
        self.accuracy.setCurrentText(_short(settings.accuracy))
        self.density.setCurrentText(settings.density)
        self.likelihood.setCurrentText(settings.likelihood)
        self.max_iterations.setValue(settings.max_iterations)

    def show_sigma(self, sigma: tuple[float, float, float]) -> None:
        """Show PSF widths that are known, um."""
        self._sigma_given = True
        self.sigma.set_value(sigma)

    def _guess_sigma(self) -> None:
        if self._image.layer is not None and not self._sigma_given:
            self.sigma.set_value([SIGMA_IN_VOXELS * d for d in self._image.voxel_size.value()])

    def _sigma_edited(self) -> None:
        self._sigma_given = True
        self.changed.emit()


def _tip(model: Any, name: str) -> str:
    text = str(model.model_fields[name].description)
    return f"<qt>{text[0].upper()}{text[1:]}.</qt>"  # rich text is wrapped


def _short(accuracy: float) -> str:
    return next((text for text in ACCURACIES if float(text) == accuracy), f"{accuracy:g}")
