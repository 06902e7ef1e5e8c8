"""The rendered image and the residual, as they are shown over the measured image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QObject

from ...evidence.residual import Residual, analyse_residual
from ...evidence.voxel_variance import Variance, voxel_variance
from ...fitting import FitState
from ...fitting.checks import check_image
from ...fitting.job import FitInput
from ..background import Background
from .composition import Live, Panels
from .run_progress import Snapshot


@dataclass(frozen=True, eq=False)
class Compared:
    """Rendered images of a state, and how well they agree with the measured one.

    rendered : (Z, Y, X).
    residual : (Z, Y, X) measured minus rendered, in standard deviations of the noise; None where
        it is not wanted.
    found : what the end of a fit leaves unexplained.
    """

    rendered: NDArray[np.float32]
    residual: NDArray[np.float32] | None = None
    found: Residual | None = None


class Spread:
    """The noise of a measured image, looked at once; used by one thread at a time."""

    def __init__(self) -> None:
        self._of: Any = None
        self._variance: Variance | None = None

    def variance(self, job: FitInput) -> Variance:
        """Of a voxel of the image of a job, from its expected value."""
        if self._variance is None or self._of is not job.image:
            pixels, known = check_image(job.image, job.grid)
            self._of, self._variance = job.image, voxel_variance(job.image, pixels, known)
        return self._variance


class Overlays(QObject):
    """Shows what the boxes in the run panel ask for: while a fit runs, and of its result."""

    def __init__(
        self, panels: Panels, live: Live, warn: Callable[[str], None], parent: QObject | None = None
    ) -> None:
        super().__init__(parent)
        self._panels, self._live = panels, live
        # After the end nobody renders along the way, and it may take too long to wait for.
        self._background = Background(self._add, warn)
        self._spread = Spread()
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
        if snapshot.rendered is None:
            return
        if not self._residual:
            self._add(Compared(snapshot.rendered))
        elif not self._background.busy:
            given = snapshot.rendered, snapshot.job, self._spread
            self._background.ask(partial(_compared, *given))

    def show_result(self) -> None:
        """Render the result, where that is wanted."""
        run, last = self._live.run, self._panels.results.last
        if self.wanted and last is not None and (run is None or not run.running):
            spread = self._spread if self._residual else None
            self._background.ask(partial(_of_result, last[0], last[1], spread))

    def show_end(self) -> None:
        """A fit has ended; its last image is shown already, but not what it leaves unexplained."""
        if self._residual:
            self.show_result()

    @property
    def _residual(self) -> bool:
        return bool(self._panels.running.residual.isChecked())

    def _add(self, images: Compared) -> None:
        link = self._live.link
        if link is None or not self.wanted:
            return
        link.show_rendered(images.rendered, images.residual)
        self._show_layers()
        if images.found is not None:
            self._panels.results.table.show_fits(images.found.cells)
            self._panels.running.tell(_verdict(images.found))

    def _toggled(self, checked: bool) -> None:
        if self._live.run is not None:
            self._live.run.show_rendered(self.wanted)
        if checked:
            self.show_result()
        if not self._residual:
            self._panels.results.table.show_fits(())
        self._show_layers()

    def _show_layers(self) -> None:
        running = self._panels.running
        if self._live.link is not None:
            self._live.link.show_layers(running.rendered.isChecked(), running.residual.isChecked())


def _compared(rendered: NDArray[np.float32], job: FitInput, spread: Spread) -> Compared:
    """The residual of an image that is rendered already."""
    noise = np.sqrt(spread.variance(job)(rendered))
    return Compared(rendered, ((job.image - rendered) / noise).astype(np.float32))


def _of_result(state: FitState, job: FitInput, spread: Spread | None) -> Compared:
    """The images of the end of a fit, and where they do not agree."""
    rendered = state.rendered()
    if spread is None:
        return Compared(rendered)
    given = replace(state, _render=lambda: rendered)
    found = analyse_residual(
        job.image, job.grid, given, counted=job.counted, variance=spread.variance(job)
    )
    return replace(_compared(rendered, job, spread), found=found)


def _verdict(found: Residual) -> str:
    """How much of the image is explained, in a sentence."""
    if found.explained is None:
        return "nothing near the surfaces varies by more than noise"
    text = f"{found.explained:.0%} of what varies near the surfaces is explained"
    if not found.spots:
        return text
    spot = found.spots[0]
    kind = "brighter" if spot.z > 0 else "darker"
    z, y, x = spot.position
    return f"{text}; most is left at z {z:.1f}, y {y:.1f}, x {x:.1f} um, {kind} than the model"
