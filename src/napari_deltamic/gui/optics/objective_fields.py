"""The numbers on an objective, of which only those are shown that the modality needs."""

from __future__ import annotations

from typing import Any

from qtpy.QtWidgets import QWidget

from ...runs.optics_settings import MicroscopeOptics, optics_from_values
from ..fields import Form

_LIT = ("confocal", "spinning disk")
_LAYERED = ("vectorial", "gibson-lanni")


class ObjectiveFields(Form):
    """Fields of :class:`MicroscopeOptics`; ``edited`` comes from the user."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(MicroscopeOptics, parent=parent)
        self.modality, self.model = self.fields["modality"], self.fields["model"]
        self.fields["immersion"].setCurrentText("water")
        self.numbers = {n: self.fields[n] for n, d in self.described.items() if d.kind == "number"}
        self._fitted: tuple[str, ...] | None = None
        self._zernike: dict[int, float] | None = None
        self.edited.connect(self._show_rows)
        self._show_rows()

    def settings(self) -> MicroscopeOptics:
        """The settings shown. InputError where one is missing."""
        found: dict[str, Any] = {"kind": "microscope", "fitted": self._fitted}
        found |= {name: value for name, value in self.values().items() if self._needs(name)}
        if found["model"] == "pupil":
            found["zernike"] = self._zernike
        given = {name: value for name, value in found.items() if value is not None}
        settings: MicroscopeOptics = optics_from_values(given)
        return settings

    def show_settings(self, settings: MicroscopeOptics) -> None:
        """Show settings, without a signal."""
        blocked = self.blockSignals(True)
        self._fitted, self._zernike = settings.fitted, settings.zernike
        self.show_values(settings)
        self.blockSignals(blocked)
        self._show_rows()

    # ----------------------------------------------------------------------------------- inside

    def _needs(self, name: str) -> bool:
        modality, model = self.modality.currentText(), self.model.currentText()
        if name in ("excitation", "pinhole"):
            return bool(modality in _LIT)
        if name == "sheet":
            return bool(modality == "light sheet")
        if name == "sample_index":
            return bool(model in _LAYERED)
        if name == "depth":
            return model in _LAYERED and self.numbers["sample_index"].value() > 0
        return True

    def _show_rows(self) -> None:
        for name in self.fields:
            self.show_row(name, self._needs(name))
