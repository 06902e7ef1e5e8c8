"""Judges a finished fit: how good it and each of its cells are, and what it left out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.doing import doing
from ..common.words import joined, sentence
from ..evidence.fit_facts import verdict_of
from ..evidence.residual import Residual, analyse_residual
from ..evidence.unseeded_objects import Stray, strays
from ..evidence.verdict import Verdict
from ..evidence.verdict_rules import RULES as VERDICT
from ..evidence.voxel_variance import Variance, voxel_variance
from ..fitting import FitState, counted_voxels
from ..fitting.job import FitInput
from ..fitting.model.checks import check_image
from ..fitting.model.hot_voxels import without_hot
from ..geometry import Mesh
from ..measure import measure
from ..measure.of_fit import known_of
from ..runs.track_run import TrackRun
from ..tracking import FrameResult, TrackState, track

_LISTED = 6  # cells named in a sentence; if there are more, only their number is told


@dataclass(frozen=True, eq=False)
class Judged:
    """How good the end of a fit and each of its cells are.

    found : what the fit leaves unexplained.
    cells : all measurements of each cell, by region.
    strays : bright things in the image that have no cell.
    """

    found: Residual
    verdict: Verdict
    cells: Mapping[int, Mapping[str, Any]]
    strays: tuple[Stray, ...] = ()


@dataclass(frozen=True, eq=False)
class Compared:
    """The rendered image of a state, and how it differs from the measured one.

    rendered : (Z, Y, X).
    residual : (Z, Y, X) measured minus rendered, in standard deviations of the noise.
    judged : how good the end of the fit is.
    """

    rendered: NDArray[np.float32]
    residual: NDArray[np.float32]
    judged: Judged | None = None


class Spread:
    """The noise of a measured image, estimated only once; used by one thread at a time."""

    def __init__(self) -> None:
        self._of: Any = None
        self._variance: Variance | None = None

    def variance(self, job: FitInput) -> Variance:
        """Return the function from a voxel's expected value to its variance, for a job's image."""
        if self._variance is None or self._of is not job.image:
            pixels, known = check_image(job.image, job.grid)
            self._of, self._variance = job.image, voxel_variance(job.image, pixels, known)
        return self._variance


def compared(rendered: NDArray[np.float32], job: FitInput, spread: Spread) -> Compared:
    """Compare an image that is rendered already with the measured one."""
    noise = np.sqrt(spread.variance(job)(rendered))
    return Compared(rendered, ((job.image - rendered) / noise).astype(np.float32))


def judge(state: FitState, job: FitInput, spread: Spread) -> Compared:
    """Render the end of a fit, compare it with the measured image, and judge it."""
    rendered = state.rendered()
    given = state.showing(rendered)
    variance = spread.variance(job)
    found = analyse_residual(job.image, job.grid, given, counted=job.counted, variance=variance)
    verdict = verdict_of(job, given, found, rendered)
    cells = _measured(state, job, found, verdict)
    everywhere = analyse_residual(job.image, job.grid, given, variance=variance)
    alone = strays(everywhere.spots, state.mesh, state.optics)
    both = compared(rendered, job, spread)
    return replace(both, judged=Judged(found, verdict, cells, alone))


def judged_frame(
    done: FrameResult, state: FitState, job: FitInput, image: NDArray[Any], before: Mesh
) -> FrameResult:
    """Return a tracked frame with its grade.

    Parameters
    ----------
    state : the last state of its fit.
    job : the fit of the first frame.
    image : (Z, Y, X) of the frame.
    before : the mesh that its fit began with.
    """
    counted = None
    if job.kind == "image":  # as tracking does, since other cells lie beside those with a seed
        counted = counted_voxels(image, job.grid, before, state.optics)
    seen, _ = without_hot(image)
    own = replace(job, image=seen, mesh=before, counted=counted)
    verdict = verdict_of(own, state, analyse_residual(seen, job.grid, state, counted=counted))
    judged = verdict.by_region()
    return replace(done, grade=verdict.grade, judgement=verdict.sentence(), judged=judged)


def judged_track(
    images: Sequence[Any] | Any, job: FitInput, done: Sequence[FrameResult] = ()
) -> Iterator[TrackState]:
    """Track as :func:`~napari_deltamic.tracking.track` does; each frame that is done has its grade.

    Parameters
    ----------
    images : all frames, (Z, Y, X) each, read when asked for.
    job : the fit of the first frame, with the settings of the whole.
    done : frames of an earlier run to go on from.

    Raises
    ------
    InputError
        As ``track``, at once.
    """
    settings = job.settings
    assert isinstance(settings, TrackRun)
    states = track(
        images,
        job.grid,
        job.mesh,
        job.optics,
        settings.fit,
        tracking=settings.track,
        effects=settings.scene.effects,
        shared_ground=job.kind == "image",  # cells without a seed would attract the others
        done=done,
    )
    before = next((r.mesh for r in reversed(done) if r.mesh is not None), job.mesh)
    return _graded(states, images, job, before)


def _graded(
    states: Iterable[TrackState], images: Sequence[Any] | Any, job: FitInput, before: Mesh
) -> Iterator[TrackState]:
    """Yield the same states; each frame that is done has its grade."""
    for state in states:
        last = state.last_fit
        if state.done is None or last is None:
            yield state
            continue
        doing("judging the shapes")
        result = judged_frame(state.done, last, job, images[state.frame], before)
        before = last.mesh
        yield replace(state, done=result)


def _measured(
    state: FitState, job: FitInput, found: Residual, verdict: Verdict
) -> dict[int, dict[str, Any]]:
    """Return all measurements of each cell, and how well it is explained."""
    judgements = verdict.by_region()
    about = known_of(state, job.grid, explained=found.shares(), judgements=judgements)
    table = measure(state.mesh, about).cells
    rows = {int(row["region"]): dict(row) for row in table.rows if row["region"] is not None}
    for cell in found.cells:
        if cell.region in rows:
            rows[cell.region]["residual_z"] = cell.z
    return rows


def told(known: Judged, length: str = "µm", *, stopped: bool = False) -> str:
    """Say the grade, how much of the image the cells explain, and why it is not better.

    length : unit of lengths: µm, or voxels if their size is not known.
    stopped : whether a user has stopped the fit.
    """
    verdict: Verdict = known.verdict
    explained = known.found.explained
    if explained is None:
        return "Nothing around the cells is brighter or darker than noise."
    grade = verdict.grade.capitalize()
    head = f"Stopped before it converged, so {grade.lower()}" if stopped else grade
    text = f"{head}: the cells explain {explained:.0%} of the signal around them"
    off = verdict.usual_error_um
    if off is not None:
        much = f"{off:.2g} voxels" if length == "voxels" else f"{1000 * off:.0f} nm"
        text += f"; they are off by about {much}"
    text += "."
    if stopped:  # the reasons would be those of an unfinished fit
        better = "" if explained > VERDICT.good else ", or start from better cells"
        return f"{text} Continue it{better}."
    # How much is explained is said already, and the cells have reasons of their own.
    reasons = [r.text for r in verdict.reasons if r.kind not in ("explained", "cells")]
    if any(reason.kind == "cells" for reason in verdict.reasons):
        reasons.append(f"{_of_cells(verdict)}: choose one in the table to see why")
    text += "".join(f" {sentence(reason)}" for reason in reasons)
    if verdict.grade == "poor":
        text += " Look at the surfaces before you use them."
    return text


def _of_cells(verdict: Verdict) -> str:
    """Say which cells are fair and which are poor, or how many if they are many."""
    told_of = []
    for grade in ("fair", "poor"):
        regions = [cell.region for cell in verdict.cells if cell.grade == grade]
        if len(regions) == len(verdict.cells) > 1:
            which = "both" if len(regions) == 2 else f"all {len(regions)}"
            told_of.append(f"{which} cells are {grade}")
        elif len(regions) > _LISTED:
            told_of.append(f"{len(regions)} of {len(verdict.cells)} cells are {grade}")
        elif regions:
            several = len(regions) > 1
            names = joined([str(region) for region in regions])
            told_of.append(f"cell{'s' * several} {names} {'are' if several else 'is'} {grade}")
    return ", ".join(told_of)
