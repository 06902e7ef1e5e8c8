"""What starts have missed of their cells, such as the top that a label lacks.

What lies far from a start and is bright is another's (:mod:`.voxel_ownership`), unless the image
says that the start and it are parts of one cell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, distance_transform_edt, find_objects, label, mean
from skimage.segmentation import watershed

from ..scene import Grid
from .bright_regions import Labels, Mask, bright_regions, without_thin


@dataclass(frozen=True)
class MissedPartRules:
    """What a start has missed.

    Attributes
    ----------
    most
        Share of a start that lies in a region of the image if it is the region of that start.
    thin
        Radii of the start: what sticks out of its region and is thinner than twice this is not what
        it has missed. Chosen: a cap that a label lacks is wider, a bright thread beside it is not.
    whole, core
        Shares of a bright thing near what a start has missed, and of what it has missed itself,
        from which on the thing is that. Measured on labels that lack a fifth to two fifths of a
        nucleus or lie three voxels beside it: 1.0 and 0.1 to 0.8; 0.92 and 0.00 in a nucleus
        without a start that would have been swallowed.
    crest
        Percentile of what is seen where a start ends, which is on its membrane but where it misses
        a part; chosen.
    dark
        Of that: an inside that is brighter is not enclosed by a membrane. Measured on a cell of
        both, two fifths of which its label lacked: 1.21 voxels off with 0.75, 0.06 with this.
    levels
        From the inside to the crest: how far it is flooded, the highest at which it does not leak.
        Chosen.
    around
        Of its size to each side, what a start may have missed. Chosen: two fifths of a cell are
        two thirds of the rest.
    """

    most: float = 0.5
    thin: float = 0.5
    whole: float = 0.9
    core: float = 0.05
    crest: float = 75.0
    dark: float = 0.9
    levels: tuple[float, ...] = (0.7, 0.5, 0.3)
    around: float = 0.8


RULES = MissedPartRules()


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

    Membranes that close around a dark inside part it from all others; nothing does so for a bright
    one, so that is only theirs if no other thing is joined to it.

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
    hollow = missed(dark_regions(light, starts, foreign), starts, grid)
    full = missed(bright_regions(image, grid, starts), starts, grid) & (~strangers | hollow)
    beside = _away(hollow, spacing)
    own, foreign = np.minimum(own, beside), foreign & (beside > reach)
    parts, count = label(foreign, np.ones((3, 3, 3)))
    numbers = np.arange(1, count + 1)
    near = mean(np.minimum(own, _away(full, spacing)) <= reach, parts, numbers)
    theirs = (near > RULES.whole) & (mean(full, parts, numbers) > RULES.core)
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
        around = tuple(_wider(side, n) for side, n in zip(box, starts.shape, strict=True))
        if not foreign[around].any():
            continue
        own, free = starts[around] == region, starts[around] == 0
        inside = _flooded(light[around], own, own | free, _inner(around, starts.shape))
        if inside is not None:
            found[around][inside] = region
    return found


def _wider(side: slice, length: int) -> slice:
    room = int(np.ceil(RULES.around * (side.stop - side.start))) + 1
    return slice(max(side.start - room, 0), min(side.stop + room, length))


def _inner(box: tuple[slice, ...], shape: tuple[int, ...]) -> Mask:
    """What touches no side of a box that is not one of the image as well."""
    inner = np.ones([side.stop - side.start for side in box], bool)
    for axis, (side, length) in enumerate(zip(box, shape, strict=True)):
        layers = np.moveaxis(inner, axis, 0)
        layers[0] &= side.start == 0
        layers[-1] &= side.stop == length
    return inner


def _flooded(light: NDArray[np.floating], own: Mask, free: Mask, inner: Mask) -> Mask | None:
    """The dark ground that a start lies in; None if it is not dark, or leaks at all levels."""
    rim = own & ~binary_erosion(own, border_value=1)
    core = own & ~rim
    if not core.any():
        return None
    middle, crest = float(np.median(light[core])), float(np.percentile(light[rim], RULES.crest))
    if middle > RULES.dark * crest:
        return None
    for share in RULES.levels:
        low = light < middle + share * (crest - middle)
        parts, _ = label(free & low)
        held = np.bincount(parts[core])
        if len(held) < 2:
            continue
        region = parts == held[1:].argmax() + 1
        if not (region & ~inner).any() and region.sum() < 2 * own.sum():
            ends = np.where(region, 1, 2 * (low | ~free))
            return watershed(light, ends) == 1
    return None


def missed(found: Labels | None, starts: Labels, grid: Grid) -> Mask:
    """(Z, Y, X) bool: what starts have missed of the regions of the image that they lie in.

    Not what is thin, and not where a start has missed more than it holds: more than one cell may
    lie there.
    """
    result = np.zeros(starts.shape, bool)
    if found is None:
        return result
    size, volumes = np.asarray(grid.voxel_size), np.bincount(starts.ravel())
    for region, box in enumerate(find_objects(np.maximum(found, 0)), 1):
        if box is None:
            continue
        box = tuple(slice(max(s.start - 1, 0), s.stop + 1) for s in box)
        own, start, volume = found[box] == region, starts[box], volumes[region]
        held = np.count_nonzero(own & (start == region))
        if held <= RULES.most * volume or np.count_nonzero(own & (start == 0)) >= volume:
            continue
        radius = np.cbrt(3 / (4 * np.pi) * volume * size.prod())
        whole, _ = without_thin(own | (start == region), RULES.thin * radius, size)
        result[box] |= whole & (start == 0)
    return result


def _away(things: Mask, spacing: np.ndarray) -> np.ndarray:
    """(Z, Y, X) widths from things; infinite where there are none."""
    if not things.any():
        return np.full(things.shape, np.inf)
    return np.asarray(distance_transform_edt(~things, sampling=spacing))
