"""Small plots that are drawn as the fit goes on, in the colours of the theme."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

from qtpy.QtCore import QPointF, QRectF
from qtpy.QtGui import QColor, QPainter, QPaintEvent, QPalette, QPen, QPolygonF
from qtpy.QtWidgets import QSizePolicy, QWidget

_MOST = 400  # points drawn of a line
_TEXT = 18  # px above the plot


@dataclass
class Line:
    """One line of a plot: its colour, what is written in that colour, and its points."""

    colour: str
    text: str
    x: Sequence[float]
    y: Sequence[float]


class Plot(QWidget):
    """Lines over iterations, and a vertical mark wherever something began."""

    def __init__(self, title: str, tooltip: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._title = title
        self._lines: list[Line] = []
        self._marks: list[float] = []
        self._now: float | None = None
        self.setMinimumSize(80, 84)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setToolTip(f"<qt>{tooltip}</qt>")

    def show_lines(self, lines: Sequence[Line], marks: Sequence[float] = ()) -> None:
        """Show lines; what is not finite is left out."""
        self._lines, self._marks = [_thinned(line) for line in lines], list(marks)
        self.update()

    def show_moment(self, x: float | None) -> None:
        """Point at a moment; None at none."""
        self._now = x
        self.update()

    def paintEvent(self, event: QPaintEvent | None) -> None:
        """Draw (called by Qt)."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        text = self.palette().color(QPalette.ColorRole.WindowText)
        faint = QColor(text)
        faint.setAlpha(70)
        area = QRectF(self.rect()).adjusted(4, _TEXT, -4, -4)
        painter.setPen(QPen(faint, 1))
        painter.drawRect(area)
        self._write(painter, text)
        drawn = [line for line in self._lines if len(line.x)]
        if any(len(line.x) > 1 for line in drawn):
            self._draw(painter, area, faint, text, drawn)
        painter.end()

    def _write(self, painter: QPainter, colour: QColor) -> None:
        x = 4.0
        # The title and, of a single line, its text are in the colour of all texts.
        words = [(self._title, colour)]
        several = len({line.colour for line in self._lines}) > 1
        named = [line for line in self._lines if line.text]
        words += [(line.text, QColor(line.colour) if several else colour) for line in named]
        for word, own in words:
            painter.setPen(own)
            painter.drawText(QPointF(x, _TEXT - 5.0), word)
            x += painter.fontMetrics().horizontalAdvance(word + " ") + 2

    def _draw(
        self, painter: QPainter, area: QRectF, faint: QColor, text: QColor, lines: Sequence[Line]
    ) -> None:
        xs = [x for line in lines for x in (line.x[0], line.x[-1])]
        ys = [y for line in lines for y in line.y]
        left, low = min(xs), min(ys)
        across = area.width() / ((max(xs) - left) or 1.0)
        # A line that hardly changes should look as if it hardly changed.
        spread = max(max(ys) - low, 0.02 * abs(low), 1e-12)
        up = 0.9 * area.height() / spread

        def place(x: float, y: float) -> QPointF:
            return QPointF(
                area.left() + (x - left) * across,
                area.bottom() - 0.05 * area.height() - (y - low) * up,
            )

        painter.setPen(QPen(faint, 1))
        for mark in self._marks:
            at = place(mark, low).x()
            painter.drawLine(QPointF(at, area.top()), QPointF(at, area.bottom()))
        for line in lines:
            painter.setPen(QPen(QColor(line.colour), 1.6))
            points = [place(x, y) for x, y in zip(line.x, line.y, strict=True)]
            painter.drawPolyline(QPolygonF(points))
        if self._now is not None:
            painter.setPen(QPen(text, 1))
            at = min(max(place(self._now, low).x(), area.left()), area.right())
            painter.drawLine(QPointF(at, area.top()), QPointF(at, area.bottom()))


def spread(n: int) -> list[int]:
    """Indices of as many points as are worth drawing, the first and the last among them."""
    chosen = [*range(0, n, max(1, n // _MOST))]
    return chosen if not n or chosen[-1] == n - 1 else [*chosen, n - 1]


def _thinned(line: Line) -> Line:
    kept = [k for k in spread(min(len(line.x), len(line.y))) if isfinite(line.y[k])]
    return Line(line.colour, line.text, [line.x[k] for k in kept], [line.y[k] for k in kept])
