"""What tracking keeps from the good frames so far, from which the next one starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np
import torch
from numpy.typing import NDArray

from ..errors import InputError
from ..fitting.fit import fit
from ..fitting.model.state import FitState
from ..fitting.rivals.found_psf import same_kind
from ..fitting.rivals.light_cone import confocal_of, widefield_of
from ..fitting.rivals.psf_tails import core_and_tails
from ..fitting.rivals.psf_tilt import of_any_axes
from ..geometry.mesh import Mesh
from ..optics import GaussianPSF, Optics
from ..runs.settings import FitSettings
from ..scene import Grid
from ..scene.effects import Effects
from ..scene.light import structure_of
from .alarms import CellLook, Volumes, looks
from .frames import Frame, Quality
from .result import Event, FrameResult
from .track_rules import RULES


def structure_of_next(state: FitState) -> str:
    """Return what shines in later frames; empty around dark nuclei, which each frame must find."""
    return "" if state.dimmed is not None else structure_of(state.light)


class BetweenFrames:
    """Mesh, PSF, cells and their motion after the last good frame; the seeds before the first.

    Attributes
    ----------
    mesh, frame
        After the last good frame, and its number.
    optics
        The PSF of the fit of the first good frame, or of the first one with a PSF of an objective:
        all fits start from it, and their priors lie around it. It is one microscope; if each frame
        started from the last PSF, one that images hardly determine would drift.
    structure
        What shines in the first good frame, and hence in all others; empty before it.
    state
        The end of its fit; None before the first.
    edge
        um: the median edge of the seeds.
    quality
        Judges frames by the last good ones.
    looks, volumes, largest, velocities
        Of each cell: volume and centre, last volumes, largest volume so far (um^3), velocity (um a
        frame).
    next_cell
        A number above those of all cells so far.
    first
        The first frame that is still to be tracked.
    done
        Good frames of an earlier run, the last ones.
    """

    def __init__(self, grid: Grid, mesh: Mesh, optics: Optics, first: int) -> None:
        self.mesh, self.optics, self.frame = mesh, optics, first
        self.state: FitState | None = None
        self.structure = ""
        self.edge = mesh.median_edge()
        self.quality = Quality(grid, optics)
        self.looks: dict[int, CellLook] = {}
        self.volumes = Volumes()
        self.largest: dict[int, float] = {}
        self.velocities: dict[int, NDArray[np.float64]] = {}
        self.next_cell = int(mesh.regions.max()) + 1
        self.first = first
        self.done: dict[int, FrameResult] = {}
        self._grid = grid

    def take(self, frame: Frame, state: FitState, mesh: Mesh, events: Sequence[Event]) -> None:
        """Take over a finished frame. mesh : without the cells that have gone."""
        self.quality.accept(frame.pixels, state.loss)
        self._see(frame.number, mesh, events)
        if (self.state is None and not self.done) or not same_kind(state.optics, self.optics):
            self.optics = state.optics
        self.state, self.structure = state, self.structure or structure_of_next(state)
        self.edge = mesh.median_edge() if self.edge == 0 else self.edge

    def two_new_cells(self) -> tuple[int, int]:
        """Return two numbers that no cell has had."""
        return self.next_cell, self.next_cell + 1

    def named(self, cells: Sequence[int]) -> None:
        """Mark these cell numbers as used."""
        self.next_cell = max(self.next_cell, max(cells) + 1)

    def resume(self, done: Sequence[FrameResult], settings: FitSettings) -> None:
        """Go on after the last good frame of some results."""
        for result in done:
            for cell in (*result.cells, *(d for e in result.events for d in e.daughters)):
                self.next_cell = max(self.next_cell, cell + 1)
            self.first = max(self.first, result.frame + 1)
            if result.mesh is None:
                continue
            self._see(result.frame, result.mesh, result.events)
            found = self._left_by(result)
            if settings.fit_psf and (not self.done or not same_kind(found, self.optics)):
                self.optics = found
            self.done[result.frame] = result
            self.structure = self.structure or result.structure
        self.done = dict(sorted(self.done.items())[-RULES.frames.remembered :])

    def _left_by(self, result: FrameResult) -> Optics:
        """Return the PSF that the fit of a frame ended with, if known."""
        numbers = torch.tensor(result.psf, dtype=self.optics.parameters().dtype)
        known: list[Optics] = [self.optics]
        if isinstance(self.optics, GaussianPSF):  # a fit may have found another kind
            about = self.optics.sigma_um
            known += [widefield_of(about), confocal_of(about), core_and_tails(about)]
            known += [widefield_of(about, 0.0), confocal_of(about, 0.0), of_any_axes(self.optics)]
        same = []
        for optics in known:
            with suppress(InputError):  # where the numbers are of another kind
                if len(numbers) == len(optics.parameters()):
                    same.append(optics.with_parameters(numbers))
        told = np.log(result.sigma_um)
        return min(same, key=lambda p: abs(np.log(p.sigma_um) - told).max(), default=self.optics)

    def recall(self, frame: Frame, settings: FitSettings, effects: Effects) -> None:
        """Restore what a frame of an earlier run leaves for later ones."""
        result = self.done.get(frame.number)
        if result is None or result.mesh is None:
            return
        if frame.known.any() and np.isfinite(result.loss):
            self.quality.accept(frame.pixels, result.loss)
        if frame.number == self.frame:
            # Only the first state, which is the start of a fit, is needed.
            settings = settings.model_copy(update={"levels": (1.0,)})
            optics = self._left_by(result) if settings.fit_psf else self.optics
            self.state = next(
                fit(
                    frame.pixels,
                    self._grid,
                    result.mesh,
                    optics,
                    settings=settings,
                    effects=effects,
                )
            )

    def expected(self, frame: int, share: float) -> Mapping[int, NDArray[np.float64]]:
        """Return how far (um) each cell moves until a frame, at a share of its velocity."""
        frames = frame - self.frame
        return {cell: share * frames * v for cell, v in self.velocities.items()}

    def _see(self, frame: int, mesh: Mesh, events: Sequence[Event]) -> None:
        """Record the cells as they are now, and how they have moved since the last good frame."""
        now, frames = looks(mesh), max(frame - self.frame, 1)
        doubtful = {e.cell for e in events if e.kind == "alarm"}
        self.velocities = {}
        for cell, look in now.items():
            old = None if cell in doubtful else self.looks.get(cell)
            self.velocities[cell] = (
                np.zeros(3) if old is None else (look.center - old.center) / frames
            )
            self.largest[cell] = max(look.volume, self.largest.get(cell, 0.0))
        self.volumes.add(now)
        self.looks, self.mesh, self.frame = now, mesh, frame
