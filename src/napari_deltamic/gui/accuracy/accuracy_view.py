"""Under the dial: the button that measures what accuracy costs on this scene, and its chart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from qtpy.QtWidgets import QHBoxLayout, QPushButton, QVBoxLayout, QWidget

from ...accuracy.accuracy_chart import short, ways_chart
from ...accuracy.chart import Chart
from ...accuracy.tradeoff import Way, duration, with_front
from ..qt import Signal
from ..widgets import Note
from .accuracy_plot import TradeoffPlot

_START, _STOP = "Measure on this scene", "Stop measuring"
_TIP = (
    "<qt>Renders this scene in every way there is and times each: what accuracy costs here. Takes "
    "about a minute in the background, and as much of the processor as a fit. The chart shows time "
    "against error; the points as planned can be clicked, which sets the dial.</qt>"
)
_NOT_NOW = "no measuring while a fit runs: both would need the same processor"


class TradeoffView(QWidget):
    """Button, progress and chart; signals for what the user asks for."""

    start = Signal()
    stop = Signal()
    chosen = Signal(float)  # an accuracy

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._measuring = False
        self._accuracy: float | None = None
        self.ways: list[Way] = []
        self.button = QPushButton(_START, self)
        self.hide_button = QPushButton("Hide", self)
        self.hide_button.setToolTip("Hide the chart.")
        self.reason, self.progress = Note(self), Note(self)
        self.plot = TradeoffPlot(self._description, self)
        self.summary = Note(self)
        buttons = QHBoxLayout()
        buttons.setContentsMargins(0, 0, 0, 0)
        buttons.addWidget(self.button, 1)
        buttons.addWidget(self.hide_button)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addLayout(buttons)
        for widget in (self.reason, self.progress, self.plot, self.summary):
            layout.addWidget(widget)
        self.button.clicked.connect(self._pressed)
        self.hide_button.clicked.connect(self.clear)
        self.plot.clicked.connect(self._clicked)
        self.allow(True)
        self.clear()

    def allow(self, allowed: bool) -> None:
        """Whether measuring can be started; says why not."""
        self.button.setEnabled(allowed)
        self.button.setToolTip(_TIP if allowed else f"<qt>{_NOT_NOW.capitalize()}.</qt>")
        self.reason.say("" if allowed else _NOT_NOW)

    def set_measuring(self, measuring: bool) -> None:
        """Whether the button starts or stops."""
        self._measuring = measuring
        self.button.setText(_STOP if measuring else _START)

    def show_ways(self, ways: Sequence[Way]) -> None:
        """Draw what was measured so far."""
        self.ways = with_front(ways)
        shown = any(way.measured and way.error for way in self.ways)
        self._show_accuracy()
        for widget in (self.plot, self.hide_button):
            widget.setVisible(shown)

    def show_accuracy(self, accuracy: float | None) -> None:
        """Mark the accuracy that the dial stands for; None where that is not known."""
        self._accuracy = accuracy
        self._show_accuracy()

    def clear(self) -> None:
        """Show no chart."""
        self.ways = []
        self.summary.say("")
        for widget in (self.plot, self.hide_button):
            widget.hide()

    def _show_accuracy(self) -> None:
        accuracy = self._accuracy
        self.plot.show_level(accuracy or None, f"asked: {short(accuracy)}" if accuracy else "")
        if not self.ways:
            return
        self.ways = [replace(way, in_use=_is(way, accuracy)) for way in self.ways]
        if any(way.measured and way.error for way in self.ways):
            self.plot.show_chart(_chart(self.ways))
        used = next((way for way in self.ways if way.in_use), None)
        self.summary.say(_summary(used, accuracy))

    def _pressed(self) -> None:
        (self.stop if self._measuring else self.start).emit()

    def _clicked(self, x: float, y: float) -> None:
        way = self._way(x, y)
        if way is not None and way.accuracy:
            self.chosen.emit(way.accuracy)

    def _way(self, x: float, y: float) -> Way | None:
        found = [w for w in self.ways if w.gradient == x and w.error == y]
        # As planned before others: those can be chosen.
        return max(found, key=lambda w: bool(w.accuracy), default=None)

    def _description(self, x: float, y: float) -> str:
        way = self._way(x, y)
        if way is None:
            return ""
        text = f"{way.name}: {duration(x)}, error {_two_digits(y)}"
        return f"{text}. Click to ask for {short(way.accuracy)}." if way.accuracy else text


def _is(way: Way, accuracy: float | None) -> bool:
    """Whether a way is what an accuracy asks for."""
    if accuracy == 0:
        return way.method == "closed form" and way.band == 0 and way.precision == "float64"
    return way.accuracy is not None and way.accuracy == accuracy


def _summary(used: Way | None, accuracy: float | None) -> str:
    if used is None:
        return "" if accuracy is None else f"accuracy {short(accuracy)} was not measured"
    if used.gradient is None:
        return f"in use: {short(accuracy or 0)}, {used.note}"
    error = "" if used.reference or used.error is None else f", error {_two_digits(used.error)}"
    return f"ringed: in use; {duration(used.gradient)} an image{error}"


def _two_digits(error: float) -> str:
    return short(float(f"{error:.1e}"))


def _chart(ways: Sequence[Way]) -> Chart:
    return replace(ways_chart(ways, ""), y_text=short)
