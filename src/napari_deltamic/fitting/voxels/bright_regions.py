"""Bright things (nuclei) that starts placed by hand lie in, parted from what they touch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import (
    binary_dilation,
    find_objects,
    gaussian_filter,
    sum_labels,
)
from scipy.ndimage import label as label_components
from skimage.morphology import local_maxima, reconstruction
from skimage.segmentation import watershed

from ...common.ball import ball_radius
from ...common.doing import doing
from ...geometry.contacts import faces_of_voxels
from ...geometry.distance_transform import distance_transform, nearest_outside
from ...geometry.labels.voxels import highest, widened
from ...images.missing import filled
from ...scene import Grid

Labels = NDArray[np.signedinteger]
Mask = NDArray[np.bool_]

STRANGER = -1  # instead of a region: bright things without a start that touch one with a start


@dataclass(frozen=True)
class BrightRegionRules:
    """What counts as the bright thing that a start lies in, and where it ends.

    Attributes
    ----------
    same
        A region of the image is that of a start placed by hand if its volume is that of the start,
        up to this factor: of starts of 0.5 to 2 radii, whose volumes are an eighth to eight times
        that.
    calm
        Radii of the smallest start: noise and texture are smoothed away over this. Chosen on
        simulated nuclei, single and touching, among specks, from 5 photons on.
    deep, full
        Radii of the start: its core lies this deep. Where it is not as bright as this share of its
        brightest places, these are membranes. Chosen on the same images.
    half
        Share of the brightness in the core at which a bright region ends.
    neck
        Two things meet where the way between their depths is shallower than this share of both: of
        104 simulated nuclei, some with lobes or bent, 0.75 joined four with a neighbour, 0.8 and
        0.9 none, and none lost a lobe.
    most
        Share of a thing inside starts from which it is theirs, whatever parts it.
    far
        Radii of the largest start, around all: no thing of theirs reaches further; saves time.
    thin
        Radii of the smallest start: what is thinner than twice this is another thing.
    rise
        Of the brightness of starts: a thing is one of its own if the light dips by at least this on
        every way from its brightest place to a start. Measured on packed nuclei, three draws of
        each kind. Where all have starts, in a haze, they end 0.28 to 0.34 voxel off, and 0.32 to
        0.39 if the haze in gaps is taken for things. Where a third have none, they end 0.11 to 0.15
        off, not 0.11 to 0.18. 0.05 is as good; with 0.2, three were swallowed.
    thick
        Radii of the median start: what is thicker than twice this is a thing even if it is dim, for
        example beside a brighter one. Measured on the same nuclei: 0.6 and 0.8 are equally good;
        with 0.5, gaps are taken for things.
    corner
        Times the rounding: what sticks out of the rounded rest further than the corner of a cube,
        whose tip lies at 3**0.5 of the rounding, is a speck and no corner.
    """

    same: float = 10.0
    calm: float = 0.15
    deep: float = 0.5
    full: float = 0.75
    half: float = 0.5
    neck: float = 0.8
    most: float = 0.5
    far: float = 4.0
    thin: float = 0.35
    rise: float = 0.1
    thick: float = 0.6
    corner: float = 1.75


RULES = BrightRegionRules()


def bright_regions(image: np.ndarray, grid: Grid, starts: Labels) -> Labels | None:
    """(Z, Y, X) the bright region that each start lies in; None if one is dark, or has none.

    Each ends at half of its own brightness. Bright things that touch are parted where they are
    narrower than both, and thin ones do not belong to it. Those without a start are ``STRANGER``.
    """
    size = np.asarray(grid.voxel_size)
    names = np.union1d([0], starts)
    starts = np.searchsorted(names, starts).astype(np.int32)  # names may be large numbers
    radii = _radii(starts, size)
    smooth = gaussian_filter(filled(image).astype(np.float32), RULES.calm * radii.min() / size)
    smooth -= np.percentile(smooth, 20)  # what is dark
    ends = _ends(smooth, starts, radii, size)
    if ends is None:
        return None
    things, theirs = _things_of(starts, smooth > ends[1:].min(), RULES.far * radii.max(), size)
    own, shed = without_thin(theirs[things], RULES.thin * radii.min(), size)
    if not own.any():
        return None
    _, at = nearest_outside(starts == 0, size)
    found: Labels = np.where(own, np.take(starts, at), 0)
    found[smooth < ends[found]] = 0
    if not alike(found, starts, np.arange(1, len(names))):
        return None
    found = names[found]
    found[shed | ((things > 0) & ~theirs[things])] = STRANGER
    return found


def without_start(bright: Mask, light: np.ndarray, starts: Labels, grid: Grid) -> Mask:
    """(Z, Y, X) bool: bright things without a start, where starts nearly match their own things.

    Things count if the light dips between them and every start, or if they are as thick as a cell;
    the rest is light in the gaps between starts. All False if most starts lie on dark ground: there
    membranes shine.

    Parameters
    ----------
    bright
        (Z, Y, X) what is as bright as such a thing.
    light
        (Z, Y, X) brightness above the dark level.
    starts
        (Z, Y, X) regions of the starts.
    """
    size = np.asarray(grid.voxel_size)
    names = np.union1d([0], starts)
    starts = np.searchsorted(names, starts).astype(np.int32)
    radii = _radii(starts, size)
    cores, brightest = _cores(light, starts, radii, size)
    if np.median(cores - RULES.full * brightest) <= 0:
        return np.zeros(starts.shape, bool)
    things = without_thin(bright & (starts == 0), RULES.thin * radii.min(), size)[0]
    doing()
    rise = RULES.rise * float(np.median(light[starts > 0]))
    alone = _rising(things, light, starts, rise)
    doing()
    thick = without_thin(things & ~alone, RULES.thick * float(np.median(radii)), size)[0]
    return alone | thick


def _rising(things: Mask, light: np.ndarray, starts: Labels, rise: float) -> Mask:
    """Things, or parts of them, whose light dips by at least ``rise`` on every way to a start.

    Voxels are neighbours if they share a face.
    """
    rim = binary_dilation(things) & (starts > 0)
    if not rim.any():
        return things
    mask = things | rim
    tops = local_maxima(np.where(mask, light, light.min()), connectivity=1) & things
    peaks, count = label_components(tops)
    start = count + 1  # all starts as one part
    doing()
    parts = watershed(-light, np.where(rim, start, peaks), mask=mask)
    doing()
    heights = np.append(-np.inf, highest(light, parts, start))
    heights[start] = np.inf
    root = list(range(start + 1))

    def joined(part: int) -> int:
        while root[part] != part:
            root[part] = root[root[part]]
            part = root[part]
        return part

    for saddle, one, other in _saddles(parts, light):
        low, high = sorted((joined(one), joined(other)), key=heights.__getitem__)
        if low != high and heights[low] - saddle < rise:
            root[low] = high
    whole = np.array([joined(part) for part in range(start + 1)])
    return things & (whole[parts] != joined(start))


def _saddles(parts: Labels, light: np.ndarray) -> list[tuple[float, int, int]]:
    """Brightness at which two parts meet, and their numbers; the brightest first."""
    found: dict[int, float] = {}
    several = int(parts.max()) + 1
    for names, values in faces_of_voxels(parts, light):
        lower, (a, b) = np.minimum(*values), (side.astype(np.int64) for side in names)
        pairs = np.minimum(a, b) * several + np.maximum(a, b)
        kinds, which = np.unique(pairs, return_inverse=True)
        highest = np.full(len(kinds), -np.inf)
        np.maximum.at(highest, which, lower)
        for pair, saddle in zip(kinds.tolist(), highest.tolist(), strict=True):
            found[pair] = max(saddle, found.get(pair, -np.inf))
    return sorted(((s, *divmod(pair, several)) for pair, s in found.items()), reverse=True)


def _radii(starts: Labels, size: np.ndarray) -> NDArray[np.floating]:
    """Radii of spheres as large as the starts, from number 1."""
    return np.asarray(ball_radius(np.bincount(starts.ravel())[1:] * size.prod()))


def _ends(
    smooth: np.ndarray, starts: Labels, radii: np.ndarray, size: np.ndarray
) -> np.ndarray | None:
    """Brightness at which the thing of each start ends, from number 1; None if a core is dark."""
    cores, brightest = _cores(smooth, starts, radii, size)
    if (cores <= 0).any() or (cores < RULES.full * brightest).any():
        return None
    return np.append(0.0, RULES.half * cores)


def _cores(
    smooth: np.ndarray, starts: Labels, radii: np.ndarray, size: np.ndarray
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Brightness in the core of each start, 0 where it has none; and of its brightest places."""
    doing()
    within = distance_transform(starts > 0, size)
    cores, brightest = np.zeros(len(radii)), np.zeros(len(radii))
    for r, (box, radius) in enumerate(zip(find_objects(starts), radii, strict=True)):
        own = starts[box] == r + 1
        # The core alone: a start that is too large holds more dark than bright voxels.
        core = smooth[box][own & (within[box] > RULES.deep * radius)]
        cores[r] = float(np.median(core)) if core.size else 0.0
        brightest[r] = np.percentile(smooth[box][own], 95)
    return cores, brightest


