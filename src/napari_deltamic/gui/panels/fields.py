"""Small inputs that several panels use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from qtpy.QtCore import QSignalBlocker
from qtpy.QtWidgets import (
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QSizePolicy,
    QWidget,
)

from ..connections import Connections
from ..qt import Signal
from ..viewing.frame import made_by_fit

Triple = tuple[float, float, float]


class TripleField(QWidget):
    """Three positive numbers (um), Z, Y, X; ``edited`` comes only from the user."""

    edited = Signal()

    def __init__(self, tooltip: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        layout = QHBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(3)
        self._boxes: list[QDoubleSpinBox] = []
        for name in "ZYX":
            box = QDoubleSpinBox(self)
            box.setDecimals(4)
            box.setRange(0.0001, 10000)
            box.setSingleStep(0.01)
            box.setPrefix(f"{name} ")
            box.setToolTip(tooltip)
            box.setKeyboardTracking(False)
            # napari's style asks for 90 pixels, with which the dock could not be narrow.
            # Without NoButtons, which in Qt 6.12 and that style leaves no room for the number.
            box.setStyleSheet(
                "QDoubleSpinBox { min-width: 50px; padding: 1px 2px; } "
                "QDoubleSpinBox::up-button, QDoubleSpinBox::down-button { width: 0; border: none; }"
            )
            box.valueChanged.connect(self._emit)
            layout.addWidget(box)
            self._boxes.append(box)

    def value(self) -> Triple:
        """The numbers."""
        z, y, x = (float(box.value()) for box in self._boxes)
        return z, y, x

    def set_value(self, values: Sequence[float]) -> None:
        """Show numbers, without a signal."""
        for box, value in zip(self._boxes, values, strict=True):
            blocker = QSignalBlocker(box)
            box.setValue(float(value))
            blocker.unblock()

    def _emit(self, value: float) -> None:
        self.edited.emit()


class Number(QDoubleSpinBox):
    """A number that is 0 or more, without zeros at its end.

    It is wide open: a value in another unit is to be named, not cut.
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setRange(0, 100_000)
        self.setDecimals(4)
        self.setKeyboardTracking(False)
        self.setStyleSheet("QDoubleSpinBox { min-width: 60px; }")

    def textFromValue(self, value: float) -> str:
        """Qt's."""
        text = super().textFromValue(value)
        point = self.locale().decimalPoint()
        return text.rstrip("0").rstrip(point) if point in text else text


class LayerChooser(QComboBox):
    """The layers of a viewer that can be used for something; ``chosen`` says that it is another.

    Parameters
    ----------
    viewer : a napari viewer or its model.
    accepts : whether a layer can be used.
    nothing : the first entry, for no layer; then none is chosen but by the user. '' for no such.
    """

    chosen = Signal()

    def __init__(
        self,
        viewer: Any,
        accepts: Callable[[Any], bool],
        parent: QWidget | None = None,
        *,
        nothing: str = "",
    ) -> None:
        super().__init__(parent)
        self._viewer, self._accepts, self._nothing = viewer, accepts, nothing
        self._layers: list[Any] = []
        self._last: Any = None
        # Long layer names must not widen a narrow dock.
        self.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.setMinimumContentsLength(12)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.connections = Connections()
        events = viewer.layers.events
        for emitter in (events.inserted, events.removed, events.reordered, events.renamed):
            # After the viewer itself, which shows a layer that is new.
            self.connections.connect(emitter, self.refresh, position="last")
        self.currentIndexChanged.connect(self._told)
        self.refresh()

    def layer(self) -> Any:
        """The layer chosen, or None."""
        index = self.currentIndex()
        return self._layers[index] if 0 <= index < len(self._layers) else None

    def choose(self, layer: Any) -> None:
        """Choose a layer."""
        if layer in self._layers:
            self.setCurrentIndex(self._layers.index(layer))

    def refresh(self, event: Any = None) -> None:
        """Look at the viewer's layers again; the choice stays where it can."""
        before = self.layer()
        blocker = QSignalBlocker(self)
        self._layers = [layer for layer in self._viewer.layers if self._accepts(layer)]
        names = [layer.name for layer in self._layers]
        if self._nothing:
            self._layers, names = [None, *self._layers], [self._nothing, *names]
        self.clear()
        self.addItems(names)
        if before in self._layers:
            self.setCurrentIndex(self._layers.index(before))
        elif self._nothing:
            self.setCurrentIndex(0)
        else:
            # The layers that a fit adds are only used where someone chooses them.
            others = [k for k, layer in enumerate(self._layers) if not made_by_fit(layer)]
            self.setCurrentIndex(others[-1] if others else -1)
        blocker.unblock()
        self._told()

    def close_links(self) -> None:
        """Listen to the viewer no more, and let its layers go."""
        self.connections.undo()
        self._layers = []
        self._last = None

    def _told(self, index: int = 0) -> None:
        if self.layer() is not self._last:
            self._last = self.layer()
            self.chosen.emit()


def sentence(text: str) -> str:
    """A reason as a sentence."""
    return f"{text[0].upper()}{text[1:]}." if text else ""


def note_label(text: str = "") -> QLabel:
    """A line of explanation under a field."""
    label = QLabel(text)
    label.setWordWrap(True)
    label.setStyleSheet("font-size: 11px;")
    label.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Minimum)
    return label


def show_row(form: QFormLayout, field: QWidget, shown: bool) -> None:
    """Show a row of a form, or hide it with its title."""
    title = form.labelForField(field)
    for part in (field, title):
        if part is not None:
            part.setVisible(shown)
