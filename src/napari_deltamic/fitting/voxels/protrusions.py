"""Bright things that belong to a cell though they are far from its dark inside: protrusions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, find_objects
from scipy.ndimage import label as label_components
from skimage.morphology import reconstruction

from ...common.doing import doing
from ...geometry.distance_transform import distance_transform
from ...geometry.labels.voxels import depths, highest, widened

Labels = NDArray[np.signedinteger]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class ProtrusionRules:
    """What a cell whose inside no longer shows may look like.

    Attributes
    ----------
    deep
        Of the depth of a start: further in, its inside is as dark as it gets, however thick its
        membrane is. Chosen. In the whole inside of a fish 15 voxels thick that was fitted through a
        PSF 1.4 times too wide, the median was 0.87 of a membrane, and 0.27 further in than this.
    thick, double
        Widths from its middle to its edge, and times a membrane: what is thicker or brighter than
        two membranes side by side is no part of a cell whose inside no longer shows. Measured on
        simulated fingers three voxels wide, where they end in the dark: 1.8 to 3.6, 1.2 to 1.5.
    foot
        Widths: nearer to its cell, what a protrusion widens into counts for nothing. Chosen.
    joined
        Of a membrane, or of itself where it is dimmer: as bright it is on the way to its cell;
        where a speck comes near, less. Chosen.
    alone
        Share of the bright things far from starts that are protrusions: where less is, others are
        about. Chosen: crumbs of noise are not counted. Measured on a cell among three without seeds
        (radii of 4 to 6 voxels), only one of which had a visible inside: when the other two counted
        as fingers, the cell swallowed them.
    closed, walls
        Widths: dark ground this deep that membranes enclose is the inside of another cell; less
        may lie between a protrusion and its cell. Of a membrane: as bright such walls are, the
        dimmest first, as free walls are dimmer than shared ones. Chosen.
    hollow
        Of a membrane: what is dimmer in its middle than all around by this, and by more than noise,
        has an inside of its own. Measured: 0 in 12 simulated fingers, 0.27 in a small cell that
        touched another one, by which it was swallowed.
    """

    deep: float = 0.5
    thick: float = 4.0
    double: float = 2.5
    foot: float = 1.0
    joined: float = 0.8
    alone: float = 0.9
    closed: float = 1.5
    walls: tuple[float, ...] = (0.1, 0.15, 0.2, 0.3, 0.4, 0.6)
    hollow: float = 0.05


RULES = ProtrusionRules()
_ALL_AROUND = np.ones((3, 3, 3))  # exact: neighbours across corners, too
_STEP = 0.1  # of a membrane; chosen: finer than noise leaves heights


def protrusions(
    foreign: Mask,
    bright: Mask,
    starts: Labels,
    beyond: np.ndarray,
    height: np.ndarray,
    known: Mask,
    noise: float,
    spacing: np.ndarray,
) -> Mask:
    """(Z, Y, X) bright things that belong to a start though they are far from its dark inside.

    Fins and fingers, in which the blur joins the membranes of both sides: they are connected with
    its membrane, no thicker or brighter than two, and have no inside of their own. None where
    membranes enclose anything else, as they may be walls of a neighbour, or where much else is
    bright, as they may be more of it.

    Parameters
    ----------
    foreign
        (Z, Y, X) bright things far from the starts.
    bright
        (Z, Y, X) all that is bright.
    starts, beyond
        (Z, Y, X) the insides of the starts, each with its number, 0 elsewhere; and widths from
        where their own light ends, below 0 in it.
    height, noise
        (Z, Y, X) brightness above the dark level, and what stands out from noise, both as parts of
        that of a membrane.
    known
        (Z, Y, X) where the height is that of measured voxels.
    spacing
        (3,) of voxels, widths of the PSF.
    """
    nothing, inside = np.zeros_like(foreign), starts > 0
    if not (foreign.any() and inside.any()) or _core(height, starts, spacing) > RULES.joined:
        return nothing
    levels = [level for level in RULES.walls if level > noise]
    if any(_encloses((height > level) | inside, spacing) for level in levels):
        return nothing
    things, count = label_components(foreign, _ALL_AROUND)
    numbers = np.arange(1, count + 1)
    peak = highest(height, things, count)
    beside = beyond <= 0
    theirs = (peak <= RULES.double) & _thin(things, bright, beyond, spacing)
    theirs &= _joined(things, beside, height, RULES.joined * np.minimum(peak, 1))
    theirs &= ~_hollow(things, height, inside | beside, known, max(noise, RULES.hollow))
    size = np.bincount(things.ravel())[1:]
    if size[theirs].sum() < RULES.alone * size.sum():
        return nothing
    return np.isin(things, numbers[theirs])


def _core(height: np.ndarray, starts: Labels, spacing: np.ndarray) -> float:
    """Median height of the starts where each is deeper than half as deep as it gets."""
    found = []
    for number, box in enumerate(find_objects(starts), 1):
        if box is not None:
            doing()
            depth = depths(starts[box] == number, spacing)
            found.append(height[box][depth > RULES.deep * depth.max()])
    return float(np.median(np.concatenate(found)))


def _thin(things: Labels, bright: Mask, beyond: np.ndarray, spacing: np.ndarray) -> Mask:
    """(n,) whether things are no thicker than two membranes, but for where they begin."""
    found = []
    room = np.ceil(RULES.thick / spacing) + 1
    for number, box in enumerate(find_objects(things), 1):
        doing()
        around = widened(box, room, things.shape)
        depth = distance_transform(bright[around], spacing)
        own = things[around] == number
        free = own & (beyond[around] > RULES.foot)
        found.append(depth[free if free.any() else own].max())
    return np.array(found) <= RULES.thick


def _hollow(things: Labels, height: np.ndarray, own: Mask, known: Mask, least: float) -> Mask:
    """(n,) things around ground that is dimmer than all around it by at least so much.

    own : (Z, Y, X) bool, ground of the starts, which is no other's inside. known : where that is
    known.
    """
    found = []
    for number, inner in enumerate(find_objects(things), 1):
        doing()
        box = widened(inner, 1, things.shape)
        around = np.where(known[box], height[box], height[box].max())
        full = around.copy()
        full[1:-1, 1:-1, 1:-1] = around.max()
        filled = reconstruction(full, around, method="erosion")
        holes = (filled - around > least) & ~own[box]
        found.append((binary_dilation(holes, _ALL_AROUND) & (things[box] == number)).any())
    return np.array(found, bool)


def _joined(things: Labels, beside: Mask, height: np.ndarray, bounds: np.ndarray) -> Mask:
    """(n,) whether a way as high as its bound leads from each thing to the starts."""
    found = np.zeros(len(bounds), bool)
    steps = np.ceil(bounds / _STEP) * _STEP  # one look at the image for each of a few heights
    for step in np.unique(steps):
        doing()
        parts, _ = label_components((height > step) & ((things > 0) | beside), _ALL_AROUND)
        own = np.isin(parts, np.unique(parts[beside])) & (parts > 0)
        found |= np.isin(np.arange(1, len(bounds) + 1), np.unique(things[own])) & (steps == step)
    return found


def _encloses(walls: Mask, spacing: np.ndarray) -> bool:
    """Whether walls enclose something deep, the border of the image being a wall as well.

    Not all of it at once: what lies open to both sides of an axis is the outside.
    """
    doing()
    parts, _ = label_components(~walls)
    for number, box in enumerate(find_objects(parts), 1):
        across = (s.start == 0 and s.stop == n for s, n in zip(box, walls.shape, strict=True))
        wide = np.multiply([s.stop - s.start for s in box], spacing).min() > RULES.closed
        if wide and not any(across):
            hole = np.pad(parts[box] == number, 1)
            if distance_transform(hole, spacing).max() > RULES.closed:
                return True
    return False
