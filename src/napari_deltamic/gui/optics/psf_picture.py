"""A small picture of the PSF: sections along xz and xy."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QPointF, QRectF, Qt, QTimer
from qtpy.QtGui import QColor, QImage, QPainter, QPaintEvent, QPalette, QPen, QShowEvent
from qtpy.QtWidgets import QSizePolicy, QWidget

from ...optics import Optics
from ...optics.sections import Sections, psf_sections
from ..background import Background

_EVERY = 250  # ms between two pictures, at least
_SIDE, _TEXT, _GAP = 92, 16, 8  # px
_BARS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)  # um


class PsfPicture(QWidget):
    """Shows the PSF that it was last given; computes nothing while it is hidden."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.sections: Sections | None = None
        self._images: tuple[QImage, ...] = ()
        self._wanted: Optics | None = None  # not yet shown
        self._background = Background(self._show, self._drop)
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(_EVERY)
        self._timer.timeout.connect(self._look)
        self.setFixedHeight(_SIDE + _TEXT + 2)
        self.setMinimumWidth(2 * _SIDE + _GAP)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setToolTip(
            "<qt>The PSF, cut along and across the optical axis, both to one scale; while a fit "
            "runs, that of the fit. Brightness is its square root, so that its tails are seen.</qt>"
        )

    @property
    def busy(self) -> bool:
        """Whether a picture is still to come."""
        return self._timer.isActive() or self._background.busy

    def show_optics(self, optics: Optics) -> None:
        """Show a PSF soon; of several, the last."""
        self._wanted = optics
        if self.isVisible() and not self._timer.isActive():
            self._timer.start()

    def clear(self) -> None:
        """There is no PSF that can be shown."""
        self._wanted = None
        self._background.drop()
        self._drop("")

    def close_links(self) -> None:
        """End what is under way."""
        self._timer.stop()
        self._background.close()

    def showEvent(self, event: QShowEvent | None) -> None:
        """Qt's; what was given meanwhile is looked at now."""
        super().showEvent(event)
        if self._wanted is not None and not self._timer.isActive():
            self._timer.start()

    def paintEvent(self, event: QPaintEvent | None) -> None:
        """Draw (called by Qt)."""
        if self.sections is None:
            return
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
        text = self.palette().color(QPalette.ColorRole.WindowText)
        for k, (name, image) in enumerate(zip(("xz", "xy"), self._images, strict=True)):
            area = QRectF(k * (_SIDE + _GAP), _TEXT, _SIDE, _SIDE)
            painter.setPen(text)
            painter.drawText(QPointF(area.left() + 1, _TEXT - 4.0), name)
            painter.drawImage(area, image)
        self._draw_bar(painter, text, self.sections.side)
        painter.end()

    # ----------------------------------------------------------------------------------- inside

    def _draw_bar(self, painter: QPainter, text: QColor, side: float) -> None:
        """A bar of a round length, at most a third of a side, and what it is."""
        length = max((b for b in _BARS if b <= side / 3), default=_BARS[0])
        area = QRectF(_SIDE + _GAP, _TEXT, _SIDE, _SIDE)
        pixels = _SIDE * length / side
        end = QPointF(area.right() - 6, area.bottom() - 6)
        painter.setPen(QPen(QColor("white"), 2))
        painter.drawLine(QPointF(end.x() - pixels, end.y()), end)
        label = f"{length:g} um"
        painter.setPen(text)
        width = painter.fontMetrics().horizontalAdvance(label)
        painter.drawText(QPointF(area.right() - width, _TEXT - 4.0), label)

    def _look(self) -> None:
        wanted, self._wanted = self._wanted, None
        if wanted is None:
            return
        if not self.isVisible() or self._background.busy:
            self._wanted = wanted  # later
            if self.isVisible():
                self._timer.start()
            return
        self._background.ask(partial(psf_sections, wanted))

    def _show(self, sections: Sections) -> None:
        self.sections = sections
        self._images = tuple(_image(section) for section in (sections.xz, sections.xy))
        self.update()

    def _drop(self, reason: str) -> None:
        # Why a PSF cannot be is told beside its numbers.
        self.sections, self._images = None, ()
        self.update()


def _image(section: NDArray[np.float64]) -> QImage:
    grey = np.ascontiguousarray(255 * np.sqrt(np.clip(section, 0, 1))).astype(np.uint8)
    n, m = grey.shape
    image = QImage(grey.tobytes(), m, n, m, QImage.Format.Format_Grayscale8).copy()
    # Samples are not as long along both axes.
    return image.scaled(
        2 * _SIDE,
        2 * _SIDE,
        Qt.AspectRatioMode.IgnoreAspectRatio,
        Qt.TransformationMode.SmoothTransformation,
    )
