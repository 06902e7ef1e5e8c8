"""The local background of cells: light around them that is not theirs, such as cytoplasm of nuclei.

A fit has one background. Where the cytoplasm around nuclei also shines, a PSF that is much too wide
makes up for it, and nuclei come out wrong in size. Further from the surfaces than their own light
reaches, the image shows what surrounds them; from there it is continued across the cells, and
subtracted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from numpy.typing import NDArray

from ...common.doing import doing
from ...geometry.distance_transform import distance_transform
from ...geometry.gaussian_blur import blurred
from ...geometry.labels.voxels import voxel_labels
from ...geometry.mesh import FloatArray, Mesh
from ...images.missing import filled
from ...scene import Grid
from ...scene.effects import Effects
from ...scene.render import offset
from ..model.problem import Problem

Widths = tuple[float, float, float]


@dataclass(frozen=True)
class LocalBackgroundRules:
    """Where the image shows a local background, and how it is continued.

    Distances are in widths of the PSF, and in voxels where these are wider.

    Attributes
    ----------
    beyond
        From a surface, and from light of other objects: further out, neither adds light. Chosen;
        errors measured on ten scenes of nuclei in cytoplasm, with the trial's narrow PSF: 0.3 to
        1.8 voxels with 2.5, 0.2 to 1.2 with 1.8, 0.2 to 0.5 with 1.5; as much with 1.3, but nuclei
        10 to 15 % too small.
    nearer
        From a surface, where the light of the cells is known and subtracted. Chosen, with beyond.
    smooth
        The narrowest blur of what is known, so that it does not follow the noise. Chosen: with a
        PSF one voxel wide, it leaves 1 % of the variance of the noise. At a third of this width, a
        local background was measured to explain more than the true PSF, which had long tails.
    share
        Of the weights of a blur, on known voxels: where more are, the blur is used; and of the
        voxels just beyond the cells: where fewer are known, there is no local background. Chosen.
    wider
        Width of each blur over that of the one before, if that reached too few. Chosen.
    widest
        Width of the widest blur over the first; deeper in, the nearest value is taken. Chosen.
    cut_off
        Standard deviations at which a blur is truncated; chosen.
    """

    beyond: float = 1.5
    nearer: float = 1.2
    smooth: float = 1.2
    share: float = 0.15
    wider: float = 1.5
    widest: float = 16.0
    cut_off: float = 3.0


RULES = LocalBackgroundRules()


def with_local_background(
    problem: Problem,
    mesh: Mesh,
    sigma: Widths,
    effects: Effects,
    own: NDArray[np.floating] | None = None,
) -> Problem | None:
    """The problem, local background subtracted; None where too little of it is seen.

    Parameters
    ----------
    problem
        With none yet.
    mesh
        The surfaces, um.
    sigma
        um, Z Y X: widths of the PSF.
    effects
        What they add to the image is not its local background.
    own
        (Z, Y, X) light of the cells, where it is known.
    """
    beyond = RULES.beyond if own is None else RULES.nearer
    spacing = spacing_for(problem.grid, sigma)
    foreign, grid = problem.foreign, problem.grid
    labels = voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin)
    doing()
    away = distance_transform(labels == 0, spacing)
    known = problem.counted & (away > beyond)
    if foreign is not None and foreign.any():
        doing()
        known &= distance_transform(~foreign, spacing) > RULES.beyond
    shell = (away > beyond) & (away < 2 * beyond)
    if known[shell].sum() <= RULES.share * shell.sum():
        return None
    added = offset(effects, grid, problem.frame)
    others = [part for part in (own, None if added is None else added.numpy()) if part is not None]
    found = _continued(problem.image - sum(others), known, RULES.smooth / spacing)
    # What is even belongs to the background of the fit.
    found -= np.float32(np.median(found[known]))
    return replace(problem, image=problem.image - found, local_background=found)


def spacing_for(grid: Grid, sigma: Widths) -> FloatArray:
    """(3,) sides of voxels in widths of the PSF, or in voxels where these are wider.

    Distances below one voxel cannot be told.
    """
    return np.minimum(np.asarray(grid.voxel_size) / np.asarray(sigma), 1.0)


def _continued(
    image: NDArray[np.floating], known: NDArray[np.bool_], widths: FloatArray
) -> NDArray[np.float32]:
    """(Z, Y, X) the smoothed image where it is known, continued to where it is not.

    Each voxel takes the narrowest blur that reaches enough known ones. widths : voxels.
    """
    values = np.where(known, image, 0).astype(np.float32)
    found = np.full(image.shape, np.nan, np.float32)
    for step in count():
        scale = RULES.wider**step
        if scale > RULES.widest or np.isfinite(found).all():
            break
        doing()
        total, share = (
            blurred(part, tuple(scale * widths), RULES.cut_off)
            for part in (values, known.astype(np.float32))
        )
        new = np.isnan(found) & (share > RULES.share)
        found[new] = total[new] / share[new]
    return np.asarray(filled(found), np.float32)
