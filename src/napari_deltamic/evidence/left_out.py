"""Bright parts beside cells whose insides shine, for example arms that a label left out.

Their light may be assigned to other objects (:mod:`~.fitting.voxels.voxel_ownership`), so the fit
cannot grow there, and its residual is judged without them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import (
    find_objects,
    gaussian_filter,
    label,
    maximum,
    maximum_filter1d,
    maximum_position,
    minimum,
    minimum_position,
    sum_labels,
)

from ..fitting.voxels.bright_regions import RULES as BRIGHT
from ..fitting.voxels.voxel_ownership import RULES as OWNERSHIP
from ..geometry.distance_transform import distance_transform, nearest_outside
from ..geometry.labels.label_repair import label_boxes
from ..geometry.labels.voxels import depths, voxel_labels
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene import Grid

Place = tuple[float, float, float]
Mask = NDArray[np.bool_]
_ALL_AROUND = np.ones((3, 3, 3))  # exact: neighbours across corners, too


@dataclass(frozen=True)
class LeftOutRules:
    """What counts as a part of a cell; lengths in widths of the PSF along each axis.

    Attributes
    ----------
    bright
        Least brightness beyond what the fit explains, over that of the inside of the nearest cell;
        as for light of other objects.
    above
        Least brightness in standard deviations of noise; likewise.
    smooth
        Width of the blur before; likewise.
    touching
        Largest distance from a surface at which it begins: beyond that there is a dark gap. Chosen.
    out
        Least distance that it reaches out: what lies nearer is a surface that is off. Chosen.
    around
        Its light counts up to this far around it, since it is blurred. Measured: three cells whose
        labels lacked 8, 21 and 27 % of their volume then seem to lack 8, 22 and 31 % of their
        light, and 3, 10 and 17 % without.
    thin
        Largest depth of the part over that of the cell: what is thicker is a cell without a label,
        as in packed nuclei. Measured: 0.2 to 0.5 in arms, 1.6 to 2.4 in nuclei without a label.
    """

    bright: float = OWNERSHIP.bright
    above: float = OWNERSHIP.above
    smooth: float = OWNERSHIP.smooth
    touching: float = 1.5
    out: float = 2.0
    around: float = 2.0
    thin: float = BRIGHT.thick


RULES = LeftOutRules()


def left_out(
    mesh: Mesh,
    grid: Grid,
    optics: Optics,
    seen: NDArray[np.floating],
    shown: NDArray[np.floating],
    background: float,
) -> dict[int, tuple[float, Place]]:
    """Light of bright parts that touch a cell and belong to none, for each cell that has any.

    Relative to the light of the cell; and where it is brightest, um, Z Y X.

    Parameters
    ----------
    seen, shown
        (Z, Y, X) the measured image, NaN where missing, and the rendered one, both without what
        effects add.
    background
        Background of the fit.
    """
    labels = voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin)
    boxes = dict(label_boxes(labels))
    spacing = np.asarray(grid.voxel_size) / np.asarray(optics.sigma_um)
    known, outside = np.isfinite(seen), labels == 0
    if not boxes or not (known & outside).any():
        return {}
    own = shown - background
    cells = {r: _cell(labels[box] == r, own[box], spacing) for r, box in boxes.items()}
    rest = np.where(known, seen - shown, 0.0).astype(np.float32)
    smooth = gaussian_filter(rest, RULES.smooth / spacing)
    dimmest = min(cell.inside for cell in cells.values())
    bright = outside & (smooth > max(RULES.bright * dimmest, noise_beside(smooth[known & outside])))
    box = _around_touching(bright, ~outside, boxes, spacing)
    if box is None:
        return {}
    near = _near(labels[box], cells, spacing)
    bright = bright[box] & (smooth[box] > RULES.bright * near.inside[near.cell])
    parts, count = label(bright, _ALL_AROUND)
    if not count:
        return {}
    numbers = np.arange(1, count + 1)
    of_cell = _arms_of(parts, numbers, near, spacing)
    light = _light(rest[box], parts, numbers, near.away > 0, spacing)
    whole = np.bincount(near.cell.ravel(), own[box].ravel())
    peaks = np.array(maximum_position(smooth[box], parts, numbers)) + [side.start for side in box]
    places = peaks * np.asarray(grid.voxel_size) + np.asarray(grid.origin)
    found: dict[int, tuple[float, Place]] = {}
    for k in np.unique(of_cell[of_cell >= 0]).tolist():
        arms = np.flatnonzero(of_cell == k)
        z, y, x = places[arms[light[arms].argmax()]].tolist()
        found[near.names[k]] = float(light[arms].sum() / max(float(whole[k]), 1e-30)), (z, y, x)
    return found


@dataclass(frozen=True)
class _Cell:
    """Brightness of the inner half of a cell, and depth of its middle in widths of the PSF."""

    inside: float
    deepest: float


def _cell(own: Mask, light: NDArray[np.floating], spacing: NDArray[np.floating]) -> _Cell:
    depth = depths(own, spacing)
    deepest = float(depth.max())
    return _Cell(max(float(light[depth > deepest / 2].mean()), 0.0), deepest)


def noise_beside(beside: NDArray[np.floating]) -> float:
    """Brightness above noise, judged by the darker half of the voxels beside cells."""
    low, middle = np.percentile(beside, (OWNERSHIP.low, 50))
    return RULES.above * float(middle - low) / OWNERSHIP.deviation


@dataclass(frozen=True, eq=False)
class _Near:
    """The cell nearest to each voxel.

    names, inside, deepest : of each cell that is nearest somewhere: region, and see :class:`_Cell`.
    cell : (Z, Y, X) index into these.
    away : (Z, Y, X) distance from it in widths of the PSF, 0 within.
    """

    names: list[int]
    inside: NDArray[np.floating]
    deepest: NDArray[np.floating]
    cell: NDArray[np.integer]
    away: NDArray[np.floating]


def _near(
    labels: NDArray[np.integer], cells: Mapping[int, _Cell], spacing: NDArray[np.floating]
) -> _Near:
    away, at = nearest_outside(labels == 0, spacing)
    nearest = np.take(labels, at)
    names = np.unique(nearest)
    inside, deepest = np.array([(cells[r].inside, cells[r].deepest) for r in names.tolist()]).T
    return _Near(names.tolist(), inside, deepest, np.searchsorted(names, nearest), away)


def _arms_of(
    parts: NDArray[np.integer],
    numbers: NDArray[np.integer],
    near: _Near,
    spacing: NDArray[np.floating],
) -> NDArray[np.integer]:
    """Index of the cell that each part may be an arm of; -1 for none."""
    begins, ends = (np.asarray(f(near.away, parts, numbers)) for f in (minimum, maximum))
    depth = distance_transform(parts > 0, spacing)
    thick = np.asarray(maximum(depth, parts, numbers))
    at = tuple(np.array(minimum_position(near.away, parts, numbers)).T)
    arms = (begins <= RULES.touching) & (ends >= RULES.out)
    cell = near.cell[at]
    arms &= thick <= RULES.thin * near.deepest[cell]
    return np.where(arms, cell, -1)


def _light(
    rest: NDArray[np.floating],
    parts: NDArray[np.integer],
    numbers: NDArray[np.integer],
    outside: Mask,
    spacing: NDArray[np.floating],
) -> NDArray[np.floating]:
    """Light of each part, with that around it outside of cells for which it is the nearest part."""
    gap, at = nearest_outside(parts == 0, spacing)
    around = np.where(outside & (gap <= RULES.around), np.take(parts, at), 0)
    return np.asarray(sum_labels(rest, around, numbers))


def _around_touching(
    bright: Mask,
    cells: Mask,
    boxes: Mapping[int, tuple[slice, ...]],
    spacing: NDArray[np.floating],
) -> tuple[slice, ...] | None:
    """The box that holds the bright things that touch cells, and these cells; None without any."""
    room = np.ceil(max(RULES.touching, RULES.around) / spacing).astype(int) + 1
    near = cells
    for axis, n in enumerate(room.tolist()):
        near = maximum_filter1d(near, 2 * n + 1, axis=axis)
    things, _ = label(bright, _ALL_AROUND)
    touching = np.unique(things[near & bright])
    if not touching.size:
        return None
    wanted = np.zeros(things.max() + 1, bool)
    wanted[touching] = True
    sides = find_objects(wanted[things].astype(np.int8))[0]
    low, high = (np.array([getattr(s, end) for s in sides]) for end in ("start", "stop"))
    low, high = low - room, high + room
    for box in boxes.values():
        first, last = (np.array([getattr(s, end) for s in box]) for end in ("start", "stop"))
        if (first < high).all() and (last > low).all():
            low, high = np.minimum(low, first), np.maximum(high, last)
    low = np.maximum(low, 0)
    return tuple(slice(a, b) for a, b in zip(low.tolist(), high.tolist(), strict=True))