def _things_of(starts: Labels, bright: Mask, far: float, size: np.ndarray) -> tuple[Labels, Mask]:
    """(Z, Y, X) numbers of the bright things that starts lie in or touch; which are theirs.

    A start's own is what most of it lies in, and what mostly lies in starts.
    """
    things = np.zeros(bright.shape, np.int32)
    box = widened(find_objects((starts > 0).astype(np.int8))[0], far / size, starts.shape)
    connected, _ = label_components(bright[box])
    touched = np.unique(connected[(starts[box] > 0) & bright[box]])
    doing()
    depth = distance_transform(np.isin(connected, touched), size)
    things[box] = parted(depth, RULES.neck)
    volume = np.bincount(things.ravel())
    covered = np.bincount(things.ravel(), starts.ravel() > 0)
    theirs = covered > RULES.most * volume
    for r, part in enumerate(find_objects(starts), 1):
        held = np.bincount(things[part][(starts[part] == r) & bright[part]])
        theirs[held.argmax()] = True
    theirs[0] = False
    return things, theirs


def without_thin(things: Mask, thin: float, size: np.ndarray) -> tuple[Mask, Mask]:
    """What is thicker than twice a length, rounded by it, and what sticks out of that."""
    doing()
    thick = distance_transform(things, size) > thin
    if not thick.any():
        return thick, thick
    near = distance_transform(~thick, size)
    rest, count = label_components(things & (near > thin))
    out = np.append(False, highest(near, rest, count) > RULES.corner * thin)
    return things & (near <= thin), out[rest]


def parted(depth: NDArray[np.floating], neck: float) -> Labels:
    """Number what is deep (0 elsewhere), in parts that meet where both are deeper.

    neck : share of the depth of either to which the way between two parts comes, at most.
    """
    inside = depth > 0
    doing()
    log = np.log(np.where(inside, depth, neck**2 * depth[inside].min()))
    flooded = reconstruction(log + np.log(neck), log)
    peaks, _ = label_components(local_maxima(flooded, connectivity=3) & inside, np.ones((3, 3, 3)))
    parts: Labels = watershed(-depth, peaks, mask=inside)
    return parts


def alike(found: Labels, starts: Labels, regions: np.ndarray) -> bool:
    """Whether each region of the image is about as large as its start."""
    volume, start = (np.asarray(sum_labels(a > 0, a, regions)) for a in (found, starts))
    return bool(((start / RULES.same < volume) & (volume < start * RULES.same)).all())
