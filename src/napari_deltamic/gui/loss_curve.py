"""The loss against the iterations, drawn as it comes."""

from __future__ import annotations

from collections.abc import Sequence
from math import log10

from qtpy.QtCore import QPointF, QRectF
from qtpy.QtGui import QColor, QPainter, QPaintEvent, QPalette, QPen, QPolygonF
from qtpy.QtWidgets import QSizePolicy, QWidget

_MOST = 400  # points drawn
_TEXT = 18  # px above the plot


class LossCurve(QWidget):
    """A small logarithmic plot; a vertical line where a new level begins."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._loss: list[float] = []
        self._level: list[int] = []
        self.setMinimumHeight(84)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setToolTip(
            "<qt>Loss (logarithmic): the weighted residual, as a share of the variance of the "
            "voxels that count. Lines show where the blur is reduced; there the loss starts anew."
            "</qt>"
        )

    def show_losses(self, loss: Sequence[float], level: Sequence[int]) -> None:
        """Show the course of a fit."""
        n = min(len(loss), len(level))
        every = max(1, n // _MOST)
        self._loss, self._level = list(loss[:n:every]), list(level[:n:every])
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
        values = [log10(max(v, 1e-12)) for v in self._loss]
        if len(values) < 2:
            painter.drawText(QPointF(area.left(), area.top() - 5), "loss")
            painter.end()
            return
        low, high = min(values), max(values)
        across, up = area.width() / (len(values) - 1), area.height() / (high - low or 1.0)
        points = [
            QPointF(area.left() + k * across, area.bottom() - (v - low) * up)
            for k, v in enumerate(values)
        ]
        for k in range(1, len(values)):
            if self._level[k] != self._level[k - 1]:
                x = points[k].x()
                painter.drawLine(QPointF(x, area.top()), QPointF(x, area.bottom()))
        painter.setPen(QPen(QColor(255, 176, 0), 1.6))
        painter.drawPolyline(QPolygonF(points))
        painter.setPen(text)
        painter.drawText(QPointF(area.left(), area.top() - 5), f"loss {self._loss[-1]:.3g}")
        painter.end()
