"""Parts of a cell beyond a neck that its start did not have: neighbours that it may have swallowed.

A thin outgrowth is too thin for the image to show (:mod:`...evidence.outgrowths`); these parts are
thick again further out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, maximum_filter, maximum_position

from ...common.triple import triple
from ...geometry.labels.label_repair import label_boxes
from ...geometry.labels.voxels import highest, voxel_labels
from ...geometry.mesh import Mesh
from ...optics import Optics
from ...scene import Grid
from .bright_regions import Labels, parted


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


@dataclass(frozen=True, eq=False)
class BeyondNecks:
    """Parts of cells beyond necks.

    Attributes
    ----------
    cells
        (Z, Y, X) regions of the mesh.
    parts
        (Z, Y, X) the same, only in such parts.
    middles
        Of the thickest part of each cell that has one, um, Z Y X.
    """

    cells: Labels
    parts: Labels
    middles: dict[int, tuple[float, float, float]]


def beyond_necks(start: Mesh, mesh: Mesh, grid: Grid, optics: Optics) -> BeyondNecks:
    """The parts of cells beyond necks.

    start : where the fit began; a part whose middle lay in it does not count.
    """
    given = grid.shape, grid.voxel_size, grid.origin
    labels, before = voxel_labels(mesh, *given), voxel_labels(start, *given)
    size, first = np.asarray(grid.voxel_size), np.asarray(grid.origin)
    found = BeyondNecks(labels, np.zeros_like(labels), {})
    for region, box in label_boxes(labels):
        own, held = (np.pad(some[box] == region, 1) for some in (labels, before))
        depth = distance_transform_edt(own, sampling=size / np.asarray(optics.sigma_um))
        new = np.where(held, 0, depth)
        if not ((new > RULES.thick) & (new >= maximum_filter(depth, 3))).any():
            continue  # no part is deepest outside the start: saves most of the time
        parts = parted(depth, RULES.narrow)
        count = int(parts.max())
        thick = highest(depth, parts, count)
        beyond = (highest(new, parts, count) == thick) & (thick > RULES.thick)
        inside = np.bincount(parts.ravel(), held.ravel())[1:]
        beyond[inside.argmax() if inside.any() else thick.argmax()] = False  # the cell itself
        if beyond.any():
            thickest = int(np.where(beyond, thick, 0).argmax())
            at = maximum_position(new, parts, thickest + 1)
            corner = np.array([side.start for side in box]) - 1
            found.middles[region] = triple((np.asarray(at) + corner) * size + first)
            lost = np.append(False, beyond)[parts][1:-1, 1:-1, 1:-1]
            found.parts[box][lost] = region
    return found
