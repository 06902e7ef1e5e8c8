"""Tracking: a generator that fits frame after frame and keeps the identities of the cells."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterable, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..errors import InputError
from ..fitting.checks import check_mesh
from ..fitting.fit import fit
from ..fitting.state import FitState
from ..fitting.triangle_quality import median_edge
from ..fitting.voxel_ownership import counted_voxels
from ..geometry.mesh import Mesh
from ..geometry.remeshing import can_remesh, remesh, smallest_angles
from ..geometry.topology.region_edits import divide_region, remove_region
from ..optics import Optics
from ..runs.settings import FitSettings
from ..runs.track_run import TrackSettings
from ..scene import Grid
from ..scene.effects import Effects, as_effects
from .alarms import CellLook, alarms, gone, looks
from .divisions import Residual, are_daughters, explains, proposals
from .frames import Quality, check_series, check_shape, numbered
from .motion import Start, starts
from .result import Event, FrameResult, TrackState
from .track_rules import RULES

States = Generator[TrackState, None, None]


def track(
    images: Iterable[Any] | Any,
    grid: Grid,
    mesh: Mesh,
    optics: Optics,
    settings: FitSettings | None = None,
    *,
    tracking: TrackSettings | None = None,
    effects: Effects | Sequence[str] = (),
    shared_ground: bool = False,
    done: Sequence[FrameResult] = (),
) -> States:
    """Track the cells of a mesh through a series of images.

    The first frame is fitted from the mesh, each other one from the last good frame, moved on as
    the images or the cells' velocities say, whichever explains the frame best. Region numbers are
    the identities of cells: a new one is given at each division, none is given twice. A frame that
    cannot be used is left out with a reason, and the next one starts from the last good frame.

    Parameters
    ----------
    images
        (T, Z, Y, X), or an iterable of (Z, Y, X); read frame by frame, so that a series may be
        larger than the memory. NaN marks missing voxels.
    grid
        Where the voxels of every frame lie.
    mesh
        Seeds in the first frame that is tracked, um.
    optics
        The PSF; where it is fitted, each frame starts from that of the last.
    settings
        Of the fit of each frame. The levels are those of the first frame; those of later frames
        follow from how far the cells have moved.
    tracking
        See :class:`TrackSettings`.
    effects
        Optional parts of image formation by name.
    shared_ground
        Whether there are membranes in the images that no cell of the mesh describes: voxels nearer
        to those than to a cell are then left out, frame by frame, or they would pull.
    done
        Results of an earlier run to go on from: the frames after them are tracked.

    Yields
    ------
    TrackState
        One for every iteration of every fit, and one with ``done`` for every frame.

    Raises
    ------
    InputError
        Where the images are no series, a frame has another shape, the first frame cannot be fitted,
        or every frame is bad.
    """
    check_series(images)
    tracking = tracking or TrackSettings()
    check_mesh(mesh, grid)
    tracker = _Tracker(
        grid, mesh, optics, settings or FitSettings(), tracking, as_effects(effects), shared_ground
    )
    tracker.resume(done)
    return tracker.states(images)


class _Tracker:
    """What tracking knows between frames."""

    def __init__(
        self,
        grid: Grid,
        mesh: Mesh,
        optics: Optics,
        settings: FitSettings,
        tracking: TrackSettings,
        effects: Effects,
        shared_ground: bool,
    ) -> None:
        self.grid, self.optics, self.settings = grid, optics, settings
        self.tracking, self.effects, self.shared_ground = tracking, effects, shared_ground
        self.mesh = mesh
        self.edge = median_edge(mesh)
        self.quality = Quality(grid, optics)
        self.last: FitState | None = None  # of the last good frame
        self.last_frame = tracking.first
        self.looks: dict[int, CellLook] = {}
        self.largest: dict[int, float] = {}  # um^3
        self.velocities: dict[int, NDArray[np.float64]] = {}  # um a frame
        self.reasons: list[str] = []  # why frames were left out
        self.over = False  # whether every cell has gone
        self.first = tracking.first
        self.done: dict[int, FrameResult] = {}  # good frames of an earlier run, the last ones
        self.next_cell = int(mesh.regions.max()) + 1

    # ----------------------------------------------------------------------------------- frames

    def states(self, images: Any) -> States:
        """A state for every iteration, and one for every frame."""
        begin = min(self.done, default=self.first)
        frames: Any = numbered(images, begin)
        if self.tracking.stop is not None:
            frames = islice(frames, max(self.tracking.stop - begin, 0))
        count, bad = 0, 0
        for frame, image in frames:
            if frame < self.first:
                self._recall(frame, image)
                continue
            count += 1
            began = time.monotonic()
            flaw, known = image if isinstance(image, str) else "", np.zeros(0, bool)
            if not isinstance(image, str):
                check_shape(image, frame, self.grid)
                image, known = _known(image)
                flaw = self.quality.flaw(np.where(known, image, np.nan))
            if not flaw:
                flaw = yield from self._frame(frame, image, known, began)
            if flaw:
                bad += 1
                self.reasons.append(flaw)
                text = f"frame {frame} is left out: {flaw}"
                result = FrameResult(frame, frame * self.tracking.time_step, None, text)
                yield TrackState(frame, None, done=result)
            if self.over:
                break
        if count and bad == count and not self.done:
            raise InputError(f"no frame can be used; the first one: {self.reasons[0]}")
        if count < 2 and self.last_frame == self.tracking.first and not bad:
            raise InputError(f"tracking needs two frames or more, not {count}")

    def _frame(
        self, frame: int, image: NDArray[np.float32], known: NDArray[np.bool_], began: float
    ) -> Generator[TrackState, None, str]:
        """Fit a frame; returns why it is to be left out, or ""."""
        pixels = np.where(known, image, np.nan)
        tries = self._starts(frame, image, known)
        state, early = yield from self._fit(frame, pixels, tries[0])
        flaw = self.quality.misfit(state.loss)
        found = (
            {} if self.last is None else alarms(state.mesh, tries[0].mesh, self.looks, self.grid)
        )
        if (found or flaw) and len(tries) > 1:
            other, before = yield from self._fit(frame, pixels, tries[1], wider=True)
            again = alarms(other.mesh, tries[1].mesh, self.looks, self.grid)
            better = other.loss < state.loss if flaw else len(again) < len(found)
            if better:
                state, early, found = other, before, again
                flaw = self.quality.misfit(other.loss)
        events = [
            Event("alarm", frame, cell, f"cell {cell} may be lost: {why}")
            for cell, why in found.items()
        ]
        if self.tracking.divisions and self.last is not None:
            state = yield from self._divide(frame, image, known, state, early, events)
        # After that: a cell that has divided is badly explained until it has two daughters.
        flaw = self.quality.misfit(state.loss)
        if flaw:
            return flaw
        mesh = self._without_gone(frame, state, events)
        when = frame * self.tracking.time_step
        if mesh is None:
            self.over = True
            text = f"no cell is left in frame {frame}: tracking ends"
            yield TrackState(frame, None, done=FrameResult(frame, when, None, text, tuple(events)))
            return ""
        self._take(frame, image, known, state, mesh, events)
        result = FrameResult(
            frame, when, mesh, state.message, tuple(events), state.loss,
            state.iteration, time.monotonic() - began, state.optics.sigma_um,
            tuple(state.optics.parameters().detach().tolist()),
        )  # fmt: skip
        yield TrackState(frame, mesh, done=result, last_fit=state)
        return ""

    def _starts(
        self, frame: int, image: NDArray[np.float32], known: NDArray[np.bool_]
    ) -> list[Start]:
        if self.last is None:
            return [Start("seeds", self.mesh, 0.0, float("nan"))]
        frames = frame - self.last_frame
        expected = {
            cell: self.tracking.velocity * frames * v for cell, v in self.velocities.items()
        }
        rendered = self.last.rendered()
        return starts(self.mesh, rendered, image, known, self.grid, self.optics, expected)

    def _fit(
        self, frame: int, pixels: NDArray[np.float32], start: Start, *, wider: bool = False
    ) -> Generator[TrackState, None, tuple[FitState, FitState | None]]:
        """The last state of a fit from a start, with all remarks, and the first one.

        Those on the way are yielded.
        """
        remarks: list[str] = []
        settings = self.settings
        if start.name != "seeds":
            width = min(self.optics.sigma_um)
            levels = start.levels(width / 2 if wider else width)
            settings = settings.model_copy(update={"levels": levels})
        mesh, counted = self._renewed(start.mesh), None
        state: FitState | None = None
        early: FitState | None = None
        if self.shared_ground:
            counted = counted_voxels(pixels, self.grid, mesh, self.optics)
        for state in fit(
            pixels, self.grid, mesh, self.optics,
            settings=settings, counted=counted, effects=self.effects,
        ):  # fmt: skip
            remarks += [part for part in state.message.split("; ") if part not in remarks]
            early = early or state
            yield TrackState(frame, state.mesh, state)
        assert state is not None, "a fit yields at least one state"
        told = (part for part in remarks if part not in ("", "converged"))
        return replace(state, message="; ".join(told)), early

    def _renewed(self, mesh: Mesh) -> Mesh:
        """Good triangles of the size that they had in the first frame."""
        if not (self.settings.remesh and can_remesh()) or self.last is None:
            return mesh
        rules = RULES.meshes
        poor = float((smallest_angles(mesh) < rules.poor_angle).mean()) > rules.poor_share
        change = median_edge(mesh) / self.edge
        if poor or not 1 / rules.edge_change < change < rules.edge_change:
            return remesh(mesh, self.edge, passes=2).mesh
        return mesh

    # -------------------------------------------------------------------------------- divisions

    def _divide(
        self,
        frame: int,
        image: NDArray[np.float32],
        known: NDArray[np.bool_],
        state: FitState,
        early: FitState | None,
        events: list[Event],
    ) -> Generator[TrackState, None, FitState]:
        """Put walls into cells that call for one, as long as they explain the image better.

        At the end of a fit a single cell may have folded in along a wall and explain it: where
        nothing is left to see, what its start (``early``) left is looked at.
        """
        refused: set[int] = set()
        rounds = 0
        while rounds < RULES.divisions.rounds:
            before = Residual(image, known, self.grid, state)
            mesh, divided, calls = state.mesh, {}, proposals(before, state.mesh)
            folded = not calls and rounds == 0 and _alike(early, state)
            if folded:
                assert early is not None
                mesh = early.mesh
                calls = proposals(Residual(image, known, self.grid, early), mesh)
            for found in calls:
                if found.cell in refused:
                    continue
                pair = (self.next_cell, self.next_cell + 1)
                try:
                    mesh = divide_region(mesh, found.cell, found.point, found.normal, pair)
                except InputError:  # a plane that does not cut the cell in one loop
                    refused.add(found.cell)
                    continue
                self.next_cell += 2
                divided[found.cell] = (pair, found)
            if not divided:
                break
            start = Start("division", mesh, 0.0, float("nan"))
            pixels = np.where(known, image, np.nan)
            new, _ = yield from self._fit(frame, pixels, start)
            after = Residual(image, known, self.grid, new)
            good = {
                c
                for c in divided
                if explains(before, after, c, folded) and are_daughters(new.mesh, divided[c][0])
            }
            refused |= set(divided) - good
            if not good:
                break
            if len(good) < len(divided):  # once more, without the others: they are refused now
                continue
            state, rounds = new, rounds + 1
            for cell, (pair, found) in divided.items():
                text = (
                    f"cell {cell} divided into {pair[0]} and {pair[1]} (a wall of "
                    f"{found.brightness:.1f} times the expected brightness)"
                )
                events.append(Event("divided", frame, cell, text, pair))
        return state

    # ------------------------------------------------------------------------- between frames

    def _without_gone(self, frame: int, state: FitState, events: list[Event]) -> Mesh | None:
        """The mesh without cells that have gone; their tracks end."""
        mesh: Mesh | None = state.mesh
        present = set(state.mesh.region_ids().tolist())
        ended = {e.cell for e in events if e.kind == "divided"}
        lost = {
            c: "it was squeezed out between its neighbours"
            for c in self.looks
            if c not in present and c not in ended
        }
        lost |= gone(state.mesh, self.largest, self.grid, min(state.optics.sigma_um))
        for cell, why in lost.items():
            events.append(Event("ended", frame, cell, f"cell {cell} ends: {why}"))
            if cell in present and mesh is not None:
                mesh = remove_region(mesh, cell)
        return mesh

    def _take(
        self,
        frame: int,
        image: NDArray[np.float32],
        known: NDArray[np.bool_],
        state: FitState,
        mesh: Mesh,
        events: Sequence[Event],
    ) -> None:
        """A frame is done: the next one starts from it."""
        self.quality.accept(np.where(known, image, np.nan), state.loss)
        now, frames = looks(mesh), max(frame - self.last_frame, 1)
        alarmed = {e.cell for e in events if e.kind == "alarm"}
        for event in events:
            for daughter in event.daughters:
                self.velocities[daughter] = np.zeros(3)
        self.velocities = {
            cell: self._velocity(cell, look, frames, cell in alarmed) for cell, look in now.items()
        }
        self.looks = now
        for cell, look in now.items():
            self.largest[cell] = max(look.volume, self.largest.get(cell, 0.0))
        self.mesh, self.last, self.last_frame = mesh, state, frame
        self.optics = state.optics
        self.edge = median_edge(mesh) if self.edge == 0 else self.edge

    def _velocity(
        self, cell: int, look: CellLook, frames: int, doubtful: bool
    ) -> NDArray[np.float64]:
        old = self.looks.get(cell)
        if old is None or doubtful:
            return np.zeros(3)
        velocity: NDArray[np.float64] = (look.center - old.center) / frames
        return velocity

    def resume(self, done: Sequence[FrameResult]) -> None:
        """Go on after the last good one of some results."""
        for result in done:
            for cell in (*result.cells, *(d for e in result.events for d in e.daughters)):
                self.next_cell = max(self.next_cell, cell + 1)
            self.first = max(self.first, result.frame + 1)
            if result.mesh is None:
                continue
            now = looks(result.mesh)
            frames = max(result.frame - self.last_frame, 1)
            alarmed = {e.cell for e in result.events if e.kind == "alarm"}
            self.velocities = {
                c: self._velocity(c, v, frames, c in alarmed) for c, v in now.items()
            }
            self.done[result.frame] = result
            if self.settings.fit_psf and len(result.psf) == self.optics.parameters().numel():
                numbers = torch.tensor(result.psf, dtype=self.optics.parameters().dtype)
                self.optics = self.optics.with_parameters(numbers)
            self.looks, self.mesh, self.last_frame = now, result.mesh, result.frame
            for cell, look in now.items():
                self.largest[cell] = max(look.volume, self.largest.get(cell, 0.0))
        self.done = dict(sorted(self.done.items())[-RULES.frames.remembered :])

    def _recall(self, frame: int, image: NDArray[Any] | str) -> None:
        """What a frame of an earlier run left behind for those to come."""
        result = self.done.get(frame)
        if result is None or result.mesh is None or isinstance(image, str):
            return
        check_shape(image, frame, self.grid)
        image, known = _known(image)
        pixels = np.where(known, image, np.nan)
        if known.any() and np.isfinite(result.loss):
            self.quality.accept(pixels, result.loss)
        if frame == self.last_frame:
            # The first state of a fit is its start.
            settings = self.settings.model_copy(update={"levels": (1.0,)})
            given = pixels, self.grid, result.mesh, self.optics
            self.last = next(fit(*given, settings=settings, effects=self.effects))


def _known(image: NDArray[Any]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """float32 with zeros where the image is not finite, and where it is."""
    if not np.issubdtype(image.dtype, np.number) or np.iscomplexobj(image):
        raise InputError(f"an image of real numbers is needed, not of {image.dtype}")
    values = image.astype(np.float32)
    known = np.isfinite(values)
    return np.where(known, values, 0).astype(np.float32), known


def _alike(early: FitState | None, state: FitState) -> bool:
    """Whether there is an early state, with the same cells."""
    return early is not None and np.array_equal(early.mesh.region_ids(), state.mesh.region_ids())
