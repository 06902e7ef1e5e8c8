"""What a fit explains, drawn as it goes on, in the colours of the theme."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite

from qtpy.QtCore import QPointF, QRectF
from qtpy.QtGui import QColor, QPainter, QPaintEvent, QPalette, QPen, QPolygonF
from qtpy.QtWidgets import QSizePolicy, QWidget

from ...results.timeline import explained

_MOST = 400  # points drawn
_TEXT = 18  # px above the plot
_COLOUR = "#ffb000"


@dataclass
class Line:
    """The course of one level: iterations, and what was explained, in per cent."""

    x: Sequence[float]
    y: Sequence[float]


class ExplainedCurve(QWidget):
    """What the fit explains; a line for each level, as each looks at a sharper image."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.lines: list[Line] = []
        self.text = ""
        self._now: float | None = None
        self.setMinimumSize(80, 84)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setToolTip(
            "<qt>Share of the signal near the surfaces that the cells explain, noise included, "
            "over the iterations. Each line is a level: the image gets sharper, and its noise "
            "counts more, so that a new line begins lower.</qt>"
        )

    def show_losses(self, loss: Sequence[float], level: Sequence[int], first: int = 1) -> None:
        """Show the course of a fit, from its iteration ``first`` on."""
        n = min(len(loss), len(level))
        kept = _spread(n)
        starts = [k for a, k in pairwise(kept) if level[a] != level[k]]
        parts = [[k for k in kept if a <= k < b] for a, b in pairwise([0, *starts, n])] if n else []
        self.text = f"{explained(loss[n - 1]):.1f}%" if n else ""
        finite = [[k for k in part if isfinite(loss[k])] for part in parts]
        self.lines = [
            Line([first + k for k in part], [explained(loss[k]) for k in part])
            for part in finite
            if part
        ]
        self.update()

    def show_moment(self, x: float | None) -> None:
        """Point at a moment; None at none."""
        self._now = x
        self.update()

    def paintEvent(self, event: QPaintEvent | None) -> None:
        """Draw (called by Qt)."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        ink = self.palette().color(QPalette.ColorRole.WindowText)
        faint = QColor(ink)
        faint.setAlpha(70)
        area = QRectF(self.rect()).adjusted(4, _TEXT, -4, -4)
        painter.setPen(QPen(faint, 1))
        painter.drawRect(area)
        painter.setPen(ink)
        painter.drawText(QPointF(4, _TEXT - 5.0), f"explained, noise included  {self.text}")
        if any(len(line.x) > 1 for line in self.lines):
            self._draw(painter, area, faint, ink)
        painter.end()

    def _draw(self, painter: QPainter, area: QRectF, faint: QColor, ink: QColor) -> None:
        ys = [y for line in self.lines for y in line.y]
        left, low = self.lines[0].x[0], min(ys)
        across = area.width() / ((self.lines[-1].x[-1] - left) or 1.0)
        # A line that hardly changes should look as if it hardly changed.
        up = 0.9 * area.height() / max(max(ys) - low, 0.02 * abs(low), 1e-12)

        def place(x: float, y: float) -> QPointF:
            height = 0.05 * area.height() + (y - low) * up
            return QPointF(area.left() + (x - left) * across, area.bottom() - height)

        def mark(x: float) -> None:
            at = min(max(place(x, low).x(), area.left()), area.right())
            painter.drawLine(QPointF(at, area.top()), QPointF(at, area.bottom()))

        painter.setPen(QPen(faint, 1))
        for line in self.lines[1:]:
            mark(line.x[0])
        painter.setPen(QPen(QColor(_COLOUR), 1.6))
        for line in self.lines:
            points = [place(x, y) for x, y in zip(line.x, line.y, strict=True)]
            painter.drawPolyline(QPolygonF(points))
        if self._now is not None:
            painter.setPen(QPen(ink, 1))
            mark(self._now)


def _spread(n: int) -> list[int]:
    """Indices of as many points as are worth drawing, the first and the last among them."""
    chosen = [*range(0, n, max(1, n // _MOST))]
    return chosen if not n or chosen[-1] == n - 1 else [*chosen, n - 1]
