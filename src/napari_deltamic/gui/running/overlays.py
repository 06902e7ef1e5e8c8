"""The rendered image and the residual, as they are shown over the measured image."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QObject

from ...inference import FitState
from ...job import FitInput
from ..background import Background
from .composition import Live, Panels
from .course import Snapshot

_Rendered = tuple[NDArray[np.float32], NDArray[Any]]


class Overlays(QObject):
    """Shows what the boxes in the run panel ask for: while a fit runs, and of its result."""

    def __init__(
        self, panels: Panels, live: Live, warn: Callable[[str], None], parent: QObject | None = None
    ) -> None:
        super().__init__(parent)
        self._panels, self._live = panels, live
        # After the end nobody renders along the way, and it may take too long to wait for.
        self._background = Background(self._add, warn)
        live.panels.append(self)
        panels.running.rendered_toggled.connect(self._toggled)
        panels.running.residual_toggled.connect(self._toggled)

    def close_links(self) -> None:
        """Show nothing any more."""
        self._background.close()

    @property
    def wanted(self) -> bool:
        """Whether an image is to be rendered at all."""
        running = self._panels.running
        return bool(running.rendered.isChecked() or running.residual.isChecked())

    def show_snapshot(self, snapshot: Snapshot) -> None:
        """What a fit that runs has rendered, if it has."""
        if snapshot.rendered is not None:
            self._add((snapshot.rendered, snapshot.job.image))

    def show_result(self) -> None:
        """Render the result, where that is wanted."""
        run, last = self._live.run, self._panels.results.last
        if self.wanted and last is not None and (run is None or not run.running):
            self._background.ask(partial(_rendered, last[0], last[1]))

    def _add(self, images: _Rendered) -> None:
        link, (rendered, measured) = self._live.link, images
        if link is None or not self.wanted:
            return
        residual = self._panels.running.residual.isChecked()
        link.show_rendered(rendered, measured if residual else None)
        self._show_layers()

    def _toggled(self, checked: bool) -> None:
        if self._live.run is not None:
            self._live.run.show_rendered(self.wanted)
        if checked:
            self.show_result()
        self._show_layers()

    def _show_layers(self) -> None:
        running = self._panels.running
        if self._live.link is not None:
            self._live.link.show_layers(running.rendered.isChecked(), running.residual.isChecked())


def _rendered(state: FitState, job: FitInput) -> _Rendered:
    return state.rendered(), job.image
