"""Replaces labels that only mark cells, such as their nuclei, by whole cells.

A label that ends where the image shows no edge, well inside a region that it does show, marks that
region: the dark inside of a membrane, or something bright (:mod:`.regions_at_points`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.segmentation import watershed

from ...common.doing import doing
from ...errors import InputError
from ..distance_transform import distance_transform
from ..mesh import FloatArray
from .basins import noise_after
from .regions_at_points import closed_regions
from .voxels import box_around, depths, ranked, widened

Labels = NDArray[np.int32]
Mask = NDArray[np.bool_]
Box = tuple[slice, ...]


@dataclass(frozen=True)
class MarkerRules:
    """Thresholds that decide which labels only mark their cells.

    Attributes
    ----------
    reach
        Depths of a label, so far around which its cell may end: 3.5 times as wide. Chosen.
    layers
        In one depth, of which each has one brightness, its median; chosen.
    edge
        Of the steepest change between layers further out, the steepest within a label and at its
        border, at most. By definition 1 where labels end at the border of their cells.
    own
        Of that, the steepest change in the outer third of a label, from which on the label ends on
        an edge of its own if two changes between are half as large. Measured: 0.69 at a nucleus in
        cytoplasm 0.55 times as bright. The third, and the half, are chosen.
    noise, seen
        Standard deviations of noise, and share of the largest change around a label, from which on
        a change is seen: the first one must come beyond the label. Chosen.
    back, surely
        Of that change, how far brightness may go back on its way, and of the error of the two
        layers: a label that ends on a dim wall inside a brighter one is a cell of its own. Chosen.
    fewest
        Voxels of a layer that counts; chosen.
    most
        Share of the labels that end on no edge, from which on all are taken for markers; chosen.
    held
        Share of a label that lies in its region, at least; chosen.
    others
        Share of another label that the region holds, at most; chosen.
    larger
        Times the volume of the label that its region has, at least. Chosen: those of 0.85 of the
        radius are found by a fit.
    apart
        Share of the label's outermost voxels that lie within the region, not on its border.
        Chosen: labels that lack a part of their cell meet its border elsewhere.
    crest
        Of the rise from the label to the border of a region, the fall beyond it, at least: bright
        ground around something dark is no wall. Chosen.
    """

    reach: float = 2.5
    layers: int = 6
    edge: float = 0.8
    own: float = 0.5
    noise: float = 5.0
    seen: float = 0.35
    back: float = 0.05
    surely: float = 2.0
    fewest: int = 8
    most: float = 0.5
    held: float = 0.9
    others: float = 0.5
    larger: float = 1.5
    apart: float = 0.8
    crest: float = 0.25


RULES = MarkerRules()
_BEYOND = 2, 4  # voxels beyond a border, where a crest has fallen; chosen
# By definition: along an axis, how far one independent value reaches after a Gaussian, in its
# widths; and the error of a median over that of a mean.
_SHARED, _OF_MEDIAN = 2 * np.pi**0.5, (np.pi / 2) ** 0.5


@dataclass(frozen=True, eq=False)
class _Seen:
    """An image as it is and smoothed, the voxel size (um), and the noise of the smoothed one."""

    image: FloatArray
    smooth: FloatArray
    size: FloatArray
    noise: float


@dataclass(frozen=True, eq=False)
class _Label:
    """A label's box, deepest voxel, depth of that (um), and number of voxels."""

    box: Box
    voxel: NDArray[np.intp]
    depth: float
    voxels: int


