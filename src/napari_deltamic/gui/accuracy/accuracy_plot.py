"""A chart with two logarithmic axes, drawn in the colours of the theme and for a narrow dock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import hypot

from qtpy.QtCore import QEvent, QPointF, QRectF, Qt
from qtpy.QtGui import (
    QColor,
    QFontMetrics,
    QHelpEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPalette,
    QPen,
    QPolygonF,
)
from qtpy.QtWidgets import QSizePolicy, QToolTip, QWidget

from ...accuracy.chart import PALETTE, Chart, LogAxis, Series
from ..qt import Signal

_PLOT = 190  # px, with its axes
_RADIUS = 3.5  # px of a marker
_NEAR = 9.0  # px around a point that belong to it
_GAP = 6  # px between two labels, at least
_CORNERS = {
    "square": ((-1, -1), (1, -1), (1, 1), (-1, 1)),
    "triangle": ((0, -1.3), (1.2, 1), (-1.2, 1)),
    "diamond": ((0, -1.3), (1.3, 0), (0, 1.3), (-1.3, 0)),
}


class TradeoffPlot(QWidget):
    """Points that can be pointed at and clicked: ``clicked`` brings x and y of one."""

    clicked = Signal(float, float)

    def __init__(
        self, describe: Callable[[float, float], str], parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        self._describe = describe  # what to say of a point
        self._chart: Chart | None = None
        self._level: float | None = None
        self._level_text = ""
        self.setMinimumWidth(120)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self._fit_height()

    @property
    def chart(self) -> Chart | None:
        """What is shown."""
        return self._chart

    def show_chart(self, chart: Chart) -> None:
        """Draw a chart."""
        self._chart = chart
        self._fit_height()
        self.update()

    def show_level(self, y: float | None, text: str = "") -> None:
        """Draw a dashed line across the chart; None for none."""
        self._level, self._level_text = y, text
        self.update()

    def place(self, x: float, y: float) -> QPointF | None:
        """Where a point is drawn, px; None without a chart."""
        axes = self._axes()
        return None if axes is None else QPointF(axes[0](x), axes[1](y))

    # ------------------------------------------------------------------------------- drawing

    def paintEvent(self, event: QPaintEvent | None) -> None:
        """Draw (called by Qt)."""
        axes, chart = self._axes(), self._chart
        if axes is None or chart is None:
            return
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        ink = self.palette().color(QPalette.ColorRole.WindowText)
        self._grid(painter, *axes, ink)
        for series in chart.series:
            self._series(painter, *axes, series)
        if self._level is not None:
            self._dashed(painter, *axes, ink)
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.setPen(QPen(ink, 1.6))
        for note in chart.notes:
            painter.drawEllipse(QPointF(axes[0](note.x), axes[1](note.y)), 7.0, 7.0)
        self._legend(painter, ink)
        painter.end()

    def _grid(self, painter: QPainter, x: LogAxis, y: LogAxis, ink: QColor) -> None:
        assert self._chart is not None
        box, metrics = self._box(), painter.fontMetrics()
        faint, middle = QColor(ink), QColor(ink)
        faint.setAlpha(45)
        middle.setAlpha(170)
        painter.setPen(QPen(faint, 1))
        ticks = x.ticks()[0], y.ticks()[0]
        for value in ticks[0]:
            painter.drawLine(QPointF(x(value), box.top()), QPointF(x(value), box.bottom()))
        for value in ticks[1]:
            painter.drawLine(QPointF(box.left(), y(value)), QPointF(box.right(), y(value)))
        painter.drawRect(box)
        painter.setPen(middle)
        end = -1.0
        for value in ticks[0]:
            text = self._chart.x_text(value)
            width = metrics.horizontalAdvance(text)
            left = min(x(value) - width / 2, self.width() - width)
            if left > end:  # those that would overlap are left out
                painter.drawText(QPointF(left, box.bottom() + metrics.ascent() + 2), text)
                end = left + width + _GAP
        end = float(self.height())
        for value in ticks[1]:
            text = self._chart.y_text(value)
            base = y(value) + metrics.ascent() / 2 - 1
            if base < end:
                width = metrics.horizontalAdvance(text)
                painter.drawText(QPointF(box.left() - width - 4, base), text)
                end = base - metrics.height()
        painter.setPen(ink)
        painter.drawText(QPointF(2, metrics.ascent()), self._chart.y_label)
        width = metrics.horizontalAdvance(self._chart.x_label)
        below = box.bottom() + 2 * metrics.height()
        painter.drawText(QPointF(max(box.right() - width, 2), below), self._chart.x_label)

    def _series(self, painter: QPainter, x: LogAxis, y: LogAxis, series: Series) -> None:
        colour = self._colour(series)
        places = [QPointF(x(a), y(b)) for a, b in zip(series.x, series.y, strict=True)]
        if series.line:
            painter.setPen(QPen(colour, 1.6))
            painter.drawPolyline(QPolygonF(places))
        if series.marker is not None:
            for at in places:
                self._marker(painter, series, at, colour)

    def _marker(self, painter: QPainter, series: Series, at: QPointF, colour: QColor) -> None:
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(colour)
        corners = _CORNERS.get(series.marker or "")
        if corners is None:
            painter.drawEllipse(at, _RADIUS, _RADIUS)
        else:
            painter.drawPolygon(QPolygonF([at + _RADIUS * QPointF(a, b) for a, b in corners]))

    def _dashed(self, painter: QPainter, x: LogAxis, y: LogAxis, ink: QColor) -> None:
        assert self._level is not None
        box, at = self._box(), y(self._level)
        if box.top() <= at <= box.bottom():
            painter.setPen(QPen(ink, 1, Qt.PenStyle.DashLine))
            painter.drawLine(QPointF(box.left(), at), QPointF(box.right(), at))
            width = painter.fontMetrics().horizontalAdvance(self._level_text)
            painter.drawText(QPointF(box.right() - width - 3, at - 3), self._level_text)

    def _legend(self, painter: QPainter, ink: QColor) -> None:
        metrics = painter.fontMetrics()
        y = float(_PLOT) + metrics.ascent()
        for series in self._named():
            colour, middle = self._colour(series), y - metrics.ascent() / 2 + 1
            if series.line:
                painter.setPen(QPen(colour, 1.6))
                painter.drawLine(QPointF(4, middle), QPointF(18, middle))
            if series.marker is not None:
                self._marker(painter, series, QPointF(11, middle), colour)
            painter.setPen(ink)
            painter.drawText(QPointF(24, y), series.name)
            y += metrics.height()

    # ------------------------------------------------------------------------------ pointing

    def event(self, event: QEvent | None) -> bool:
        """Qt's; what a point is, where the mouse rests."""
        if isinstance(event, QHelpEvent):
            point = self._nearest(QPointF(event.pos()))
            if point is not None:
                QToolTip.showText(event.globalPos(), f"<qt>{self._describe(*point)}</qt>", self)
                return True
            QToolTip.hideText()
        return bool(super().event(event))

    def mouseReleaseEvent(self, event: QMouseEvent | None) -> None:
        """Qt's."""
        if event is not None and event.button() == Qt.MouseButton.LeftButton:
            point = self._nearest(event.position())
            if point is not None:
                self.clicked.emit(*point)

    def _nearest(self, at: QPointF) -> tuple[float, float] | None:
        """x and y of the point next to a place, if one is near; what was drawn last wins."""
        best, found = _NEAR, None
        for series in self._chart.series if self._chart is not None else ():
            for x, y in zip(series.x, series.y, strict=True):
                place = self.place(x, y)
                if place is not None and series.marker is not None:
                    away = hypot(place.x() - at.x(), place.y() - at.y())
                    if away <= best:
                        best, found = away, (x, y)
        return found

    # -------------------------------------------------------------------------------- layout

    def _named(self) -> Sequence[Series]:
        return [s for s in self._chart.series if s.name] if self._chart is not None else []

    def _fit_height(self) -> None:
        self.setFixedHeight(_PLOT + len(self._named()) * self.fontMetrics().height() + 6)

    def _box(self) -> QRectF:
        metrics: QFontMetrics = self.fontMetrics()
        left = metrics.horizontalAdvance("1e-10") + 6.0
        top, bottom = metrics.height() + 6.0, _PLOT - 2 * metrics.height() - 8.0
        return QRectF(left, top, max(self.width() - left - 6.0, 20.0), bottom - top)

    def _axes(self) -> tuple[LogAxis, LogAxis] | None:
        if self._chart is None:
            return None
        xs = [x for s in self._chart.series for x in s.x]
        ys = [y for s in self._chart.series for y in s.y]
        box = self._box()
        return (
            LogAxis(xs, box.left(), box.right()),
            LogAxis(ys, box.bottom(), box.top()),
        )

    def _colour(self, series: Series) -> QColor:
        colour = QColor(*PALETTE[series.colour % len(PALETTE)])
        # Dark blues and reds are hard to see on a dark theme.
        dark = self.palette().color(QPalette.ColorRole.Window).lightness() < 128
        return colour.lighter(150) if dark else colour
