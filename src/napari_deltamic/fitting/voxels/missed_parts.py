"""What starts have missed of their cells, such as the top that a label lacks.

What lies far from a start and is bright is another's (:mod:`.voxel_ownership`), unless the image
says that the start and it are parts of one cell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import (
    binary_dilation,
    binary_erosion,
    find_objects,
    label,
    mean,
)
from skimage.segmentation import watershed

from ...common.doing import doing
from ...geometry.distance_transform import distance_transform
from ...geometry.labels.voxels import box_around, depths, highest, widened
from ...scene import Grid
from .bright_regions import Labels, Mask, bright_regions, without_thin


@dataclass(frozen=True)
class MissedPartRules:
    """What a start has missed.

    Attributes
    ----------
    most
        A region of the image is that of a start if it holds more than this share of it; chosen.
    larger
        Times what a start holds: where it has missed more, more than one cell may lie; chosen.
    thin
        Depths of the start: what sticks out of its region and is thinner than twice this is not
        what it has missed. Chosen: a bright thread beside a cell is thinner than its top. With 0,
        one that touches a cell doubled its volume; with 0.5 it ended 0.16 voxel off.
    neck
        Share of the depth of what was missed that it has where it meets the start; where that is
        less, it is another cell. Measured: 1.00 in labels that lack their tops, 0.88 to 0.98 in
        balls of 8 or 10 voxels in radius that are joined to a labelled one of 12.
    near, core
        Shares of a bright thing near what a start has missed, and of what it has missed itself;
        above both, the thing is that. Measured on labels that lack a fifth to two fifths of a
        nucleus or lie three voxels beside it: 1.0 and at least 0.1. On a nucleus without a start
        that would have been swallowed: 0.92 and 0.00.
    crest
        Percentile of what is seen where a start ends, which is on its membrane but where it misses
        a part; chosen.
    dark
        Of that: an inside that is brighter is not enclosed by a membrane. Measured on a cell of
        both, two fifths of which its label lacked: 1.21 voxels off with 0.75, 0.05 with this.
    level
        From the inside to the crest: how far it is flooded. Chosen: a lower one leaks less. On 24
        cells whose labels lacked their tops, and 15 beside a cell without a label, behind a wall
        0.4 to 0.8 times as bright as the rest, 0.3 and 0.7 are equally good, as measured.
    around
        Of its size to each side, what a start may have missed. Chosen: two fifths of a cell are
        two thirds of the rest.
    """

    most: float = 0.5
    larger: float = 1.0
    thin: float = 0.5
    neck: float = 0.98
    near: float = 0.9
    core: float = 0.05
    crest: float = 75.0
    dark: float = 0.9
    level: float = 0.3
    around: float = 0.8


RULES = MissedPartRules()
_ALL_AROUND = np.ones((3, 3, 3))  # exact: neighbours across corners, too


def without_missed(
    image: np.ndarray,
    grid: Grid,
    starts: Labels,
    light: NDArray[np.floating],
    foreign: Mask,
    strangers: Mask,
    own: NDArray[np.floating],
    reach: float,
    spacing: NDArray[np.floating],
) -> tuple[Mask, NDArray[np.floating], Mask]:
    """Foreign things without what starts have missed, distances from the starts, and that.

    A dark inside counts as far as membranes close around it. Nothing parts a bright inside from
    what it touches, so a bright thing must be missed as a whole.

    Parameters
    ----------
    image, grid
        Of the fit.
    starts
        (Z, Y, X) regions of the starts.
    light
        (Z, Y, X) smoothed, above the dark level.
    foreign, strangers
        (Z, Y, X) bright things that seem to be no part of the starts; those of them that an inside
        of their own tells from the starts.
    own, reach
        (Z, Y, X) widths from the starts, and how far their light reaches.
    spacing
        (3,) of voxels, widths.
    """
    if not foreign.any():
        return foreign, own, np.zeros_like(foreign)
    names = np.union1d([0], starts)  # which may be large numbers
    starts = np.searchsorted(names, starts).astype(np.int32)
    hollow = missed(dark_regions(light, starts, foreign), starts, grid)
    full = missed(bright_regions(image, grid, starts), starts, grid) & (~strangers | hollow)
    beside = _away(hollow, spacing)
    doing()
    own, foreign = np.minimum(own, beside), foreign & ~hollow & ((beside > reach) | strangers)
    parts, count = label(foreign, _ALL_AROUND)
    numbers = np.arange(1, count + 1)
    near = mean(np.minimum(own, _away(full, spacing)) <= reach, parts, numbers)
    theirs = (near > RULES.near) & (mean(full, parts, numbers) > RULES.core)
    foreign &= ~np.append(False, theirs)[parts]
    both = hollow | (full & ~foreign)
    return foreign, np.minimum(own, _away(both, spacing)), both


def dark_regions(light: NDArray[np.floating], starts: Labels, foreign: Mask) -> Labels:
    """(Z, Y, X) the dark inside that each start lies in, as far as membranes close around it.

    Asked of starts near foreign things only.

    Parameters
    ----------
    light
        (Z, Y, X) above the dark level.
    starts, foreign
        (Z, Y, X) regions of the starts; bright things that seem to be no part of them.
    """
    found = np.zeros_like(starts)
    for region, box in enumerate(find_objects(starts), 1):
        if box is None:
            continue
        room = [np.ceil(RULES.around * (side.stop - side.start)) + 1 for side in box]
        around = widened(box, room, starts.shape)
        if not foreign[around].any():
            continue
        doing()
        own, free = starts[around] == region, starts[around] == 0
        inside = _flooded(light[around], own, own | free, _inner(around, starts.shape))
        if inside is not None:
            found[around][inside] = region
    return found


def _inner(box: tuple[slice, ...], shape: tuple[int, ...]) -> Mask:
    """Voxels of a box that lie on none of its sides, except for sides of the image."""
    inner = np.ones([side.stop - side.start for side in box], bool)
    for axis, (side, length) in enumerate(zip(box, shape, strict=True)):
        layers = np.moveaxis(inner, axis, 0)
        layers[0] &= side.start == 0
        layers[-1] &= side.stop == length
    return inner


def _flooded(light: NDArray[np.floating], own: Mask, free: Mask, inner: Mask) -> Mask | None:
    """The dark ground that a start lies in, up to the crest; None if it is not dark, or leaks."""
    rim = own & ~binary_erosion(own, border_value=1)
    core = own & ~rim
    if not (core.any() and rim.any()):
        return None
    middle, crest = float(np.median(light[core])), float(np.percentile(light[rim], RULES.crest))
    if middle > RULES.dark * crest:
        return None
    low = light < middle + RULES.level * (crest - middle)
    parts, _ = label(free & low)
    held = np.bincount(parts[core])
    if len(held) < 2:
        return None
    region = parts == held[1:].argmax() + 1
    if (region & ~inner).any():
        return None
    ends = np.where(region, 1, 2 * (low | ~free))
    # Only where it has to be decided, and the voxels beside that: most of a box is not.
    return np.asarray(watershed(light, ends, mask=binary_dilation(ends == 0)) == 1) | region


def missed(found: Labels | None, starts: Labels, grid: Grid) -> Mask:
    """(Z, Y, X) bool: what starts have missed of the regions of the image that they lie in.

    Neither what is thin nor what looks like another cell.

    Parameters
    ----------
    found, starts
        (Z, Y, X) regions of the image and of the starts, both from 1 on; negative ones of the
        image are nobody's.
    """
    result = np.zeros(starts.shape, bool)
    if found is None:
        return result
    size, boxes = np.asarray(grid.voxel_size), find_objects(starts)
    for region, box in enumerate(find_objects(np.maximum(found, 0)), 1):
        if box is None:
            continue
        around = widened(box_around(box, boxes[region - 1]), 1, starts.shape)
        own, start = found[around] == region, starts[around] == region
        rest, volume = own & (starts[around] == 0), np.count_nonzero(start)
        held = np.count_nonzero(own & start)
        doing()
        if held > RULES.most * volume and np.count_nonzero(rest) < RULES.larger * volume:
            result[around] |= _of_one_cell(rest, start, size)
    return result


def _of_one_cell(rest: Mask, start: Mask, size: NDArray[np.floating]) -> Mask:
    """The parts that a start has missed and that are neither thin nor beyond a neck."""
    deep = float(depths(start, size).max())
    whole, _ = without_thin(rest | start, RULES.thin * deep, size)
    parts, count = label(rest & whole, _ALL_AROUND)
    depth = distance_transform(rest | start, size)
    meets = np.where(binary_dilation(start, _ALL_AROUND), depth, 0)
    at_start, at_most = (highest(d, parts, count) for d in (meets, depth))
    return np.append(False, at_start >= RULES.neck * at_most)[parts]


def _away(things: Mask, spacing: NDArray[np.floating]) -> NDArray[np.floating]:
    """(Z, Y, X) widths from things; infinite where there are none."""
    if not things.any():
        return np.full(things.shape, np.inf)
    return np.asarray(distance_transform(~things, spacing))