def whole_cells(image: FloatArray, labels: Labels, size: FloatArray) -> tuple[Labels, list[int]]:
    """Enlarge labels that only mark a cell to the region that the image shows; return their names.

    Parameters
    ----------
    image
        (Z, Y, X), finite.
    labels
        (Z, Y, X), 0 = outside.
    size
        (3,) um of a voxel.
    """
    names, numbers = ranked(labels)
    data, sigma = image.astype(np.float64), float(size.min()) / size
    smooth = ndimage.gaussian_filter(data, sigma, mode="nearest")
    seen = _Seen(data, smooth, size, noise_after(data, sigma))
    known = dict(_each(numbers, size))
    marks = [k for k, one in known.items() if _ends_on_nothing(seen, numbers, k, one)]
    if not marks:
        return labels, []
    asked = known if len(marks) >= RULES.most * len(known) else {k: known[k] for k in marks}
    result, changed = numbers.copy(), list[int]()
    found = [find(seen, numbers, asked) for find in (_regions, _between)]
    boxes = [ndimage.find_objects(one, len(known)) for one in found]
    for k in asked:
        doing()
        regions = [
            _Region(k, one, box_around(box[k - 1], asked[k].box))
            for one, box in zip(found, boxes, strict=True)
            if box[k - 1] is not None
        ]
        fit = [one for one in regions if one.is_of(seen, numbers, known)]
        if fit:
            min(fit, key=lambda one: one.voxels).fill(result)
            changed.append(int(names[k]))
    return names[result].astype(labels.dtype), changed


def _each(labels: Labels, size: FloatArray) -> Iterator[tuple[int, _Label]]:
    for name, box in enumerate(ndimage.find_objects(labels), 1):
        doing()
        own = labels[box] == name
        depth = depths(own, size)
        deepest = np.array(np.unravel_index(depth.argmax(), depth.shape))
        first = [side.start for side in box]
        yield name, _Label(box, deepest + first, float(depth.max()), int(own.sum()))


def _regions(seen: _Seen, labels: Labels, asked: dict[int, _Label]) -> Labels:
    """Return (Z, Y, X) the region that closes around the deepest voxel of each label."""
    voxels = np.array([one.voxel for one in asked.values()])
    try:
        return closed_regions(seen.image, seen.size, voxels, list(asked))[0]
    except InputError:
        return np.zeros_like(labels)


def _between(seen: _Seen, labels: Labels, asked: dict[int, _Label]) -> Labels:
    """Return (Z, Y, X) the surroundings of each label, up to the crests around it.

    By the watershed from markers (F. Meyer and S. Beucher, 1990), one of which is everything far
    from all labels. It also separates cells whose wall is dim in one place.
    """
    away = distance_transform(~np.isin(labels, list(asked)), seen.size)
    doing()
    outside = away > RULES.reach * np.median([one.depth for one in asked.values()])
    far = int(labels.max()) + 1
    found: Labels = watershed(seen.smooth, np.where(outside & (labels == 0), far, labels))
    return np.where(found == far, 0, found)


def _ends_on_nothing(seen: _Seen, labels: Labels, name: int, at: _Label) -> bool:
    """Whether the image changes little where a label ends, and more farther out."""
    doing()
    light, values, inner = _layers(seen, labels, name, at)
    if inner == 0 or len(light) < inner + 2:
        return False
    change = light - light[0]
    clear = max(RULES.noise * seen.noise, RULES.seen * float(np.abs(change).max()))
    first = int(np.argmax(np.abs(change) > clear))  # 0: nowhere
    if first < inner:
        return False
    way = np.sign(change[first]) * change[: first + 1]
    error = seen.noise * _OF_MEDIAN / np.sqrt(np.maximum(values[: first + 1], 1))
    highest = np.maximum.accumulate(way)
    there = np.maximum.accumulate(np.where(way == highest, np.arange(len(way)), 0))
    unsure = RULES.surely * np.hypot(error, error[there])
    if (highest - way > np.maximum(RULES.back * way[-1], unsure)).any():
        return False
    steps = np.abs(np.diff(light))
    steepest = float(steps[inner:].max())
    return bool(steps[:inner].max() <= RULES.edge * steepest) and not _has_edge(steps, inner)


