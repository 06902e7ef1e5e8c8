"""Whether cells lie in light that is not theirs, such as nuclei in cytoplasm: a local background.

A PSF that is wider than the blur of the image is a sign of it. So a few steps are taken with the
local background subtracted, through a PSF narrower than first estimated; if that explains clearly
more beside the surfaces, and the PSF is not still wide, the fit starts again with it. Beside them,
the local background is continued from further away, so it cannot win by following the image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...common.doing import doing
from ...common.triple import Triple as Widths
from ...common.triple import geometric_mean
from ...geometry.distance_transform import distance_transform
from ...geometry.labels.voxels import voxel_labels
from ...geometry.mesh import FloatArray, Mesh
from ...optics import GaussianMixturePSF, GaussianPSF, Optics
from ...optics.narrow import RULES as NARROW
from ..model.fitted import Fitted
from ..model.problem import Problem
from ..objective.fit_objective import Objective, Terms
from ..solvers.preconditioner import Preconditioners
from ..voxels.local_background import spacing_for, with_local_background
from .light_cone import may_change
from .rival_structures import begun as objective_of
from .rival_structures import stepped

IS_LIT = (
    "light around the cells is not theirs, like cytoplasm around nuclei: the fit restarts with a "
    "local background"
)


@dataclass(frozen=True)
class SurroundingsRules:
    """When a local background is tried, and when it stays.

    Measured on nuclei in cytoplasm that shines 0.05 to 0.4 times as brightly (``lit-nuclei`` of
    benchmarks.defaults).

    Attributes
    ----------
    wider
        Times the width first estimated: a fitted PSF that is wider than this along any axis may be
        making up for what surrounds the cells. Chosen; measured: 1.1 to 2.6 where it was.
    narrower
        The width of the PSF with which the trial begins, over the one first estimated. Chosen: the
        spectrum falls faster for insides than for membranes, and faster still where they lie in
        light, so that its width is 1.4 to 2.2 times too large. Errors measured on nine scenes: 0.4
        to 1.7 voxels with 0.6, 0.3 to 0.8 with 0.5, 0.2 to 0.4 with 0.4.
    beside
        Widths of that PSF: voxels nearer to a surface than this are compared. Chosen.
    left
        Squared residuals there, over those without a local background: the geometric mean of both
        ratios, for voxels beside either fit's surfaces, must be below this, and each below 1.
        Chosen; measured: 0.3 to 0.96 in such nuclei, 0.99 to 1.3 elsewhere.
    still_wider
        Times the width first estimated, as geometric means over the axes: where the PSF of a trial
        is wider than this, the local background has not explained why it was wide, and is light
        of the cells themselves. Chosen; measured: 0.6 to 1.1 in such nuclei, 1.4 to 1.5 around
        nuclei with chromatin in smoothed stacks, which ended 8 % too small.
    hopeless
        What ``left`` compares, before the first step: where the lower of both ratios is above
        this, the trial ends there. Chosen; measured: 0.4 to 2.0 where a local background stayed,
        1.0 to 11 elsewhere.
    """

    wider: float = 1.05
    narrower: float = 0.4
    beside: float = 1.2
    left: float = 0.97
    still_wider: float = 1.25
    hopeless: float = 4.0


RULES = SurroundingsRules()


def local_background_instead(
    problem: Problem,
    begun: Mesh,
    terms: Terms,
    objective: Objective,
    against: Objective | None = None,
) -> tuple[tuple[Problem, Optics] | None, int]:
    """The problem with its local background subtracted, if clearly better; evaluations spent.

    Parameters
    ----------
    problem
        What the fit explains.
    begun
        Where it began, since at its end surfaces may lie anywhere in what surrounds the cells.
    terms, objective
        Of the fit at its end, before its last level is left.
    against
        The objective of the fit that followed with another kind of PSF; None: compare with it.
    """
    fitted = objective.fitted
    if not _may_be_tried(problem, terms, objective, against is None):
        return None, 0
    first = fitted.first_optics
    if may_change(terms, fitted):
        first = _narrower(first, terms.level.grid.voxel_size)
    structure = "interior" if terms.settings.structure == "auto" else fitted.structure
    start = Fitted.begun(begun, first, fitted.effects, fitted.shape.model, structure)
    before, taken = against or objective, 0
    own: NDArray[np.floating] | None = None
    while True:
        without = with_local_background(problem, start.mesh, first.sigma_um, start.effects, own)
        if without is None:
            return None, taken
        rival = _posed(without, terms, start)
        if min(_left_over(rival, before)) > RULES.hopeless:
            return None, taken + rival.evaluations()
        rival, more = stepped(rival)
        taken += more
        if rival.now.light.interior <= 0:  # a thick bright layer, not light around cells
            return None, taken
        if own is not None:
            stays = not _still_wide(rival, terms, fitted) and explains_more_beside(rival, before)
            return ((without, first) if stays else None), taken
        start, own = rival.fitted, rival.own_light()  # known, the second time


def _posed(without: Problem, terms: Terms, start: Fitted) -> Objective:
    """The objective of a start, local background subtracted."""
    first, effects = start.first_optics, start.effects
    level, _ = without.levels(first, terms.settings, effects, 1.0, effects.spread)
    return objective_of(replace(terms, level=level), start, Preconditioners())


def _narrower(first: Optics, voxel_size: Widths) -> Optics:
    """The Gaussian with which a trial begins."""
    least = NARROW.voxels * np.asarray(voxel_size)
    return GaussianPSF(np.maximum(RULES.narrower * np.asarray(first.sigma_um), least))


def _may_be_tried(problem: Problem, terms: Terms, objective: Objective, alone: bool) -> bool:
    """Whether a PSF or a shape may stand in for what surrounds the cells.

    alone : whether no other kind of PSF has followed.
    """
    fitted, settings = objective.fitted, terms.settings
    if problem.local_background is not None or settings.structure == "membrane":
        return False
    if terms.second is not None or objective.posed.whole.full is not None:
        return False
    if not may_change(terms, fitted):  # the PSF is given: shapes make up for what surrounds them
        found = isinstance(fitted.first_optics, GaussianMixturePSF)
        return fitted.structure != "membrane" and not found
    if not alone:
        return True
    told = zip(fitted.optics.sigma_um, fitted.first_optics.sigma_um, strict=True)
    return any(now > RULES.wider * first for now, first in told)


def _still_wide(rival: Objective, terms: Terms, fitted: Fitted) -> bool:
    """Whether a trial's PSF is far wider than a fit first estimated it, if that fits the PSF."""
    now, first = rival.fitted.optics.sigma_um, fitted.first_optics.sigma_um
    wide = geometric_mean(now) > RULES.still_wider * geometric_mean(first)
    return wide and may_change(terms, fitted)


