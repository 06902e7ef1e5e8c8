"""Finds regions that points name: dark insides, or else cells that *Find cells* finds there."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.segmentation import watershed

from ...errors import InputError
from ..mesh import FloatArray, IntArray
from ..refused import Refused
from .basins import label_basins
from .bright_ball import ball_at, bright_ball, stands_out
from .hollow_ball import hollow_ball
from .in_focus import in_focus
from .label_repair import label_boxes
from .voxels import depths, widened

if TYPE_CHECKING:
    from .bright_cells import CellsFound

Labels = NDArray[np.int32]
_OWN = 0.5  # chosen: most of a cell must be left by regions that other points name
# Depth of a neck over that of the shallower side, at most; chosen: of two points in one nucleus it
# is 1, where spheres overlap by a third of a radius 0.75.
_NECK = 0.9
_BRIGHT = 90.0  # percentile of a region; chosen: a point above it may lie in what is bright
_DARK = 20  # percentile of the image; chosen: most images show more ground than that
# The dim middle of something bright: brightness over that of its crest, at least, and share of the
# bright cell around it that is at least so bright. Measured on 18 points with a bright cell around
# a dark region: 0.89 to 0.99 and 0.54 to 0.75 where that was the middle of a nucleus, up to 0.90
# and 0.48 inside membranes, and once 0.84 and 0.72, where cells had merged.
_DIM, _WIDE, _NEARLY = 0.87, 0.5, 0.8


def regions_at(
    data: FloatArray, size: FloatArray, voxels: IntArray, names: list[int]
) -> tuple[Labels, list[Refused]]:
    """Label the region of each voxel in ``voxels`` (n, 3) with its name; 0 elsewhere.

    It is the region of :func:`~.basins.label_basins`. If nothing dark closes around a point, or
    only the ground between bright cells, such as nuclei, or the dim middle of one, it is the cell
    that is found there without points; several points in a bright cell each get the part on their
    side of a neck. If neither is found, it is a ball that the point lies in, if its shell or all of
    it is clearly brighter than its surroundings and it reaches into no other region. Points
    without any of these are returned as refused. In widefield stacks, light that is out of focus
    is left out first.
    """
    labels, left = closed_regions(data, size, voxels, names)
    sharper = in_focus(data, size) if left else data
    at = dict(zip(names, voxels, strict=True))
    for name, closed in [(k, one.closed) for k, one in left.items() if len(one.points) == 1]:
        if (labels == name).any():
            continue
        for box, within in _balls(sharper, size, at[name], closed):
            if not labels[box][within].any():  # else it may reach over them
                labels[box][within] = name
                del left[name]
                break
    return labels, [left[name] for name in sorted(left)]


def _balls(
    data: FloatArray, size: FloatArray, voxel: IntArray, closed: bool
) -> Iterator[tuple[tuple[slice, ...], NDArray[np.bool_]]]:
    """Yield balls around a voxel, a hollow then a bright one, as boxes with masks.

    closed : whether a region, too small to be a cell, is closed around it.
    """
    hollow = hollow_ball(data, size, voxel, closed)
    if hollow is not None:
        yield ball_at(data.shape, size, hollow.middle, hollow.radius)
    ball = bright_ball(data, size, voxel)
    if ball is not None and stands_out(data, size, ball):
        yield ball_at(data.shape, size, voxel, ball.radius)


def closed_regions(
    data: FloatArray, size: FloatArray, voxels: IntArray, names: list[int]
) -> tuple[Labels, dict[int, Refused]]:
    """Like :func:`regions_at`, without balls; also return the points without a region, by name."""
    sharper = in_focus(data, size)
    labels, refused = label_basins(sharper, size, voxels, names)
    at = {name: tuple(voxel) for name, voxel in zip(names, voxels.tolist(), strict=True)}
    why = {one.points[-1]: one for one in refused}
    smooth = ndimage.gaussian_filter(sharper, float(size.min()) / size, mode="nearest")
    bright, dim = _in_bright(smooth, labels, at), _hardly_dark(smooth, labels)
    found = _cells(data, size) if bright or dim or why else None
    if found is None:
        return labels, why
    if found.bright:
        bright += [k for k in dim if k not in bright and _shines_around(smooth, labels == k, found)]
        bright = [k for k in bright if found.labels[at[k]]]
        labels[np.isin(labels, bright)] = 0
    left = {name: one for name, one in why.items() if not found.bright and len(one.points) > 1}
    cells: dict[int, list[int]] = {}  # the points in each
    for name in sorted({*why, *(bright if found.bright else ())} - set(left)):
        cells.setdefault(int(found.labels[at[name]]), []).append(name)
    for cell, inside in cells.items():
        whole = (found.labels == cell) & (cell > 0)
        own = whole & (labels == 0)
        if own.sum() <= _OWN * whole.sum():
            for name in inside:
                text = f"the cell at point {name} is mostly that of other points"
                left[name] = why.get(name, Refused(text, (name,)))
            continue
        parts, of = _parted(own, {name: at[name] for name in inside}, size, found.bright)
        labels[own] = parts[own]
        for name, other in of.items():
            text = f"points {other} and {name} lie in the same region"
            left[name] = Refused(text, (other, name))
    return labels, left


def _parted(
    whole: np.ndarray, at: dict[int, tuple[int, ...]], size: FloatArray, bright: bool
) -> tuple[Labels, dict[int, int]]:
    """Divide a cell among several points in it; only a bright one, at its necks.

    Uses the watershed of the distance to the border (S. Beucher and C. Lantuejoul, 1979), as is
    usual for touching nuclei.

    Returns
    -------
    (Z, Y, X) int32 with the names of points; and of the points that have no part of their own, the
    one whose part they lie in.
    """
    parts, of = np.zeros(whole.shape, np.int32), dict[int, int]()
    first_at = {place: name for name, place in sorted(at.items(), reverse=True) if whole[place]}
    names = sorted(first_at.values()) if bright else []
    if len(names) < 2:
        first, *others = sorted(at)
        parts[whole] = first
        return parts, dict.fromkeys(others, first)
    (box,) = ndimage.find_objects(whole.astype(np.uint8))
    deep = depths(whole[box], size)
    while True:
        markers = np.zeros(deep.shape, np.int32)
        for name in names:
            markers[tuple(k - s.start for k, s in zip(at[name], box, strict=True))] = name
        found = watershed(-deep, markers, mask=whole[box])
        one = _without_neck(found, deep)
        if one is None:
            break
        of[one[1]] = one[0]
        names.remove(one[1])
    parts[box] = found
    unnamed = at.keys() - set(names) - set(of)
    return parts, of | {name: first_at.get(at[name], names[0]) for name in unnamed}


def _without_neck(parts: Labels, deep: FloatArray) -> tuple[int, int] | None:
    """Return two parts without a neck between them, the lower number first; None if all have."""
    deepest = ndimage.maximum(deep, parts, range(int(parts.max()) + 1))
    for name in np.unique(parts[parts > 0])[::-1].tolist():
        beside = ndimage.binary_dilation(parts == name) & (parts > 0) & (parts < name)
        for other in np.unique(parts[beside]).tolist():
            neck = float(deep[beside & (parts == other)].max())
            if neck > _NECK * min(deepest[name], deepest[other]):
                return other, name
    return None


def _in_bright(smooth: FloatArray, labels: Labels, at: dict[int, tuple[int, ...]]) -> list[int]:
    """Return points that are brighter than nearly all of the dark region that they name."""
    found = []
    for name, box in label_boxes(labels):
        level = np.percentile(smooth[box][labels[box] == name], _BRIGHT)
        found += [name] if smooth[at[name]] > level else []
    return found


def _hardly_dark(smooth: FloatArray, labels: Labels) -> list[int]:
    """Return dark regions that are nearly as bright as their crests."""
    ground, found = np.percentile(smooth, _DARK), []
    for name, box in label_boxes(labels):
        around = widened(box, 1, labels.shape)
        own = labels[around] == name
        above = float(np.median(smooth[around][own])) - ground
        found += [name] if above > _DIM * (_crest(smooth[around], own) - ground) else []
    return found


def _crest(smooth: FloatArray, region: np.ndarray) -> float:
    """Return the brightness where a region ends, the border of the image not included."""
    ends = region & ~ndimage.binary_erosion(region, border_value=1)
    return float(np.median(smooth[ends])) if ends.any() else np.inf


def _shines_around(smooth: FloatArray, region: np.ndarray, found: CellsFound) -> bool:
    """Whether the bright cell around a dark region is about as bright as the region's crest.

    Beyond a membrane, brightness falls at once.
    """
    ground = np.percentile(smooth, _DARK)
    cell = np.bincount(found.labels[region]).argmax()
    around = (found.labels == cell) & ~region & (cell > 0)
    least = ground + _NEARLY * (_crest(smooth, region) - ground)
    return bool(around.any() and (smooth[around] > least).mean() > _WIDE)


def _cells(data: FloatArray, size: FloatArray) -> CellsFound | None:
    """Return the cells that are found without points; None if there are none."""
    # Imported where it is needed, as that takes a while.
    from .bright_cells import cells_of

    try:
        return cells_of(data, size.tolist())
    except InputError:
        return None
