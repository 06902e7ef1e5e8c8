"""What is asked of the scene shown in the background, while no fit runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from qtpy.QtCore import QObject

from .composition import Live, Panels
from .run_control import RunControl


class Inquiry(QObject):
    """Ends as a fit starts, and knows whether its answer is still of what is shown.

    Parameters
    ----------
    panels, live : of the widget.
    control : tells of runs.
    allow : tells the view whether it can be started.
    parent : Qt's.
    """

    def __init__(
        self,
        panels: Panels,
        live: Live,
        control: RunControl,
        allow: Callable[[bool], None],
        parent: QObject | None = None,
    ) -> None:
        super().__init__(parent)
        self._panels, self._live, self._allow = panels, live, allow
        self._open = True
        self._of: tuple[Any, ...] = ()  # what it was asked of
        for signal in (panels.image.changed, panels.settings.changed):
            signal.connect(self._look)
        control.started.connect(self._run_started)
        control.ended.connect(self._run_ended)

    @property
    def busy(self) -> bool:
        """Whether it is under way."""
        raise NotImplementedError

    def stop(self, why: str = "stopped") -> None:
        """End what is under way."""
        raise NotImplementedError

    def look(self) -> None:
        """Something was edited: say so where the answer is of something else."""
        raise NotImplementedError

    @property
    def possible(self) -> bool:
        """Whether it can be started: it is not under way, and no fit is."""
        return self._open and not self.busy and not self._live.occupied

    @property
    def stale(self) -> bool:
        """Whether another image or PSF is shown than it was asked of."""
        return self._of != self._key()

    def note_asked(self) -> None:
        """It is asked of what is shown now."""
        self._of = self._key()

    def close_links(self) -> None:
        """Look at nothing any more."""
        self._open = False

    def _look(self) -> None:
        if self._open:
            self.look()

    def _key(self) -> tuple[Any, ...]:
        image, optics = self._panels.image, self._panels.settings.optics
        return id(image.layer), image.time, image.voxel_size.value(), optics.key()

    def _run_started(self) -> None:
        self.stop("ended as a fit started")
        self._allow(False)

    def _run_ended(self) -> None:
        self._allow(True)
