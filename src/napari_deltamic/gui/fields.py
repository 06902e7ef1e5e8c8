"""Inputs, and forms that are made of what settings say of themselves."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from functools import partial
from typing import Any

from qtpy.QtGui import QValidator
from qtpy.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QLineEdit,
    QToolTip,
    QWidget,
)
from superqt.utils import signals_blocked

from ..common.description import Described, described
from ..common.triple import Triple, triple
from .widgets import Signal, be_narrow, row
from .window_words import as_tip, for_window
from .work import one_shot

_MOST = 1_000_000  # of a whole number without a limit
_WRITTEN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)
_CUT = 0.01  # of a number, that it may lose as the field shows no more decimals


class TripleField(QWidget):
    """Three positive numbers (µm), Z, Y, X; ``edited`` brings them, and only from the user."""

    edited = Signal(tuple)
    refused = Signal(str)  # see ``Number``

    def __init__(self, tooltip: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._boxes: list[Number] = []
        for name in "ZYX":
            box = Number(self)
            # Wider, napari's sliders could be asked for more steps than it can count.
            box.setRange(0.001, 1000)
            box.setSingleStep(0.01)
            box.setPrefix(f"{name} ")
            box.setToolTip(as_tip(tooltip))
            box.setAccessibleName(f"{name}, µm")
            # napari's style asks for 90 pixels, with which the dock could not be narrow.
            # Without NoButtons, which in Qt 6.12 and that style leaves no room for the number.
            box.setStyleSheet(
                "QDoubleSpinBox { min-width: 50px; padding: 1px 2px; } "
                "QDoubleSpinBox::up-button, QDoubleSpinBox::down-button { width: 0; border: none; }"
                "QDoubleSpinBox::up-arrow, QDoubleSpinBox::down-arrow { image: none; width: 0; }"
            )
            box.valueChanged.connect(self._emit)
            box.refused.connect(self.refused)
            self._boxes.append(box)
        row(*self._boxes, of=self, spacing=3)

    def value(self) -> Triple:
        return triple(box.value() for box in self._boxes)

    def set_value(self, values: Sequence[float]) -> None:
        """Show numbers, without a signal."""
        for box, value in zip(self._boxes, values, strict=True):
            with signals_blocked(box):
                box.setValue(float(value))

    def _emit(self, value: float) -> None:
        self.edited.emit(self.value())


class Number(QDoubleSpinBox):
    """A spin box for numbers from 0 (unless signed), without trailing zeros; takes decimal commas.

    Typed text is taken as a whole, or refused with a message: Qt would swallow each key that suits
    no number, so that 0,26 would become 26, and 290 nm 290. The range is wide open: a value in
    another unit is to be named, not cut.

    whole : whether only whole numbers are taken.
    """

    refused = Signal(str)  # why what was typed was not taken; '' as soon as more is typed

    def __init__(
        self, parent: QWidget | None = None, *, signed: bool = False, whole: bool = False
    ) -> None:
        super().__init__(parent)
        self.whole = whole
        self._why = ""
        self._soon = one_shot(self, self._show_why)
        self.setRange(-100_000 if signed else 0, 100_000)
        self.setDecimals(0 if whole else 4)
        self.setKeyboardTracking(False)
        self.setStyleSheet("QDoubleSpinBox { min-width: 60px; }")
        line: Any = self.lineEdit()
        line.textEdited.connect(self._retyped)

    def textFromValue(self, value: float) -> str:
        text = super().textFromValue(value)
        point = self.locale().decimalPoint()
        return text.rstrip("0").rstrip(point) if point in text else text

    def validate(self, text: str | None, place: int) -> Any:
        """Called by Qt, also for each key; no text is rejected while typing."""
        known = QValidator.State.Acceptable
        return (QValidator.State.Intermediate if self._trouble(text) else known), text, place

    def fixup(self, text: str | None) -> str:
        """Called by Qt when a text that is not a valid number is entered: the old number stays."""
        if self._bare(text):
            self._why = f"{self._trouble(text)}: {self.textFromValue(self.value())} stays"
            self.refused.emit(self._why)
            self._soon.start()  # not before Qt has hidden what is shown now
        return text or ""

    def valueFromText(self, text: str | None) -> float:
        """The number in a text; called by Qt."""
        bare = self._bare(text)
        if bare and bare == self.specialValueText():
            return self.minimum()
        value = None if self._trouble(text) else self._read(bare)
        return self.value() if value is None else value

    def _retyped(self, text: str) -> None:
        if self._why:
            self._why = ""
            QToolTip.hideText()
            self.refused.emit("")

    def _trouble(self, text: str | None) -> str:
        """Why a text cannot be taken; '' if it can."""
        bare = self._bare(text)
        if bare and bare == self.specialValueText():
            return ""
        value = self._read(bare)
        if value is None:
            return f"'{bare}' is no {'whole number' if self.whole else 'number'}"
        low, high = self.minimum(), self.maximum()
        if not low <= value <= high:
            return f"{bare} is not between {low:.15g} and {high:.15g}"
        if abs(round(value, self.decimals()) - value) > _CUT * abs(value):
            return f"{bare} has more than {self.decimals()} decimals"
        return ""

    def _read(self, text: str) -> float | None:
        """A text as a number, if it is one that is taken here."""
        value = written(text)
        if self.whole and value is not None:
            grouped = any(mark in text for mark in ".,")  # 1,000 may mean a thousand, or one
            return None if grouped or value != int(value) else value
        return value

    def _bare(self, text: str | None) -> str:
        return (text or "").removeprefix(self.prefix()).removesuffix(self.suffix()).strip()

    def _show_why(self) -> None:
        corner = self.mapToGlobal(self.rect().bottomLeft())
        QToolTip.showText(corner, for_window(self._why), self)


class Form(QWidget):
    """A field for each setting of a settings object; ``edited`` comes from the user.

    Titles, tips, choices, bounds and defaults are those of the settings. A number that may be left
    open is open at 0. What was shown and is not edited stays as exact as it was.

    Parameters
    ----------
    model : a settings object.
    names : of the settings shown; None for all that are no parts.
    """

    edited = Signal()

    def __init__(
        self, model: type[Any], names: Collection[str] | None = None, parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        self.described = {
            name: found
            for name, found in described(model).items()
            if found.kind != "part" and (names is None or name in names)
        }
        self.form = QFormLayout(self)
        self.form.setContentsMargins(0, 0, 0, 0)
        self.fields: dict[str, Any] = {}
        self._exact: dict[str, Any] = {}  # what is shown, until it is edited
        for name, found in self.described.items():
            field, by_user = _field(found, self)
            field.setToolTip(as_tip(found.sentence))
            label = for_window(found.label)
            field.setAccessibleName(label)
            by_user.connect(partial(self._edited, name))
            self.fields[name] = field
            if found.kind == "switch":  # across both columns: a narrow dock has no room
                self.form.addRow(field)
            else:
                self.form.addRow(label, field)

    def values(self) -> dict[str, Any]:
        """What is shown, as plain values by name; their combination need not be valid."""
        return {name: self.value(name) for name in self.fields}

    def value(self, name: str) -> Any:
        return self._exact[name] if name in self._exact else _value(self.fields[name])

    def show_values(self, settings: Any) -> None:
        """Show a settings object; an open value leaves a field unchanged that cannot show one."""
        for name in self.fields:
            self.show_value(name, getattr(settings, name))

    def show_value(self, name: str, value: Any) -> None:
        _show(self.fields[name], value)
        if value is not None:
            self._exact[name] = value

    def _edited(self, name: str, value: Any = None) -> None:
        self._exact.pop(name, None)
        self.edited.emit()


def _field(found: Described, parent: QWidget) -> tuple[Any, Any]:
    """A field for a setting, and its signal that the user has edited it."""
    if found.kind == "switch":
        switch = QCheckBox(found.title, parent)
        switch.setChecked(bool(found.default))
        return switch, switch.toggled
    if found.kind == "whole":
        whole = Number(parent, whole=True)
        whole.setRange(int(found.low or 0), int(found.high or _MOST))
        return whole, whole.valueChanged
    if found.kind == "number":
        number = Number(parent, signed=(found.low or 0) < 0)
        number.setSingleStep(found.step or 0.1)
        if found.optional and found.start is None:
            number.setSpecialValueText(found.automatic)
        number.setValue(float(found.default or found.start or 0.0))
        return number, number.valueChanged
    if found.kind == "triple":
        triple = TripleField(found.sentence, parent)
        return triple, triple.edited
    if found.kind == "choice" or found.choices:
        box = QComboBox(parent)
        box.setEditable(found.kind == "text")
        for choice in found.choices:
            box.addItem(found.words.get(choice, choice), choice)
        _show(box, found.default)
        be_narrow(box, 8)
        return box, box.currentTextChanged
    line = QLineEdit(parent)
    line.setPlaceholderText(found.automatic)
    return line, line.editingFinished


def _value(field: Any) -> Any:
    if isinstance(field, QCheckBox):
        return field.isChecked()
    if isinstance(field, QComboBox):
        return number_or_text(field.currentText()) if field.isEditable() else field.currentData()
    if isinstance(field, QLineEdit):
        words = field.text().replace(",", " ").split()
        return [number_or_text(word) for word in words] or None
    value = field.value()
    if value == 0 and field.specialValueText():
        return None
    return int(value) if isinstance(field, Number) and field.whole else value


def _show(field: Any, value: Any) -> None:
    if isinstance(field, QCheckBox):
        field.setChecked(value)
    elif isinstance(field, QComboBox) and field.isEditable():
        field.setCurrentText(str(value))
    elif isinstance(field, QComboBox):
        field.setCurrentIndex(field.findData(str(value)))
    elif isinstance(field, QLineEdit):
        field.setText(" ".join(f"{part:g}" for part in value or ()))
    elif isinstance(field, TripleField):
        if value is not None:
            field.set_value(value)
    elif value is not None:
        field.setValue(value)
    elif field.specialValueText():
        field.setValue(0)


def written(text: str) -> float | None:
    """The number in a typed text, with a point or a comma; None for anything else."""
    plain = text.replace(",", ".").replace("\u2212", "-")
    return float(plain) if _WRITTEN.fullmatch(plain) else None


def number_or_text(text: str) -> str | float:
    """The number in a typed text, or else the text in lower case."""
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return text.strip().lower()