def _has_edge(steps: FloatArray, inner: int) -> bool:
    """Whether brightness changes at the end of a label, and hardly beyond, before an edge.

    steps : between layers. inner : layers of the label.
    """
    beyond = inner + int(steps[inner:].argmax())
    near = slice(inner - max(inner // 3, 1), inner)
    own = float(steps[near].max())
    # A single step may be small where layers of the label meet those around it.
    between = (steps[inner : beyond - 1] + steps[inner + 1 : beyond]) / 2
    return own > RULES.own * steps[beyond] and float(between.min(initial=own)) < own / 2


def _layers(
    seen: _Seen, labels: Labels, name: int, at: _Label
) -> tuple[FloatArray, FloatArray, int]:
    """Return the brightness of layers in and around a label, from its core on.

    Also how many independent values each layer has, and how many layers belong to the label.
    """
    every = np.maximum(at.depth / RULES.layers / seen.size, 1).astype(int)  # few voxels tell enough
    size, reach = every * seen.size, RULES.reach * at.depth
    around = widened(at.box, np.ceil(reach / seen.size) + 1, labels.shape)
    part = tuple(slice(s.start, s.stop, n) for s, n in zip(around, every.tolist(), strict=True))
    light, own, free = seen.smooth[part], labels[part] == name, labels[part] == 0
    step, inner = float(size.min()), depths(own, size)
    outer = distance_transform(~own, size)
    within = [own & (inner > k) & (inner <= k + step) for k in np.arange(0, inner.max(), step)]
    beyond = [free & (outer > k) & (outer <= k + step) for k in np.arange(0, reach, step)]
    inside, around_it = (
        [light[m] for m in layers if np.count_nonzero(m) >= RULES.fewest]
        for layers in (within[::-1], beyond)
    )
    each = inside + around_it
    share = np.prod(np.maximum(_SHARED * float(seen.size.min()) / size, 1))  # of one value; voxels
    values = np.array([len(one) for one in each]) / share
    return np.array([float(np.median(one)) for one in each]), values, len(inside)


@dataclass(frozen=True, eq=False)
class _Region:
    """The region found around a label, in a box that holds both."""

    name: int
    found: Labels
    box: Box

    @cached_property
    def mask(self) -> Mask:
        return np.asarray(self.found[self.box] == self.name)

    @property
    def voxels(self) -> int:
        return int(np.count_nonzero(self.mask))

    def fill(self, labels: Labels) -> None:
        """Give the label the region's voxels that no label has."""
        part = labels[self.box]
        part[self.mask & (part == 0)] = self.name

    def is_of(self, seen: _Seen, labels: Labels, known: dict[int, _Label]) -> bool:
        """Whether only this label lies well inside, and a clear border ends the region."""
        held = np.bincount(labels[self.box][self.mask], minlength=len(known) + 1)
        own = known[self.name].voxels
        if held[self.name] < RULES.held * own:
            return False
        if any(held[k] > RULES.others * one.voxels for k, one in known.items() if k != self.name):
            return False
        least, largest = RULES.larger, (1 + RULES.reach) ** 3
        if not least * own <= own + held[0] <= largest * own:
            return False
        return self._apart(labels) and self._ends(seen, labels)

    def _apart(self, labels: Labels) -> bool:
        box = widened(self.box, 1, labels.shape)
        own, region = labels[box] == self.name, self.found[box] == self.name
        # Things that the border of the image cuts go on beyond it.
        core, within = (ndimage.binary_erosion(m, border_value=1) for m in (own, own | region))
        rim = own & ~core
        return bool(np.count_nonzero(rim & within) >= RULES.apart * np.count_nonzero(rim))

    def _ends(self, seen: _Seen, labels: Labels) -> bool:
        """Whether the image falls beyond the region's border, if it rises up to it."""
        box = widened(self.box, _BEYOND[1] + 1, labels.shape)
        region, light = self.found[box] == self.name, seen.smooth[box]
        rim = region & ~ndimage.binary_erosion(region, border_value=1)
        near, far = (ndimage.binary_dilation(region, iterations=n) for n in _BEYOND)
        beyond = far & ~near
        if not (rim.any() and beyond.any()):
            return False
        core, border, out = (
            float(np.median(light[m])) for m in (labels[box] == self.name, rim, beyond)
        )
        return border <= core or border - out >= RULES.crest * (border - core)
