"""Small widgets that several panels use: choosers of layers, notes, folds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from qtpy.QtCore import QSignalBlocker, Qt
from qtpy.QtGui import QResizeEvent
from qtpy.QtWidgets import (
    QComboBox,
    QFormLayout,
    QLabel,
    QSizePolicy,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from .connections import Connections
from .qt import Signal
from .viewing.frame import made_by_fit

_ARROW = 30  # px of the button of a fold that are not for its text


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


class Note(QLabel):
    """A small line, wrapped, that is hidden while it is empty.

    Parameters
    ----------
    wrong : whether what it says is that something cannot be used.
    """

    def __init__(self, parent: QWidget | None = None, *, wrong: bool = False) -> None:
        super().__init__(parent)
        self.setWordWrap(True)
        self.setStyleSheet("font-size: 11px;" + " color: #e0564f;" * wrong)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Minimum)
        self.hide()

    def say(self, text: str) -> None:
        """Show a text, or nothing."""
        if text != self.text():
            self.setText(text)
            self.setVisible(bool(text))


class Fold(QWidget):
    """A title with an arrow; a click on it shows the content, or hides it again.

    A title that is longer than the panel is wide is cut; its tooltip has all of it.
    """

    def __init__(self, title: str, content: QWidget, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.title = ""
        self.button = QToolButton(self)
        self.button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.button.setCheckable(True)
        # The text must not widen a narrow dock.
        self.button.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        # napari's style would draw it as one of its square icons.
        self.button.setStyleSheet(
            "QToolButton { border: none; background: transparent; padding: 2px; }"
        )
        self.content = content
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(4)
        layout.addWidget(self.button)
        layout.addWidget(content)
        self.button.toggled.connect(self.unfold)
        self.set_title(title)
        self.unfold(False)

    def set_title(self, title: str) -> None:
        """Show another title."""
        self.title = title
        self._cut()

    def unfold(self, shown: bool = True) -> None:
        """Show the content, or hide it."""
        self.button.setChecked(shown)
        arrow = Qt.ArrowType.DownArrow if shown else Qt.ArrowType.RightArrow
        self.button.setArrowType(arrow)
        self.content.setVisible(shown)

    def resizeEvent(self, event: QResizeEvent | None) -> None:
        """Qt's."""
        super().resizeEvent(event)
        self._cut()

    def _cut(self) -> None:
        room = self.width() - _ARROW
        metrics = self.button.fontMetrics()
        text = metrics.elidedText(self.title, Qt.TextElideMode.ElideRight, room)
        self.button.setText(text)
        self.button.setToolTip(self.title if text != self.title else "")
