"""Cells found in an image of membranes, with no other help than how large a cell is.

The image is smoothed by a small part of the size of a cell and its contrast is compressed, so that
dim walls count next to bright ones. Every minimum of a somewhat smoother copy starts a region, and
a watershed grows them up to the crests: there are then several regions in each cell and many in
the outside. Regions that no wall divides are joined (`region_merging`). What is then enclosed by
walls and about as large as a cell is one. The outside needs no marker, so none can flood a cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from skimage.morphology import local_minima
from skimage.segmentation import watershed

from napari_deltamic.errors import NoCellsFound
from napari_deltamic.geometry.labels.basins import border_area, noise_after, noise_gain
from napari_deltamic.geometry.labels.cell_rules import FINDING
from napari_deltamic.geometry.labels.checked_image import (
    Mask,
    checked_image,
    checked_size,
    mean_side,
)
from napari_deltamic.geometry.labels.clear_rims import clear_rims, noise_magnitudes
from napari_deltamic.geometry.labels.region_merging import Image, Labels, Regions, join_regions
from napari_deltamic.geometry.labels.solidity import solidity
from napari_deltamic.geometry.mesh import FloatArray


def find_cells(
    image: ArrayLike,
    voxel_size: Sequence[float],
    size: float,
) -> NDArray[np.int32]:
    """Label the cells of an image of bright membranes.

    Parameters
    ----------
    image : (Z, Y, X) array; NaN where missing.
    voxel_size : um, Z, Y, X.
    size : um; the diameter of a usual cell. Cells of 0.4 to 2 times this are found.

    Returns
    -------
    (Z, Y, X) int32: 1 to n, up to the crest of the membranes; 0 is background.

    Raises
    ------
    InputError
        Not 3D, not numbers, the same everywhere, a size that is not positive, is larger than the
        image or too small for its voxels, or no cell found.
    """
    return walled_cells(image, voxel_size, size).labels


@dataclass(frozen=True, eq=False)
class WalledCells:
    """What walls enclose.

    Attributes
    ----------
    labels : (Z, Y, X) int32: 1 to n; 0 is background.
    surely : (n,) whether walls all around tell the cell; else the border of the image cuts so much
        of it that it is only taken for one where others are.
    """

    labels: NDArray[np.int32]
    surely: NDArray[np.bool_]

    @property
    def sure(self) -> NDArray[np.int32]:
        """The labels without the cells that are not sure."""
        numbers = np.append(0, np.where(self.surely, np.arange(1, len(self.surely) + 1), 0))
        return numbers.astype(np.int32)[self.labels]


def walled_cells(image: ArrayLike, voxel_size: Sequence[float], size: float) -> WalledCells:
    """What `find_cells` finds, and which of it is sure.

    Raises
    ------
    InputError
        As `find_cells`.
    """
    data, known, voxel = checked_image(image, voxel_size)
    diameter = checked_size(size, data.shape, voxel)
    seen = _Seen(data, known, noise_magnitudes(data, known), voxel)
    found = _without_gaps(*_find(seen, diameter, FINDING.finest))
    if not found.surely.any():
        raise NoCellsFound(
            f"no cells of about {diameter:g} um were found: try another size, or start from points "
            "or labels"
        )
    return found


@dataclass(frozen=True)
class _Regions:
    """Regions that may be cells.

    Attributes
    ----------
    names : (N,) in the labels they come from.
    diameter : (N,) um, of a ball of the same volume.
    enclosed : (N,) share of its surface within the image that is on a wall.
    surely : (N,) see `WalledCells`.
    """

    names: NDArray[np.int64]
    diameter: FloatArray
    enclosed: FloatArray
    surely: Mask

    def of(self, chosen: list[int] | Mask) -> _Regions:
        """Only these."""
        names, diameter = self.names[chosen], self.diameter[chosen]
        return _Regions(names, diameter, self.enclosed[chosen], self.surely[chosen])


@dataclass(frozen=True)
class _Seen:
    """An image, its gaps filled, where it is known, its noise, and its voxel.

    The noise is that of ``noise_magnitudes``; None where it cannot be told.
    """

    data: Image
    known: Mask
    noise: Image | None
    voxel: FloatArray

    def coarsened(self, step: NDArray[np.int_]) -> _Seen:
        """Means of blocks of voxels."""
        blocks = np.float32(np.prod(step) ** 0.5)
        half = 0.5  # by definition
        return _Seen(
            coarsened_image(self.data, step),
            coarsened_image(self.known.astype(np.float32), step) > half,
            None if self.noise is None else coarsened_image(self.noise, step) / blocks,
            self.voxel * step,
        )


@dataclass(frozen=True)
class SizeFound:
    """What is found with a size, on a coarse copy of an image.

    Attributes
    ----------
    size
        um: diameter of the typical cell.
    cells
        How many, about.
    score
        How much is found that has this size indeed.
    """

    size: float
    cells: int
    score: float


def suggest_size(image: ArrayLike, voxel_size: Sequence[float]) -> float:
    """The diameter (um) of the cells of an image, roughly: a start for `find_cells`.

    The best of ``suggest_sizes``; where nothing is found, a quarter of the image.

    Raises
    ------
    InputError
        As `find_cells`.
    """
    return likeliest(suggest_sizes(image, voxel_size), np.shape(image), voxel_size)


def likeliest(
    tried: Sequence[SizeFound], shape: Sequence[int], voxel_size: Sequence[float] | FloatArray
) -> float:
    """um: the first of the sizes tried; where there is none, a quarter of the image."""
    return tried[0].size if tried else float(np.max(np.multiply(shape, voxel_size))) / 4


def suggest_sizes(image: ArrayLike, voxel_size: Sequence[float]) -> list[SizeFound]:
    """Sizes that the cells of an image may have, the likeliest first.

    Several are tried on a coarse copy. Those are taken with which most is found that has this size
    indeed; of two that are alike, the better one.

    Raises
    ------
    InputError
        As `find_cells`.
    """
    data, known, voxel = checked_image(image, voxel_size)
    extent = np.array(data.shape) * voxel
    told = known.mean() * np.prod(extent)
    step = np.floor(np.cbrt(told / FINDING.tried_voxels) / voxel).astype(int)
    step = np.clip(step, 1, data.shape)
    seen = _Seen(data, known, noise_magnitudes(data, known), voxel).coarsened(step)
    size, tried = FINDING.first_tried * float(extent.max()), list[SizeFound]()
    while size >= FINDING.smallest_tried * mean_side(seen.voxel):
        _, found = _find(seen, size, 0.0)
        found = found.of(found.surely)
        if len(found.names):
            typical = float(np.median(found.diameter))
            # Pieces of cells and of the outside are less enclosed than cells.
            enclosed = float((found.enclosed**4 * found.diameter**3).sum())
            score = enclosed * np.exp(-2 * np.log(typical / size) ** 2)
            tried.append(SizeFound(typical, len(found.names), score))
        size /= FINDING.step
    kept: list[SizeFound] = []
    for one in sorted(tried, key=lambda one: -one.score):
        if one.score > 0 and all(abs(np.log(one.size / x.size)) > FINDING.alike for x in kept):
            kept.append(one)
    return kept


def _find(seen: _Seen, size: float, finest: float) -> tuple[Labels, _Regions]:
    """Labels of the cells, and what they are."""
    step = np.maximum(np.floor(finest * size / seen.voxel), 1).astype(int)
    step = np.minimum(step, seen.data.shape)
    coarse = seen.coarsened(step)
    side = coarse.voxel
    walls = compressed_walls(coarse.data, side, size, coarse.known)
    calm = ndimage.gaussian_filter(walls, FINDING.seed_smoothing * size / side, mode="nearest")
    seeds, _ = ndimage.label(local_minima(calm) & coarse.known)
    ball = np.pi / 6 * size**3
    pieces = watershed(walls, seeds, mask=coarse.known).astype(np.int32)
    regions = join_regions(pieces, walls, side, ball)
    cells = _cells(regions, coarse, size)
    labels, kept = _trimmed(regions.labels, cells.names, side, size)
    return _refined(labels, step, seen, size), cells.of(kept)


def _wall_sigma(side: FloatArray, size: float) -> FloatArray:
    """Standard deviation, in voxels, of the Gaussian that smooths walls."""
    sigma: FloatArray = max(FINDING.smoothing * size, FINDING.sharpest * float(side.min())) / side
    return sigma


def compressed_walls(
    data: Image, side: FloatArray, size: float, known: Mask | None = None
) -> Image:
    """The smoothed image with its contrast compressed: dim walls count next to bright ones.

    Noise and contrast are those where the image is known (None: everywhere).
    """
    sigma = _wall_sigma(side, size)
    smooth = ndimage.gaussian_filter(data, sigma, mode="nearest")
    told = smooth if known is None else smooth[known]
    low, high = np.percentile(told, FINDING.percentiles)
    floor = max(
        FINDING.floor * float(high - low),
        FINDING.floor_noise * noise_after(data.astype(np.float64), sigma, known),
    )
    if not floor > 0:  # nearly all voxels are alike
        floor = max(FINDING.floor * float(np.ptp(told)), float(np.finfo(np.float32).tiny))
    walls: Image = np.log(np.maximum(smooth - low, 0) / floor + 1).astype(np.float32)
    return walls


def _cells(regions: Regions, seen: _Seen, size: float) -> _Regions:
    """The regions that are cells: enclosed, of about the size, not mostly on the border."""
    n, side = len(regions.volume), seen.voxel
    flat = regions.labels.ravel()
    border = np.bincount(flat, border_area(regions.labels.shape, side, seen.known).ravel(), n)
    diameter = np.cbrt(6 / np.pi * regions.volume)
    smallest, largest = FINDING.sizes
    good = (diameter >= smallest * size) & (diameter <= largest * size)
    share = border / np.maximum(np.pi * diameter**2, np.finfo(float).tiny)
    good &= share <= FINDING.border
    bright = regions.enclosed >= _least(share, FINDING.enclosed, FINDING.enclosed_at_border)
    bright &= regions.height >= FINDING.height
    quality, surely = np.where(bright, regions.enclosed, 0), bright
    if seen.noise is not None:
        sigma = _wall_sigma(side, size)
        smooth = ndimage.gaussian_filter(seen.data, sigma, mode="nearest")
        reach = FINDING.noise_reach * size / side
        noise = ndimage.gaussian_filter(seen.noise, reach, mode="nearest") * noise_gain(sigma)
        clear, height = clear_rims(regions.labels, n, smooth, noise, side)
        high = (height >= FINDING.rim_mean) & (regions.height >= FINDING.rim_contrast)
        least = _least(share, FINDING.clear, FINDING.clear_at_border)
        sure = high & (share <= FINDING.clear_border) & (clear >= least)
        least = FINDING.clear + FINDING.likely_per_border * share
        likely = high & (share <= FINDING.likely_border) & (clear >= least)
        quality, surely = np.maximum(quality, np.where(sure | likely, clear, 0)), bright | sure
    good &= quality > 0
    good[0] = False  # what is missing
    names = np.flatnonzero(good)
    return _Regions(names, diameter[names], quality[names], surely[names])


def _least(at_border: FloatArray, within: float, most: float) -> FloatArray:
    """What share of a surface must be enclosed, from how much lies on the border."""
    return np.maximum(within, np.minimum(within + at_border, most))


def _trimmed(
    labels: Labels, names: NDArray[np.int64], side: FloatArray, size: float
) -> tuple[Labels, list[int]]:
    """Only the cells, from 1, each in one part without holes and without what has leaked out.

    And which of the names they are, since of some nothing is left.
    """
    result = np.zeros_like(labels)
    radius = FINDING.leak * size
    boxes = ndimage.find_objects(labels)
    whose: list[int] = []
    for place, name in enumerate(names):
        box = boxes[name - 1]
        solid = np.pad(ndimage.binary_fill_holes(labels[box] == name), 1)
        core = ndimage.distance_transform_edt(solid, side) > radius
        parts, count = ndimage.label(core)
        if not count:
            continue
        core = parts == 1 + np.bincount(parts.ravel())[1:].argmax()
        # The corners of a cell come back, its tongues do not.
        kept = solid & (ndimage.distance_transform_edt(~core, side) <= FINDING.corners * radius)
        whose.append(place)
        inner = kept[1:-1, 1:-1, 1:-1]
        result[box][inner & (result[box] == 0)] = len(whose)
    return result, whose


def _without_gaps(labels: Labels, found: _Regions) -> WalledCells:
    """Only the cells, from 1: gaps between them are less enclosed, and concave.

    They are as dark inside as cells are, and what encloses them are the walls of cells.
    """
    if not len(found.names):
        return WalledCells(labels, found.surely)
    volume = found.diameter**3
    boxes = enumerate(ndimage.find_objects(labels, len(found.names)), 1)  # one may be covered
    solid = np.array([0.0 if box is None else solidity(labels[box] == k) for k, box in boxes])
    closed, solid = (x / _upper_quartile(x, volume) for x in (found.enclosed, solid))
    whole = (closed * solid >= FINDING.gap) | (closed >= FINDING.closed)
    cells = np.flatnonzero(np.where(found.surely, whole, closed * solid >= FINDING.likely_gap))
    numbers = np.zeros(len(solid) + 1, labels.dtype)
    numbers[cells + 1] = np.arange(1, len(cells) + 1)
    return WalledCells(numbers[labels], found.surely[cells])


def _upper_quartile(values: FloatArray, volume: FloatArray) -> float:
    """By volume: gaps may be many, but they are small."""
    order = np.argsort(values)
    below = np.cumsum(volume[order])
    place = 0.75 * below[-1]  # by definition
    return float(values[order][np.searchsorted(below, place)])


def _refined(labels: Labels, step: NDArray[np.int_], seen: _Seen, size: float) -> Labels:
    """Labels on the voxels of the image, their borders moved onto the crests."""
    if (step == 1).all():
        return labels
    for axis, times in enumerate(step):
        labels = np.repeat(labels, times, axis=axis)
    pad = [(0, max(n - m, 0)) for n, m in zip(seen.data.shape, labels.shape, strict=True)]
    labels = np.pad(labels, pad, mode="edge")[tuple(slice(n) for n in seen.data.shape)]
    width = tuple(int(2 * s + 1) if s > 1 else 1 for s in step)
    low = ndimage.minimum_filter(labels, width, mode="nearest")
    sure = low == ndimage.maximum_filter(labels, width, mode="nearest")
    if not labels.any():
        return labels
    # The background is a marker, too: it is known where it lies, up to the width of a step.
    markers = np.where(sure, np.where(labels == 0, labels.max() + 1, labels), 0)
    walls = compressed_walls(seen.data, seen.voxel, size, seen.known)
    fine = watershed(walls, markers, mask=seen.known).astype(np.int32)
    fine[fine == labels.max() + 1] = 0
    return fine


def coarsened_image(data: Image, step: NDArray[np.int_]) -> Image:
    """Means of blocks of voxels; the last block of an axis takes in what is left over."""
    for axis, times in enumerate(step):
        if times > 1:
            starts = np.arange(0, max(data.shape[axis] // times, 1) * times, times)
            count = np.diff(np.append(starts, data.shape[axis]))
            shape = [-1 if a == axis else 1 for a in range(3)]
            sums = np.add.reduceat(data, starts, axis=axis)
            data = (sums / count.reshape(shape)).astype(np.float32)
    return data
