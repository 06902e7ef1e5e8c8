"""Walls between cells that the image hardly shows: where labels cut one cell in two.

Nothing shines there, and both sides are equally bright. The prior on shape holds such a wall where
it began, so that no other fact about the fit reveals it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.triple import geometric_mean
from ..fitting.model.state import FitState
from ..geometry.mesh import OUTSIDE


@dataclass(frozen=True)
class UnseenWallRules:
    """When a wall counts as unseen.

    Attributes
    ----------
    dim
        Largest peak of its membrane over that of the other surfaces of its cells. Measured
        where labels were cut in two: 0.09 to 0.42 (nine cells); where walls are real: 0.64 or more
        in simulated tissues; of 235 in a gland one had 0.33, the next 0.44.
    step
        Largest difference of the insides over what the other surfaces show. Measured where labels
        were cut in two: up to 0.08, 0.64 with chromatin, which the image cannot tell from two
        nuclei.
    area
        Least area, widths of the PSF squared: a smaller wall is hardly seen in any case. Three
        squared, from which on amounts on walls are measured (``benchmarks.channel``).
    """

    dim: float = 0.43
    step: float = 0.1
    area: float = 9.0


RULES = UnseenWallRules()


def unseen_walls(state: FitState) -> dict[int, int]:
    """The neighbour of each cell behind the largest of its walls that the image hardly shows.

    Cells without such a wall are left out, as are pairs of cells that have no other surface.
    """
    mesh, areas = state.mesh, state.mesh.areas()
    width = geometric_mean(state.optics.sigma_um)
    inner, outer = (
        state.light.interior * state.light.of_cells(side) * (side != OUTSIDE)
        for side in mesh.regions.T
    )
    # Across a surface, a membrane looks like the PSF, an inside like a step.
    peak = state.light.membrane * np.asarray(state.density) / (np.sqrt(2 * np.pi) * width)
    step = np.abs(inner - outer)
    pairs, wall = mesh.interfaces()
    area = np.bincount(wall, areas, len(pairs))
    mean_peak, mean_step = (
        np.bincount(wall, areas * each, len(pairs)) / np.maximum(area, 1e-300)
        for each in (peak, step)
    )
    faces = mesh.faces_by_region()
    found: dict[int, tuple[float, int]] = {}
    for k in np.flatnonzero((pairs != OUTSIDE).all(1) & (area > RULES.area * width**2)):
        one, other = (int(region) for region in pairs[k])
        around = np.concatenate([faces[one], faces[other]])
        around = around[wall[around] != k]
        weights = areas[around]
        if not weights.sum() > 0:
            continue
        usual = np.average(peak[around], weights=weights)
        shown = np.average(np.hypot(peak, step)[around], weights=weights)
        if mean_peak[k] > RULES.dim * usual or mean_step[k] > RULES.step * shown:
            continue
        for cell, neighbour in ((one, other), (other, one)):
            found[cell] = max(found.get(cell, (0.0, 0)), (float(area[k]), neighbour))
    return {cell: neighbour for cell, (_, neighbour) in found.items()}
