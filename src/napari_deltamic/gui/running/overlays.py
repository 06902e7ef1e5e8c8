"""The rendered image and the residual, as they are shown over the measured image."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QObject

from ...evidence.residual import Residual, analyse_residual
from ...evidence.verdict import Verdict, facts_of, judged
from ...evidence.voxel_variance import Variance, voxel_variance
from ...fitting import FitState
from ...fitting.checks import check_image
from ...fitting.job import FitInput
from ...measure import measure
from ...measure.of_fit import known_of
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
    cells : all that is measured on the cells of the end of a fit, by region.
    verdict : what is to be thought of the end of a fit.
    """

    rendered: NDArray[np.float32]
    residual: NDArray[np.float32] | None = None
    found: Residual | None = None
    cells: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)
    verdict: Verdict | None = None


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
        self._found: Residual | None = None  # of the last fit
        self._verdict: Verdict | None = None
        self._of: Any = None  # a weak reference to its image layer
        live.panels.append(self)
        panels.running.go_to_worst.connect(self._go_to_worst)
        panels.image.changed.connect(self._show_grade)
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
        """Render the result, and look at what it leaves unexplained."""
        run, last = self._live.run, self._panels.results.last
        if last is not None and (run is None or not run.running):
            self._background.ask(partial(_of_result, last[0], last[1], self._spread))

    @property
    def _residual(self) -> bool:
        return bool(self._panels.running.residual.isChecked())

    def _add(self, images: Compared) -> None:
        link = self._live.link
        if link is None:
            return
        if images.found is not None:
            self._found, self._of = images.found, weakref.ref(link.image_layer)
            self._verdict = images.verdict
            self._panels.results.show_more(images.cells)
            self._show_grade()
        if self.wanted:
            link.show_rendered(images.rendered, images.residual)
            self._show_layers()

    def _show_grade(self) -> None:
        """What is known of the result, while its image is chosen."""
        running, found, verdict = self._panels.running, self._found, self._verdict
        own = self._of is not None and self._of() is self._panels.image.layer
        if found is None or verdict is None or not own or self._panels.results.last is None:
            running.show_grade("", "")
        else:
            fit = self._panels.results.last[1].settings.fit
            running.estimates_all(fit.fit_psf and fit.density == "smooth")
            running.show_grade(verdict.grade, told(found, verdict), bool(found.spots))

    def forget(self) -> None:
        """What was found is of an earlier fit."""
        self._found = None
        self._background.drop()

    def _go_to_worst(self) -> None:
        link = self._live.link
        if link is not None and self._found is not None and self._found.spots:
            spot = self._found.spots[0]
            link.go_to(spot.position)
            kind = "brighter" if spot.z > 0 else "darker"
            self._panels.running.tell(
                f"In the middle of the view the image is {kind} than the model, by "
                f"{abs(spot.z):.0f} standard deviations of the noise."
            )

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


def _compared(rendered: NDArray[np.float32], job: FitInput, spread: Spread) -> Compared:
    """The residual of an image that is rendered already."""
    noise = np.sqrt(spread.variance(job)(rendered))
    return Compared(rendered, ((job.image - rendered) / noise).astype(np.float32))


def _of_result(state: FitState, job: FitInput, spread: Spread) -> Compared:
    """The images of the end of a fit, and where they do not agree."""
    rendered = state.rendered()
    given = replace(state, _render=lambda: rendered)
    found = analyse_residual(
        job.image, job.grid, given, counted=job.counted, variance=spread.variance(job)
    )
    cells = _measured(state, job, found)
    verdict = judged(facts_of(job, state, found, rendered))
    return replace(_compared(rendered, job, spread), found=found, cells=cells, verdict=verdict)


def _measured(state: FitState, job: FitInput, found: Residual) -> dict[int, dict[str, Any]]:
    """All that is measured on each cell, and how well it is explained."""
    known = {cell.region: cell.explained for cell in found.cells if cell.explained is not None}
    table = measure(state.mesh, known_of(state, job.grid, explained=known)).cells
    rows = {int(row["region"]): dict(row) for row in table.rows if row["region"] is not None}
    for cell in found.cells:
        if cell.region in rows:
            rows[cell.region]["residual_z"] = cell.z
    return rows


def told(found: Residual, verdict: Verdict) -> str:
    """The grade, how much of the image the cells explain, and why it is no better."""
    if found.explained is None:
        return "Nothing around the cells is brighter or darker than noise."
    text = (
        f"{verdict.grade.capitalize()}: the cells explain {found.explained:.0%} of the signal "
        "around them."
    )
    reasons = [reason for reason in verdict.reasons if "is explained" not in reason]
    if reasons:
        text += f" {'; '.join(reasons)}."
    if verdict.grade == "poor":
        text += " Look at the surfaces before you use them."
    return text
