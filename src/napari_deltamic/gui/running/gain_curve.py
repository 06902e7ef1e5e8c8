"""The course of a fit: what it gains, by iteration."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import isfinite

from qtpy.QtCore import QPointF, QRectF
from qtpy.QtGui import QColor, QPainter, QPaintEvent, QPalette, QPen, QPolygonF
from qtpy.QtWidgets import QSizePolicy, QWidget

from ...results.timeline import explained
from ..widgets import is_dark

_POINTS = 400  # of each line fewer than twice as many are drawn
_OVER_CURVE = 18  # px above the plot
_CAPTION, _TOO_FEW = "what the fit has gained, by iteration", "one iteration so far"
_HARDLY = 2.0  # per cent: who gains less is drawn no larger
_CURVE = ("#ffb000", "#a35f00")  # on dark, and on light


@dataclass
class Line:
    """The course of one level: iterations, and the gain up to there in per cent."""

    x: Sequence[float]
    y: Sequence[float]


class GainCurve(QWidget):
    """Plots what a fit gains, with a line for each level, as each sees a sharper image."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.lines: list[Line] = []
        self._now: float | None = None
        self.setMinimumSize(80, 84)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setToolTip(
            "<qt>How much closer the rendered image has come to the measured one near the "
            "surfaces, over the iterations: where it is flat, nothing more is gained. Each line is "
            "a level: the image gets sharper there. Where the fit weighs the voxels anew, the line "
            "goes on at the same height; it falls only by what you change. The grade says how good "
            "the end is.</qt>"
        )

    def show_losses(
        self,
        loss: Sequence[float],
        level: Sequence[int],
        first: int = 1,
        changed: Collection[int] = (),
    ) -> None:
        """Show the course of a fit, from its iteration ``first`` on.

        changed : iterations that follow upon a change by the user, in which more may be lost.
        """
        n = min(len(loss), len(level))
        gained = _gained(loss[:n], [first + k in changed for k in range(n)])
        kept = [k for k in _spread(n) if isfinite(loss[k])]
        parts = [list(part) for _, part in groupby(kept, lambda k: level[k])]
        self.lines = [Line([first + k for k in part], [gained[k] for k in part]) for part in parts]
        self.update()

    def show_moment(self, x: float | None) -> None:
        """Mark a moment by its place on the axis; None for none."""
        self._now = x
        self.update()

    def paintEvent(self, event: QPaintEvent | None) -> None:
        """Draw (called by Qt)."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        ink = self.palette().color(QPalette.ColorRole.WindowText)
        faint = QColor(ink)
        faint.setAlpha(70)
        area = QRectF(self.rect()).adjusted(4, _OVER_CURVE, -4, -4)
        some = any(len(line.x) > 1 for line in self.lines)
        painter.setPen(ink)
        painter.drawText(QPointF(4, _OVER_CURVE - 5.0), _CAPTION if some else _TOO_FEW)
        if some:
            painter.setPen(QPen(faint, 1))
            painter.drawRect(area)
            self._draw(painter, area, faint, ink)
        painter.end()

    def _draw(self, painter: QPainter, area: QRectF, faint: QColor, ink: QColor) -> None:
        ys = [y for line in self.lines for y in line.y]
        left, low = self.lines[0].x[0], min(ys)
        across = area.width() / ((self.lines[-1].x[-1] - left) or 1.0)
        # A line that hardly changes should look as if it hardly changed.
        up = 0.9 * area.height() / max(max(ys) - low, _HARDLY)

        def place(x: float, y: float) -> QPointF:
            height = 0.05 * area.height() + (y - low) * up
            return QPointF(area.left() + (x - left) * across, area.bottom() - height)

        def mark(x: float) -> None:
            at = min(max(place(x, low).x(), area.left()), area.right())
            painter.drawLine(QPointF(at, area.top()), QPointF(at, area.bottom()))

        painter.setPen(QPen(faint, 1))
        for line in self.lines[1:]:
            mark(line.x[0])
        painter.setPen(QPen(QColor(_CURVE[not is_dark(self)]), 1.6))
        for line in self.lines:
            points = [place(x, y) for x, y in zip(line.x, line.y, strict=True)]
            painter.drawPolyline(QPolygonF(points))
        if self._now is not None:
            painter.setPen(QPen(ink, 1))
            mark(self._now)


def _gained(loss: Sequence[float], changed: Sequence[bool]) -> list[float]:
    """The gain up to each iteration, in per cent of the variation of the image.

    On its way down a fit only gains: where its loss grows, it counts other voxels than before, or
    weighs them otherwise. Only what the user changed may lose.
    """
    total, known, gained = 0.0, None, []
    for value, by_user in zip(loss, changed, strict=True):
        if isfinite(value):
            step = 0.0 if known is None else explained(value) - explained(known)
            total += step if by_user else max(step, 0.0)
            known = value
        gained.append(total)
    return gained


def _spread(n: int) -> list[int]:
    """Indices of evenly spaced points, fewer than twice ``_POINTS``, with both ends."""
    chosen = [*range(0, n, max(1, n // _POINTS))]
    return chosen if not n or chosen[-1] == n - 1 else [*chosen, n - 1]