def explains_more_beside(one: Objective, other: Objective) -> bool:
    """Whether one leaves clearly less than another, beside the surfaces of both."""
    left = _left_over(one, other)
    return max(left) < 1 and geometric_mean(left) < RULES.left


def _left_over(one: Objective, other: Objective) -> list[float]:
    """Ratios of squared residuals, one to the other, beside the surfaces of each."""
    spacing = spacing_for(one.terms.level.grid, one.fitted.first_optics.sigma_um)
    counted = (one.terms.level.counted & other.terms.level.counted).cpu().numpy()
    found = []
    for mesh in (one.fitted.mesh, other.fitted.mesh):
        near = counted & (_from_surface(mesh, one, spacing) <= RULES.beside)
        mine, its = (_left(objective, near) for objective in (one, other))
        found.append(mine / its if its > 0 else 1.0)  # where no voxel counts
    return found


def _from_surface(mesh: Mesh, one: Objective, spacing: FloatArray) -> FloatArray:
    """(Z, Y, X) widths of the PSF from a surface, on either side."""
    grid = one.terms.level.grid
    inside = voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin) > 0
    doing()
    both = (distance_transform(mask, spacing) for mask in (inside, ~inside))
    return np.asarray(sum(both))


def _left(objective: Objective, near: NDArray[np.bool_]) -> float:
    """Squares left in some voxels (Z, Y, X)."""
    seen, shown = objective.seen_and_shown()
    return float(np.square(seen[near] - shown[near]).sum())
