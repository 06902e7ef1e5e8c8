"""Looking at earlier moments of a fit, and going on from them."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from qtpy.QtCore import QObject

from ...results.timeline import Moment
from ..running.composition import Live, Panels
from ..running.run_control import RunControl
from .edits import Edits

_EVERY = 0.2  # s between two updates of slider and plot


class History(QObject):
    """Connects the slider, undo and redo with the run; shows the moment that is looked at."""

    def __init__(
        self,
        control: RunControl,
        edits: Edits,
        panels: Panels,
        live: Live,
        parent: QObject | None = None,
    ) -> None:
        super().__init__(parent)
        self._control, self._edits, self._panels, self._live = control, edits, panels, live
        self._bar = bar = panels.running.history
        self._next = 0.0
        self._offset = 0
        control.began.connect(self._began)
        control.shown.connect(self._shown)
        control.ended.connect(self._update)
        control.mesh_changed.connect(self._update)
        edits.changed.connect(self._show_undo)
        bar.undo.connect(self._undo)
        bar.redo.connect(self._redo)
        bar.moment_chosen.connect(self._look_at)
        bar.go_on.connect(self._go_on)

    def _began(self, fresh: bool) -> None:
        # The last iteration of the runs before: the plot of the loss is that of the present one.
        moments = self._control.timeline.moments
        self._offset = 0 if fresh or not moments else moments[-1].iteration
        self._bar.to_live()
        self._panels.running.show_fit()

    def _shown(self, snapshot: Any) -> None:
        now = time.monotonic()
        if self._bar.chosen is None:
            self._panels.running.psf.show_sigma("now", snapshot.state.optics.sigma_um)
        if now >= self._next:
            self._next = now + _EVERY
            self._update()

    def _update(self) -> None:
        run, moments = self._live.run, self._control.timeline.moments
        self._bar.show_moments(moments, running=run is not None and run.running)
        self._panels.running.show_sigmas(moments)

    def _look_at(self, moment: Moment | None) -> None:
        running = self._panels.running
        for plot, offset in ((running.curve, self._offset), (running.sigmas, 0)):
            plot.show_moment(None if moment is None else moment.iteration - offset)
        if moment is None:
            self._control.let_go()
            present = self._control.present()
            optics = present.state.optics if present is not None else None
        else:
            self._control.hold(moment.mesh)
            optics = moment.optics
        if optics is not None:
            running.psf.show_sigma("now", optics.sigma_um)

    def _go_on(self) -> None:
        self._control.tried(self._go_on_from_shown)

    def _go_on_from_shown(self) -> None:
        moment, present = self._bar.chosen, self._control.present()
        if moment is not None:
            note = f"back to iteration {moment.iteration}"
            self._edits.go_on_from(moment.mesh, moment.optics, note)
            self._bar.to_live()
        elif present is not None and not present.running:
            self._edits.go_on_from(present.state.mesh, present.state.optics, "go on")

    def _undo(self) -> None:
        self._take_back(self._edits.undo)

    def _redo(self) -> None:
        self._take_back(self._edits.redo)

    def _take_back(self, action: Callable[[], None]) -> None:
        self._bar.to_live()
        self._control.tried(action)
        self._update()

    def _show_undo(self) -> None:
        self._bar.show_undo(self._edits.undo_note, self._edits.redo_note)
