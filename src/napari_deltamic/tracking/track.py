"""Tracking: a generator that fits frame after frame and preserves the identities of cells."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, Literal

import numpy as np

from ..errors import InputError
from ..fitting.fit import fit
from ..fitting.model.checks import check_mesh
from ..fitting.model.state import FitState
from ..fitting.voxels.voxel_ownership import counted_voxels
from ..geometry.mesh import Mesh
from ..geometry.remeshing import can_remesh, remesh, smallest_angles
from ..geometry.topology.region_edits import divide_region, remove_region
from ..optics import Optics
from ..runs.settings import WIDE_LEVELS, FitSettings
from ..runs.track_run import TrackSettings
from ..scene import Grid
from ..scene.effects import Effects, as_effects
from .alarms import alarms, gone, looks
from .between_frames import BetweenFrames, structure_of_next
from .divisions import Residual, are_daughters, explains, has_folded, proposals
from .frames import Frame, check_series, numbered
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
    the identities of cells: divisions give new numbers, and none is used twice. A frame that cannot
    be used is left out with a reason, and the next one starts from the last good frame.

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
        The PSF; if it is fitted, later frames start from that of the first good one.
    settings
        Of the fit of each frame. The levels are those of the first frame; those of later frames
        follow from how far the cells have moved.
    tracking
        See :class:`TrackSettings`.
    effects
        Optional parts of image formation by name.
    shared_ground
        Whether the images show membranes that no cell of the mesh describes: voxels nearer to those
        than to a cell are then left out in each frame, or they would pull at cells.
    done
        Results of an earlier run to go on from: the frames after them are tracked.

    Yields
    ------
    TrackState
        One for every iteration of every fit, and one with ``done`` for every frame.

    Raises
    ------
    InputError
        If the images are no series, a frame has another shape, the first frame cannot be fitted, or
        every frame is bad.
    """
    check_series(images)
    tracking = tracking or TrackSettings()
    check_mesh(mesh, grid)
    past = BetweenFrames(grid, mesh, optics, tracking.first)
    settings = settings or FitSettings()
    past.resume(done, settings)
    tracker = _Tracker(grid, past, settings, tracking, as_effects(effects), shared_ground)
    return tracker.states(images)


Blur = Literal["near", "wider", "all"]  # just enough, some more, and that of a first frame


