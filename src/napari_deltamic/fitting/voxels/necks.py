"""Parts of a cell beyond a neck that its start did not have: neighbours that it may have swallowed.

A thin outgrowth is too thin for the image to show (:mod:`...evidence.outgrowths`); these parts are
thick again further out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter, maximum_position

from ...common.triple import triple
from ...geometry.distance_transform import distance_transform
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
    seen
        Share of what the image shows of the cell that must lie in such parts: what bulges beyond
        its border is a guess, and no neighbour. Chosen; measured: 0.28 in a cell with a neighbour
        that the border cuts, less than 0.02 in a nucleus with none.
    """

    narrow: float = 0.65
    thick: float = 1.5
    seen: float = 0.1


RULES = NeckRules()


@dataclass(frozen=True, eq=False)
class BeyondNecks:
    """Parts of cells beyond necks.

    Attributes
    ----------
    grid
        Of the image, and as far beyond its border as a part has to be thick.
    cells
        (Z, Y, X) regions of the mesh there.
    parts
        (Z, Y, X) the same, only in such parts.
    middles
        Of the thickest part of each cell that has one, um, Z Y X.
    """

    grid: Grid
    cells: Labels
    parts: Labels
    middles: dict[int, tuple[float, float, float]]


def beyond_necks(start: Mesh, mesh: Mesh, grid: Grid, optics: Optics) -> BeyondNecks:
    """The parts of cells beyond necks.

    start : where the fit began; a part whose middle lay in it does not count.
    """
    # The border of the image cuts neighbours, which are as thick beyond it.
    around = widened(grid, optics)
    given = around.shape, around.voxel_size, around.origin
    labels, before = voxel_labels(mesh, *given), voxel_labels(start, *given)
    size, first = np.asarray(around.voxel_size), np.asarray(around.origin)
    found = BeyondNecks(around, labels, np.zeros_like(labels), {})
    seen = np.zeros(around.shape, bool)
    seen[within(around, grid)] = True
    for region, box in label_boxes(labels):
        own, held = (np.pad(some[box] == region, 1) for some in (labels, before))
        depth = distance_transform(own, size / np.asarray(optics.sigma_um))
        new = np.where(held, 0, depth)
        if not ((new > RULES.thick) & (new >= maximum_filter(depth, 3))).any():
            continue  # no part is deepest outside the start: saves most of the time
        parts = parted(depth, RULES.narrow)
        count = int(parts.max())
        thick = highest(depth, parts, count)
        beyond = (highest(new, parts, count) == thick) & (thick > RULES.thick)
        inside = np.bincount(parts.ravel(), held.ravel())[1:]
        beyond[inside.argmax() if inside.any() else thick.argmax()] = False  # the cell itself
        shown = np.bincount(parts[own & np.pad(seen[box], 1)], minlength=count + 1)[1:]
        if beyond.any() and shown[beyond].sum() > RULES.seen * shown.sum():
            thickest = int(np.where(beyond, thick, 0).argmax())
            at = maximum_position(new, parts, thickest + 1)
            corner = np.array([side.start for side in box]) - 1
            found.middles[region] = triple((np.asarray(at) + corner) * size + first)
            lost = np.append(False, beyond)[parts][1:-1, 1:-1, 1:-1]
            found.parts[box][lost] = region
    return found


def widened(grid: Grid, optics: Optics) -> Grid:
    """A grid that reaches beyond each border of another one, by as much as a part is thick."""
    size = np.asarray(grid.voxel_size)
    room = np.ceil(2 * RULES.thick * np.asarray(optics.sigma_um) / size).astype(int)
    z, y, x = (np.asarray(grid.shape) + 2 * room).tolist()
    return Grid((z, y, x), grid.voxel_size, triple(np.asarray(grid.origin) - room * size))


def within(wide: Grid, grid: Grid) -> tuple[slice, ...]:
    """The box of a grid in its :func:`widened` one."""
    sides = zip(wide.shape, grid.shape, strict=True)
    return tuple(slice((n - k) // 2, (n + k) // 2) for n, k in sides)
