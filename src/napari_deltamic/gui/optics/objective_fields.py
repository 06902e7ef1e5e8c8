"""The numbers on an objective, of which only those are shown that the modality needs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args

from qtpy.QtWidgets import QComboBox, QFormLayout, QWidget

from ...common.choices import IMMERSIONS, Modality, PSFModel
from ...runs.optics_settings import MicroscopeOptics, optics_from_values
from ..panels.fields import Number, show_row
from ..panels.note import Note
from ..qt import Signal

_LIT = ("confocal", "spinning disk")
_LAYERED = ("vectorial", "gibson-lanni")
_AS_IMMERSION = "as the immersion"
_AUTOMATIC = "automatic"
# Field -> title, start, step, what it says at 0 ('' where 0 is a number like others).
_NUMBERS = {
    "na": ("NA", 1.2, 0.05, ""),
    "wavelength": ("emission, um", 0.52, 0.01, ""),
    "excitation": ("excitation, um", 0.0, 0.01, _AUTOMATIC),
    "pinhole": ("pinhole, Airy units", 1.0, 0.1, ""),
    "sheet": ("sheet FWHM, um", 2.0, 0.1, ""),
    "sample_index": ("sample index", 0.0, 0.005, _AS_IMMERSION),
    "depth": ("depth, um", 0.0, 1.0, ""),
}
_ORDER = (
    "modality",
    "na",
    "immersion",
    "wavelength",
    "excitation",
    "pinhole",
    "sheet",
    "model",
    "sample_index",
    "depth",
)
# What an error names -> the field that it belongs to.
_NAMED = {"NA": "na", "index": "immersion", "light sheet": "sheet"}


class ObjectiveFields(QWidget):
    """Fields of :class:`MicroscopeOptics`; ``edited`` comes from the user."""

    edited = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.modality, self.model = QComboBox(self), QComboBox(self)
        self.modality.addItems(get_args(Modality))
        self.model.addItems(get_args(PSFModel))
        self.model.setCurrentText("vectorial")
        self.immersion = QComboBox(self)
        self.immersion.setEditable(True)
        self.immersion.addItems(tuple(IMMERSIONS))
        self.immersion.setCurrentText("water")
        self.numbers = {name: self._number(*row[1:]) for name, row in _NUMBERS.items()}
        self._fitted: tuple[str, ...] | None = None
        self._zernike: dict[int, float] | None = None
        self.note = Note(self, wrong=True)
        self.fields: dict[str, QWidget] = {
            "modality": self.modality,
            "immersion": self.immersion,
            "model": self.model,
            **self.numbers,
        }
        self._errors = {name: Note(self, wrong=True) for name in _ORDER}
        self.form = QFormLayout(self)
        self.form.setContentsMargins(0, 0, 0, 0)
        for name in _ORDER:
            title = _NUMBERS[name][0] if name in _NUMBERS else name
            self.form.addRow(title, self.fields[name])
            self.form.addRow(self._errors[name])
            self.fields[name].setToolTip(_tip(name))
        self.form.addRow(self.note)
        for box in (self.modality, self.model, self.immersion):
            # Names of modalities must not widen a narrow dock.
            box.setMinimumContentsLength(8)
            box.setSizeAdjustPolicy(
                QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon
            )
            box.currentTextChanged.connect(self._changed)
        for number in self.numbers.values():
            number.valueChanged.connect(self._changed)
        self._show_rows()

    def values(self) -> dict[str, Any]:
        """Plain values of the fields that are shown."""
        found: dict[str, Any] = {
            "kind": "microscope",
            "modality": self.modality.currentText(),
            "model": self.model.currentText(),
            "immersion": _immersion(self.immersion.currentText()),
        }
        for name, box in self.numbers.items():
            if self._needs(name) and (box.value() or not box.specialValueText()):
                found[name] = box.value()
        if self._fitted is not None:
            found["fitted"] = self._fitted
        if self._zernike and found["model"] == "pupil":
            found["zernike"] = self._zernike
        return found

    def settings(self) -> MicroscopeOptics:
        """The settings shown. InputError where one is missing."""
        settings: MicroscopeOptics = optics_from_values(self.values())
        return settings

    def show_settings(self, settings: MicroscopeOptics) -> None:
        """Show settings, without a signal."""
        blocked = self.blockSignals(True)
        self._fitted, self._zernike = settings.fitted, settings.zernike
        self.modality.setCurrentText(settings.modality)
        self.model.setCurrentText(settings.model)
        self.immersion.setCurrentText(str(settings.immersion))
        for name, box in self.numbers.items():
            value = getattr(settings, name)
            if value is not None:
                box.setValue(float(value))
            elif box.specialValueText():
                box.setValue(0.0)
        self.blockSignals(blocked)

    def complain(self, message: str) -> None:
        """Show an error under the field that it names, else under all; '' for none."""
        at = _field_named(message)
        for name, error in self._errors.items():
            error.say(message if name == at else "")
        self.note.say("" if at else message)

    def errors(self) -> Iterator[str]:
        """What is shown of errors."""
        return (n.text() for n in (*self._errors.values(), self.note) if n.text())

    # ----------------------------------------------------------------------------------- inside

    def _number(self, start: float, step: float, at_zero: str) -> Number:
        box = Number(self)
        box.setSingleStep(step)
        box.setSpecialValueText(at_zero)
        box.setValue(start)
        return box

    def _needs(self, name: str) -> bool:
        modality, model = self.modality.currentText(), self.model.currentText()
        if name in ("excitation", "pinhole"):
            return modality in _LIT
        if name == "sheet":
            return modality == "light sheet"
        if name == "sample_index":
            return model in _LAYERED
        if name == "depth":
            return model in _LAYERED and self.numbers["sample_index"].value() > 0
        return True

    def _show_rows(self) -> None:
        for name, field in self.fields.items():
            show_row(self.form, field, self._needs(name))

    def _changed(self, value: Any = None) -> None:
        self._show_rows()
        self.edited.emit()


def _immersion(text: str) -> str | float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return text.strip().lower()


def _tip(name: str) -> str:
    text = str(MicroscopeOptics.model_fields[name].description)
    return f"<qt>{text[0].upper()}{text[1:]}.</qt>"


def _field_named(message: str) -> str:
    """The field whose name an error begins with; '' for none."""
    plain = message.removeprefix("optics.").removeprefix("optics: ").removeprefix("the ")
    known = {**{name: name for name in _ORDER}, **_NAMED}
    for said, name in known.items():
        if plain.startswith((f"{said} ", f"{said}:", f"unknown {said} ")):
            return name
    if "light sheet" in plain:
        return "sheet"
    return ""
