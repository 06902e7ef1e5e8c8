"""Parts of a cell beyond a neck that its start did not have: neighbours that it may have swallowed.

A thin outgrowth is too thin for the image to show (:mod:`.outgrowths`); these parts are thick again
further out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, maximum, maximum_position

from ..fitting.voxels.bright_regions import parted
from ..geometry.labels.label_repair import label_boxes
from ..geometry.labels.voxels import voxel_labels
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene import Grid


@dataclass(frozen=True)
class NeckRules:
    """What counts as a neck.

    Attributes
    ----------
    narrow
        Largest thickness of the neck over that of the thinner part. Measured: 0.5 to 0.7 tell a
        cell that had swallowed a small neighbour from 61 that had not; only from 0.65 on, a nucleus
        that had swallowed specks is told as well. No bound from 0.5 to 0.8 finds a neck in cells
        less than 0.78 voxel off in 140 random scenes; in an embryo of 56 cells, 0.6 and more name
        one, which bulges out through the hull.
    thick
        Least half thickness of a part, widths of the PSF along each axis. Measured: 2.2 in the same
        cell; corners of other cells have up to 1.2.
    """

    narrow: float = 0.65
    thick: float = 1.5


RULES = NeckRules()


def beyond_necks(
    start: Mesh, mesh: Mesh, grid: Grid, optics: Optics
) -> dict[int, tuple[float, float, float]]:
    """The middle of the thickest part beyond a neck of each cell, um, Z Y X; only cells with one.

    start : where the fit began; a part whose middle lay in it does not count.
    """
    given = grid.shape, grid.voxel_size, grid.origin
    labels, before = voxel_labels(mesh, *given), voxel_labels(start, *given)
    size, first = np.asarray(grid.voxel_size), np.asarray(grid.origin)
    found: dict[int, tuple[float, float, float]] = {}
    for region, box in label_boxes(labels):
        own = np.pad(labels[box] == region, 1)
        depth = distance_transform_edt(own, sampling=size / np.asarray(optics.sigma_um))
        new = np.where(np.pad(before[box] == region, 1), 0, depth)
        if new.max() <= RULES.thick:
            continue
        parts = parted(depth, RULES.narrow)
        numbers = np.arange(1, parts.max() + 1)
        thick = np.asarray(maximum(depth, parts, numbers))
        beyond = (np.asarray(maximum(new, parts, numbers)) == thick) & (thick > RULES.thick)
        held = np.bincount(parts.ravel(), np.pad(before[box] == region, 1).ravel())[1:]
        beyond[held.argmax() if held.any() else thick.argmax()] = False  # the cell itself
        if beyond.any():
            thickest = int(np.where(beyond, thick, 0).argmax())
            at = maximum_position(new, parts, numbers[thickest])
            corner = np.array([side.start for side in box]) - 1
            z, y, x = ((np.asarray(at) + corner) * size + first).tolist()
            found[region] = (z, y, x)
    return found