@dataclass
class _Tracker:
    """Fits frame after frame. The arguments are those of :func:`track`."""

    grid: Grid
    past: BetweenFrames
    settings: FitSettings
    tracking: TrackSettings
    effects: Effects
    shared_ground: bool
    over: bool = False  # whether every cell has gone

    # ----------------------------------------------------------------------------------- frames

    def states(self, images: Any) -> States:
        """Yield a state for every iteration, and one for every frame."""
        past, reasons, count = self.past, list[str](), 0
        begin = min(past.done, default=past.first)
        numbers: Any = numbered(images, begin)
        if self.tracking.stop is not None:
            numbers = islice(numbers, max(self.tracking.stop - begin, 0))
        first = past.first
        for number, image in numbers:
            read = None if isinstance(image, str) else image
            if number < first:
                if read is not None and number in past.done:
                    past.recall(Frame.of(number, read, self.grid), self.settings, self.effects)
                continue
            count += 1
            if read is None:
                flaw = image
            else:
                flaw = yield from self._frame(Frame.of(number, read, self.grid))
            if flaw:
                reasons.append(flaw)
                text = f"frame {number} skipped: {flaw}"
                result = FrameResult(number, number * self.tracking.time_step, None, text)
                yield TrackState(number, None, done=result)
            if self.over:
                break
        if count and len(reasons) == count and not past.done:
            raise InputError(f"no frame can be used; the first one: {reasons[0]}")
        if count < 2 and past.frame == self.tracking.first and not reasons:
            raise InputError(f"tracking needs two frames or more, not {count}")

    def _frame(self, frame: Frame) -> Generator[TrackState, None, str]:
        """Fit a frame; returns why it must be left out, or ""."""
        began, past = time.monotonic(), self.past
        flaw = past.quality.flaw(frame.pixels)
        if flaw:
            return flaw
        state, early, found = yield from self._tried(frame)
        events = [
            Event("alarm", frame.number, cell, f"check cell {cell}: {why}")
            for cell, why in found.items()
        ]
        if self.tracking.divisions and past.state is not None:
            state = yield from self._divide(frame, state, early, events)
        # Only now: a cell that has divided is badly explained until it has two daughters.
        flaw = past.quality.misfit(state.loss)
        if flaw:
            return flaw
        mesh = self._without_gone(frame.number, state, events)
        when = frame.number * self.tracking.time_step
        if mesh is None:
            self.over = True
            text = f"no cell is left in frame {frame.number}: tracking ends"
            result = FrameResult(frame.number, when, None, text, tuple(events))
            yield TrackState(frame.number, None, done=result)
            return ""
        past.take(frame, state, mesh, events)
        result = FrameResult(
            frame.number, when, mesh, state.message, tuple(events), state.loss,
            state.iteration, time.monotonic() - began, state.optics.sigma_um,
            tuple(state.optics.parameters().detach().tolist()), structure_of_next(state),
            state.moving,
        )  # fmt: skip
        yield TrackState(frame.number, mesh, done=result, last_fit=state)
        return ""

    def _tried(
        self, frame: Frame
    ) -> Generator[TrackState, None, tuple[FitState, FitState | None, dict[int, str]]]:
        """Return the trusted fit that raises fewest alarms, its first state, and those alarms.

        If the best start raises any, or ends with an unusual loss, the second best is tried with
        more blur, and then the best one again with as much blur as a first frame: a start may lie
        in the basin of another optimum.
        """
        tries, quality = self._starts(frame), self.past.quality
        wider: list[tuple[Start, Blur]] = [(start, "wider") for start in tries[1:2]]
        ends: list[tuple[FitState, FitState | None, dict[int, str]]] = []
        for start, blur in ((tries[0], "near"), *wider, (tries[0], "all")):
            state, early = yield from self._fit(frame, start, blur)
            ends.append((state, early, self._alarms(state.mesh, start.mesh)))
            if not (ends[-1][2] or quality.odd(state.loss)):
                break
        return min(
            ends,
            key=lambda end: (bool(quality.misfit(end[0].loss)), len(end[2]), end[0].loss),
        )

    def _alarms(self, mesh: Mesh, start: Mesh) -> dict[int, str]:
        """Return cells that may have lost their identity, and why; none in the first frame."""
        past = self.past
        if past.state is None:
            return {}
        jumps = past.volumes.jumps(looks(mesh))
        return jumps | alarms(mesh, start, past.looks, self.grid)

    def _starts(self, frame: Frame) -> list[Start]:
        past = self.past
        if past.state is None:
            return [Start("seeds", past.mesh, 0.0, float("nan"))]
        expected = past.expected(frame.number, self.tracking.velocity)
        rendered = past.state.rendered()
        return starts(
            past.mesh, rendered, frame.image, frame.known, self.grid, past.optics, expected
        )

    def _fit(
        self, frame: Frame, start: Start, blur: Blur = "near"
    ) -> Generator[TrackState, None, tuple[FitState, FitState | None]]:
        """Fit from a start; return the last state, with all remarks, and the first one.

        The states on the way are yielded.
        """
        remarks: list[str] = []
        settings = self.settings
        if start.name != "seeds":
            width = min(self.past.optics.sigma_um)
            levels = start.levels(width / 2 if blur == "wider" else width)
            if blur == "all":
                levels = WIDE_LEVELS
            settings = settings.model_copy(update={"levels": levels})
        if settings.structure == "auto" and self.past.structure:
            settings = settings.model_copy(update={"structure": self.past.structure})
        mesh, counted = self._renewed(start.mesh), None
        state: FitState | None = None
        early: FitState | None = None
        if self.shared_ground:
            counted = counted_voxels(frame.pixels, self.grid, mesh, self.past.optics)
        for state in fit(
            frame.pixels, self.grid, mesh, self.past.optics,
            settings=settings, counted=counted, effects=self.effects,
        ):  # fmt: skip
            remarks += [part for part in state.message.split("; ") if part not in remarks]
            early = early or state
            yield TrackState(frame.number, state.mesh, state)
        assert state is not None, "a fit yields at least one state"
        told = (part for part in remarks if part not in ("", "converged"))
        return replace(state, message="; ".join(told)), early

    def _renewed(self, mesh: Mesh) -> Mesh:
        """Remesh to good triangles of the size that they had in the first frame."""
        if not (self.settings.remesh and can_remesh()) or self.past.state is None:
            return mesh
        rules = RULES.meshes
        poor = float((smallest_angles(mesh) < rules.poor_angle).mean()) > rules.poor_share
        change = mesh.median_edge() / self.past.edge
        if poor or not 1 / rules.edge_change < change < rules.edge_change:
            return remesh(mesh, self.past.edge, passes=2).mesh
        return mesh

    # -------------------------------------------------------------------------------- divisions

    def _divide(
        self,
        frame: Frame,
        state: FitState,
        early: FitState | None,
        events: list[Event],
    ) -> Generator[TrackState, None, FitState]:
        """Put walls into cells whose residual shows one, as long as that explains the image better.

        At the end of a fit a single cell may have folded in along a wall and so explain it: if the
        residual shows nothing, that of its start (``early``) is used.
        """
        refused: set[int] = set()
        rounds = 0
        while rounds < RULES.divisions.rounds:
            before = Residual(frame.image, frame.known, self.grid, state)
            mesh, divided, calls = state.mesh, {}, proposals(before, state.mesh)
            folded = not calls and rounds == 0 and _alike(early, state)
            if folded:
                assert early is not None
                mesh, start = early.mesh, Residual(frame.image, frame.known, self.grid, early)
                calls = [w for w in proposals(start, mesh) if has_folded(start, before, w)]
            for found in calls:
                if found.cell in refused:
                    continue
                pair = self.past.two_new_cells()
                try:
                    mesh = divide_region(mesh, found.cell, found.point, found.normal, pair)
                except InputError:  # a plane that does not cut the cell in one loop
                    refused.add(found.cell)
                    continue
                self.past.named(pair)
                divided[found.cell] = (pair, found)
            if not divided:
                break
            new, _ = yield from self._fit(frame, Start("division", mesh, 0.0, float("nan")))
            after = Residual(frame.image, frame.known, self.grid, new)
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
                events.append(Event("divided", frame.number, cell, text, pair))
        return state

    def _without_gone(self, frame: int, state: FitState, events: list[Event]) -> Mesh | None:
        """Remove cells that have gone, whose tracks end; None if none is left."""
        mesh: Mesh | None = state.mesh
        present = set(state.mesh.region_ids().tolist())
        ended = {e.cell for e in events if e.kind == "divided"}
        lost = {
            c: "it was squeezed out between its neighbours"
            for c in self.past.looks
            if c not in present and c not in ended
        }
        lost |= gone(state.mesh, self.past.largest, self.grid, min(state.optics.sigma_um))
        for cell, why in lost.items():
            events.append(Event("ended", frame, cell, f"cell {cell} ends: {why}"))
            if cell in present and mesh is not None:
                mesh = remove_region(mesh, cell)
        return mesh


def _alike(early: FitState | None, state: FitState) -> bool:
    """Whether there is an early state, with the same cells."""
    return early is not None and np.array_equal(early.mesh.region_ids(), state.mesh.region_ids())
