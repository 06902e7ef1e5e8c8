"""Thin outgrowths of cells: what a surface makes of bright specks, or a neighbour, beside it."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median

import numpy as np
from scipy.ndimage import distance_transform_edt

from ..geometry.labels.label_repair import label_boxes
from ..geometry.labels.voxels import voxel_labels
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene import Grid


@dataclass(frozen=True)
class OutgrowthRules:
    """What counts as one; in widths of the PSF, axis by axis.

    Attributes
    ----------
    share
        Of the cell's volume that may be thin: flat cells are more.
    thin
        Half its thickness, at most: the image shows little of what is thinner.
    length
        How far it reaches out of the cell, at least. Measured on 183 random scenes (``--anything``
        of benchmarks.defaults): up to 2.0 where the error was below 0.3 voxel, but 4.5 to 6.6 in
        three of those; 2.6 to 22 in eight cells of five scenes that were 0.5 to 0.9 voxel off, one
        of which nothing else told.
    usual
        How much further than the median of all cells, at least. Chosen: in an embryo of 56 cells
        the median is 3.5, as walls between cells end in sharp edges there, and only one cell
        reaches out twice as far.
    crowd
        Cells, at least, whose median says what is usual. Chosen.
    """

    share: float = 0.3
    thin: float = 1.5
    length: float = 2.3
    usual: float = 2.0
    crowd: int = 5


RULES = OutgrowthRules()


def outgrowths(mesh: Mesh, grid: Grid, optics: Optics) -> dict[int, tuple[float, float, float]]:
    """Where the longest thin outgrowth of each cell ends, um, Z Y X; cells without are left out.

    Cells that are thin as a whole have none, and neither have cells that reach out as others do.
    """
    labels = voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin)
    spacing = np.asarray(grid.voxel_size) / np.asarray(optics.sigma_um)
    reaches: dict[int, float] = {}
    ends: dict[int, tuple[float, float, float]] = {}
    for region, box in label_boxes(labels):
        own = np.pad(labels[box] == region, 1)
        thick = distance_transform_edt(own, sampling=spacing) > RULES.thin
        if not thick.any():
            continue
        away = distance_transform_edt(~thick, sampling=spacing) - RULES.thin
        out = np.where(own, away, 0.0)
        if (out > 0).sum() > RULES.share * own.sum():
            continue
        at = np.unravel_index(int(out.argmax()), own.shape)
        first = np.array([s.start for s in box]) - 1
        place = (np.asarray(at) + first) * np.asarray(grid.voxel_size) + np.asarray(grid.origin)
        z, y, x = place.tolist()
        reaches[region], ends[region] = float(out.max()), (z, y, x)
    usual = median(reaches.values()) if len(reaches) >= RULES.crowd else 0.0
    least = max(RULES.length, RULES.usual * usual)
    return {region: end for region, end in ends.items() if reaches[region] >= least}
