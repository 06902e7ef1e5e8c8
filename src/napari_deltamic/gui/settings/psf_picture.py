"""A small picture of the PSF: sections along xz and xy."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QTimer
from qtpy.QtGui import QImage, QPixmap, QShowEvent
from qtpy.QtWidgets import QLabel, QWidget
from skimage.transform import resize

from ...optics import Optics
from ...optics.sections import Sections, psf_sections
from ..document import Document

_EVERY = 250  # ms between two pictures, at least
_SIDE, _GAP = 92, 8  # px
_BARS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)  # um


class PsfPicture(QLabel):
    """Shows the PSF that it was last given; computes nothing while it is hidden."""

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.sections: Sections | None = None
        self._wanted: Optics | None = None  # not yet shown
        self._background = doc.background(self._show, self._drop)
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(_EVERY)
        self._timer.timeout.connect(self._look)
        self.setFixedHeight(_SIDE + 2)
        self._tip = (
            "<qt>The PSF, cut along the optical axis (left) and across it, both to one scale; that "
            "of the fit, where there is one. Brightness is its square root, so that its tails are "
            "seen. The bar is {bar} µm long.</qt>"
        )

    @property
    def busy(self) -> bool:
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

    def showEvent(self, event: QShowEvent | None) -> None:
        """Qt's; what was given meanwhile is looked at now."""
        super().showEvent(event)
        if self._wanted is not None and not self._timer.isActive():
            self._timer.start()

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
        grey = [_scaled(np.sqrt(np.clip(s, 0, 1))) for s in (sections.xz, sections.xy)]
        # A bar of a round length, at most a third of a side.
        bar = max((b for b in _BARS if b <= sections.side / 3), default=_BARS[0])
        pixels = max(round(_SIDE * bar / sections.side), 1)
        grey[1][-8:-6, _SIDE - 6 - pixels : _SIDE - 6] = 255
        gap = np.zeros((_SIDE, _GAP), np.uint8)
        picture = np.ascontiguousarray(np.hstack([grey[0], gap, grey[1]]))
        n, m = picture.shape
        image: Any = QImage(picture.tobytes(), m, n, m, QImage.Format.Format_Grayscale8)
        self.setPixmap(QPixmap.fromImage(image.copy()))
        self.setToolTip(self._tip.format(bar=f"{bar:g}"))

    def _drop(self, reason: str) -> None:
        # Why a PSF cannot be is told beside its numbers.
        self.sections = None
        super().clear()


def _scaled(section: NDArray[np.float64]) -> NDArray[np.uint8]:
    """A square of the side of a picture; samples are not as long along both axes."""
    square = resize(section, (_SIDE, _SIDE), order=1, anti_aliasing=True)
    grey: NDArray[np.uint8] = (255 * np.clip(square, 0, 1)).astype(np.uint8)
    return grey
