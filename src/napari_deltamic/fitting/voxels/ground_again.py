"""Which voxels may count, asked again where a fit has ended.

Before a fit, that follows from where it starts (:mod:`.voxel_ownership`). From a start in the dark
middle of a bright layer, or far beside the cell, light of the cell itself may be taken for that of
another object; the surface then ends within that light. From where it has ended, most of the cell
is known, and what is left of such light is as near as its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...scene.render import offset
from ..model.fitted import Fitted
from ..model.problem import Problem
from .voxel_ownership import counted_voxels, protruding, surface_shares


@dataclass(frozen=True)
class GroundRules:
    """When a fit goes on with other voxels.

    Attributes
    ----------
    own
        Share of the surface of a cell that lay in light of other objects and, asked again, lies in
        its own: what a verdict says of a surface in such light (:mod:`..evidence.verdict`).
    protruding
        Of the voxels of cells: as many of fins and fingers must have been taken for other objects.
        Chosen. Measured on a fish that was fitted from a PSF 0.4 times as wide: 0.33; none in 128
        other scenes but for one of thin cells.
    times
        How often a fit goes on so, at most, and how often without neighbours
        (:mod:`.letting_go`); chosen.
    """

    own: float = 0.1
    protruding: float = 0.02
    times: int = 2


RULES = GroundRules()


def ground_again(problem: Problem, fitted: Fitted) -> Problem | None:
    """The problem with the voxels that are cells' own by now; None where hardly any came to them.

    None that counted is lost.
    """
    if problem.foreign is None or not problem.foreign.any():
        return None
    if problem.anew is None or problem.anew >= RULES.times:
        return None
    mesh, grid = fitted.mesh, problem.grid
    added, measured = offset(fitted.effects, grid), problem.counted | problem.foreign
    image = problem.image if added is None else problem.image - added.numpy()
    image = np.where(measured, image, np.nan).astype(np.float32)
    given = image, grid, mesh, fitted.optics
    fins = protruding(*given) & problem.foreign
    room = abs(sum(mesh.volumes().values())) / np.prod(grid.voxel_size)
    if fins.sum() > RULES.protruding * room:
        return with_ground(problem, problem.counted | counted_voxels(*given), problem.anew + 1)
    before = surface_shares(problem.counted, grid, mesh)
    if all(1 - share < RULES.own for share in before.values()):
        return None  # however many voxels came to them
    counted = problem.counted | (counted_voxels(*given) & measured)
    now = surface_shares(counted, grid, mesh)
    if all(now[cell] - before[cell] < RULES.own for cell in before):
        return None
    return with_ground(problem, counted, problem.anew + 1)


def with_ground(problem: Problem, counted: NDArray[np.bool_], anew: int) -> Problem:
    """The same with other voxels that count, found anew so often; the rest is foreign.

    Neighbours that were let go stay foreign.
    """
    measured = problem.counted if problem.foreign is None else problem.counted | problem.foreign
    counted = measured & counted
    if problem.let_go is not None:
        counted &= problem.let_go == 0
    return replace(problem, counted=counted, foreign=measured & ~counted, anew=anew)
