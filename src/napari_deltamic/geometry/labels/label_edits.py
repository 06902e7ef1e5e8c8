"""Corrects found cells by clicks: a missed cell, two cells in one, one cell in two parts.

An automatic segmentation is right for most cells and wrong for a few. A click says where, the image
says how far: cells are divided and added by a watershed on the membranes, as in `find_cells`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from skimage.graph import MCP_Geometric
from skimage.segmentation import watershed

from ...common.ball import ball_radius
from ...errors import InputError
from ..distance_transform import distance_transform
from ..mesh import FloatArray
from .cell_rules import CLICKS
from .checked_image import checked_image
from .find_cells import compressed_walls
from .region_merging import Image, Labels
from .regions_at_points import regions_at
from .voxels import depths

Action = Literal["cell", "merge", "remove"]
_Place = tuple[int, ...]
_Clicks = list[tuple[int, _Place]]  # number from 0, voxel


@dataclass(frozen=True)
class Click:
    """A correction at one place.

    place : um, Z, Y, X.
    action : "cell": a cell of its own lies here. In the background it is added; in a label it is
        cut off from the rest of it, or the label is divided among several clicks in it.
        "merge": the labels here and at the next "merge" click are one cell. "remove": the label
        here is no cell.
    step : clicks of one step are applied together; those of later steps act on the result.
    """

    place: tuple[float, float, float]
    action: Action = "cell"
    step: int = 0


class Corrector:
    """Corrects labels of one image, click by click; its membranes are computed only once.

    Parameters
    ----------
    image : (Z, Y, X), membranes bright; NaN where missing.
    voxel_size : um, Z, Y, X.
    """

    def __init__(self, image: ArrayLike, voxel_size: Sequence[float]) -> None:
        self._data, _, self._voxel = checked_image(image, voxel_size)
        self._size = 0.0  # um, of a typical cell of the first labels; 0 before there are any
        self._found: Image | None = None

    def corrected(self, labels: ArrayLike, clicks: Sequence[Click]) -> NDArray[np.int32]:
        """Return labels with the corrections of clicks; see :func:`correct_labels`."""
        result = np.array(labels, np.int32)
        if result.shape != self._data.shape:
            raise InputError(f"the labels have shape {result.shape}, the image {self._data.shape}")
        if not clicks:
            return result
        places = _voxels(clicks, self._voxel, result.shape)
        self._size = self._size or _typical(result, self._voxel)
        for step in sorted({click.step for click in clicks}):
            numbered = [(k, c.action) for k, c in enumerate(clicks) if c.step == step]
            removed, merged, new = (
                [(k, places[k]) for k, action in numbered if action == name]
                for name in ("remove", "merge", "cell")
            )
            _remove(result, removed)
            _merge(result, merged, self._voxel, self._size)
            self._cut_and_add(result, new)
        return result

    def _cut_and_add(self, labels: Labels, clicks: _Clicks) -> None:
        if not clicks:
            return
        if self._found is None:
            self._found = compressed_walls(self._data, self._voxel, self._size)
        fewest = max(CLICKS.fewest, CLICKS.crumb * self._voxels_of_cell())
        # Everything is checked before anything is changed.
        names = [int(labels[place]) for _, place in clicks]
        for name in sorted(set(names)):
            own = [click for click, n in zip(clicks, names, strict=True) if n == name]
            if name:
                _cut(labels, self._found, name, own, self._voxel, fewest)
        missing = [click for click, n in zip(clicks, names, strict=True) if n == 0]
        if missing:
            least = CLICKS.named * self._voxels_of_cell()
            _add(
                labels,
                self._found,
                self._data,
                missing,
                self._voxel,
                self._size,
                fewest,
                max(fewest, least),
            )

    def _voxels_of_cell(self) -> float:
        """Number of voxels in a ball with the diameter of a typical cell."""
        return float(np.pi / 6 * self._size**3 / np.prod(self._voxel))


def correct_labels(
    image: ArrayLike,
    voxel_size: Sequence[float],
    labels: ArrayLike,
    clicks: Sequence[Click],
) -> NDArray[np.int32]:
    """Return labels with the corrections of clicks.

    Steps follow each other; in each, labels are first removed, then merged, cut, and added.

    Parameters
    ----------
    image : (Z, Y, X), membranes bright; NaN where missing.
    voxel_size : um, Z, Y, X; clicks count from the centre of the first voxel.
    labels : (Z, Y, X) integers, 0 = background, as `find_cells` gives.
    clicks : numbered from 1 in messages.

    Returns
    -------
    (Z, Y, X) int32. Labels that no click names keep their number; new ones follow the largest.

    Raises
    ------
    InputError
        Labels and image differ in shape; a click lies outside the image or where its action has no
        meaning; the number of "merge" clicks is odd.
    """
    return Corrector(image, voxel_size).corrected(labels, clicks)


# Actions --------------------------------------------------------------------------------------


def _remove(labels: Labels, clicks: _Clicks) -> None:
    for k, place in clicks:
        labels[labels == _label_at(labels, k, place)] = 0


def _merge(labels: Labels, clicks: _Clicks, voxel: FloatArray, size: float) -> None:
    if len(clicks) % 2:
        raise InputError(f"click {clicks[-1][0] + 1} has no partner to merge with: click in pairs")
    for (i, first), (j, second) in zip(clicks[::2], clicks[1::2], strict=True):
        one, other = _label_at(labels, i, first), _label_at(labels, j, second)
        if one == other:
            raise InputError(f"clicks {i + 1} and {j + 1} lie in the same cell already")
        both = (labels == one) | (labels == other)
        # The seam between them, where one was left.
        reach = CLICKS.marker * size
        near = distance_transform(~both, voxel) <= reach
        closed = near & (distance_transform(near, voxel) > reach)
        labels[both | (closed & (labels == 0))] = one
        if ndimage.label(labels == one)[1] > 1:
            raise InputError(f"clicks {i + 1} and {j + 1} lie in cells that do not touch")


def _cut(
    labels: Labels, walls: Image, name: int, clicks: _Clicks, voxel: FloatArray, fewest: float
) -> None:
    """Divide a label among the clicks in it, or between a single click and the rest of it."""
    box = ndimage.find_objects((labels == name).astype(np.int8))[0]
    corner = [s.start for s in box]
    inside = labels[box] == name
    cost = np.where(inside, CLICKS.flat + walls[box] ** 2, np.inf)
    centres = [tuple(np.subtract(place, corner)) for _, place in clicks]
    first = np.array(centres)
    if len(centres) == 1:
        # The other cell's middle: the place that is hardest to reach, well inside the label.
        deep = depths(inside, voxel)
        # The least cost around it, as a bright speck is hard to reach, too.
        around = tuple(int(n) for n in 1 + 2 * np.ceil(CLICKS.marker * float(deep.max()) / voxel))
        reached = ndimage.minimum_filter(_ways(cost, first, voxel), around)
        reached = np.where((deep > 0.5 * deep.max()) & np.isfinite(reached), reached, -1.0)
        centres.append(np.unravel_index(int(reached.argmax()), reached.shape))
    parts = _nearest(cost, centres, voxel)
    for k in range(len(centres)):
        if (parts[inside] == k).sum() < fewest:
            numbers = " and ".join(str(k + 1) for k, _ in clicks)
            raise InputError(f"click {numbers} cuts nothing off: click in the middle of the cell")
    for k in range(len(clicks) - (len(clicks) == len(centres))):
        # The largest number stays free for the next; with several clicks the last keeps the name.
        labels[box][inside & (parts == k)] = int(labels.max()) + 1


def _add(
    labels: Labels,
    walls: Image,
    image: Image,
    clicks: _Clicks,
    voxel: FloatArray,
    size: float,
    fewest: float,
    fewest_named: float,
) -> None:
    """Flood the background from the clicks, bounded by cells around and by the largest reach.

    If no wall closes around a click, the cell is what a point there would name in the image, such
    as a nucleus.
    """
    places = np.array([place for _, place in clicks])
    reach, seen = CLICKS.reach
    room = np.ceil(seen * reach * size / voxel).astype(int)
    low = np.maximum(places.min(0) - room, 0)
    box = tuple(slice(a, b) for a, b in zip(low, places.max(0) + room + 1, strict=True))
    own, landscape = labels[box], walls[box]
    free = own == 0
    spot = np.ones(own.shape, bool)
    spot[tuple((places - low).T)] = False
    away = distance_transform(spot, voxel)
    outside, new = int(labels.max()) + 1, int(labels.max()) + 2
    markers = own.copy()
    markers[free & (away > reach * size)] = outside
    markers[free & (away <= CLICKS.marker * size)] = new
    region = free & (watershed(landscape, markers) == new)
    cost = np.where(region, CLICKS.flat + landscape**2, np.inf)
    parts = _nearest(cost, list(places - low), voxel)
    parts = np.where(region, parts + 1, 0)
    for k, (part, (click, _)) in enumerate(
        zip(ndimage.find_objects(parts, len(clicks)), clicks, strict=True)
    ):
        cell = np.zeros(own.shape, bool)
        if part is not None:
            place = tuple(places[k] - low - [s.start for s in part])
            cell[part] = _rounded(parts[part] == k + 1, place, voxel, size)
        if cell.sum() < fewest or _edge(landscape, cell) < CLICKS.edge:
            cell = _named(image[box], own == 0, places[k] - low, voxel)
            if cell.sum() < fewest_named:
                raise _unseen(click)
        own[cell] = outside + k


def _named(
    image: Image, free: NDArray[np.bool_], place: NDArray[np.int_], voxel: FloatArray
) -> NDArray[np.bool_]:
    """Return the connected part, without other labels, of what a point names in an image."""
    found, _ = regions_at(np.asarray(image, np.float64), voxel, place[None], [1])
    parts, _ = ndimage.label((found == 1) & free)
    here: int = parts[tuple(place)]
    return np.asarray((parts == here) & (here > 0))


def _unseen(click: int) -> InputError:
    where = "is it on a membrane, or in the background?"
    return InputError(f"no cell is seen around click {click + 1}: {where}")


def _edge(walls: Image, cell: NDArray[np.bool_]) -> float:
    """Return by how much the rim of a cell is brighter, or darker, than its core."""
    core = ndimage.binary_erosion(cell)
    core = core if core.any() else cell
    rim = ndimage.binary_dilation(cell, iterations=2) & ~core
    return abs(float(walls[rim].mean()) - float(walls[core].mean()))


def _nearest(cost: FloatArray, centres: Sequence[_Place], voxel: FloatArray) -> NDArray[np.intp]:
    """Return the index of the centre that each voxel is nearest to, by ways that avoid walls.

    Where a wall has a gap, or is not seen at all, the border runs half-way between the centres.
    """
    ways = [_ways(cost, np.array([centre]), voxel) for centre in centres]
    nearest: NDArray[np.intp] = np.argmin(ways, axis=0)
    return nearest


def _ways(cost: FloatArray, starts: NDArray[np.int_], voxel: FloatArray) -> FloatArray:
    """Return the cost of the cheapest way from any of the starts; inf if there is none."""
    ways: FloatArray = MCP_Geometric(cost, sampling=tuple(voxel)).find_costs(starts)[0]
    return ways


def _rounded(
    mask: NDArray[np.bool_], place: _Place, voxel: FloatArray, size: float
) -> NDArray[np.bool_]:
    """Return the part of a mask around a place, without tongues and holes."""
    radius = CLICKS.thin * size
    core = depths(mask, voxel) > radius
    spot = np.ones(mask.shape, bool)
    spot[place] = False
    core |= mask & (distance_transform(spot, voxel) <= CLICKS.marker * size)
    parts, _ = ndimage.label(core)
    kept = mask & (distance_transform(parts != parts[place], voxel) <= CLICKS.corners * radius)
    filled: NDArray[np.bool_] = ndimage.binary_fill_holes(kept)
    return filled


# Places ---------------------------------------------------------------------------------------


def _voxels(clicks: Sequence[Click], voxel: FloatArray, shape: tuple[int, ...]) -> list[_Place]:
    places = []
    for k, click in enumerate(clicks):
        index = np.floor(np.array(click.place) / voxel + 0.5).astype(int)
        if ((index < 0) | (index >= shape)).any():
            where = ", ".join(f"{value:g}" for value in click.place)
            raise InputError(f"click {k + 1} ({where} um) lies outside the image")
        places.append(tuple(int(i) for i in index))
    return places


def _label_at(labels: Labels, click: int, place: _Place) -> int:
    if not labels[place]:
        raise InputError(f"click {click + 1} lies in no cell")
    return int(labels[place])


def _typical(labels: Labels, voxel: FloatArray) -> float:
    """Return the median diameter (um) of the labels; a fifth of the image if there are none."""
    counts = np.unique(labels[labels > 0], return_counts=True)[1]
    if not len(counts):
        return float((np.array(labels.shape) * voxel).max()) / 5
    return float(2 * ball_radius(np.median(counts) * np.prod(voxel)))
