"""Finds cells in an image of membranes, given only how large a cell is.

The image is smoothed by a small part of the size of a cell and its contrast is compressed, so that
dim walls count beside bright ones. Every minimum of a somewhat smoother copy starts a region, and a
watershed grows them up to the crests: there are then several regions in each cell and many outside.
Regions that no wall divides are joined (`region_merging`). A region that is then enclosed by walls
and about as large as a cell is one. The outside needs no marker, so none can flood a cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from skimage.morphology import local_minima
from skimage.segmentation import watershed

from ...common.ball import ball_radius
from ...errors import NoCellsFound
from ..distance_transform import distance_transform
from ..mesh import FloatArray
from .basins import border_area, noise_after, noise_gain
from .cell_rules import FINDING
from .checked_image import Mask, checked_image, checked_size
from .clear_rims import clear_rims, noise_magnitudes
from .even_walls import even_walls
from .region_merging import Image, Labels, Regions, join_regions
from .solidity import solidities
from .voxels import largest_part, renumbered


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
    size : um; the diameter of a typical cell. Cells of 0.4 to 2 times this are found.

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
    """Cells that walls enclose.

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

    def of(self, kept: NDArray[np.bool_]) -> WalledCells:
        """Only some of the cells; kept : (n,)."""
        return WalledCells(renumbered(self.labels, kept), self.surely[kept])


def walled_cells(image: ArrayLike, voxel_size: Sequence[float], size: float) -> WalledCells:
    """Find the same cells as `find_cells`, and say which of them are sure.

    Raises
    ------
    InputError
        As `find_cells`.
    """
    data, known, voxel = checked_image(image, voxel_size)
    diameter = checked_size(size, data.shape, voxel)
    seen = Seen(data, known, noise_magnitudes(data, known), voxel)
    found = without_gaps(*regions_of_size(seen, diameter, FINDING.finest))
    if not found.surely.any():
        raise none_found(diameter)
    return found


def none_found(diameter: float) -> NoCellsFound:
    """Return the error for cells of which there are none; diameter : um."""
    return NoCellsFound(
        f"no cells of about {diameter:.3g} um were found: try another size, check the voxel size, "
        "or start from points or labels"
    )


@dataclass(frozen=True)
class RegionsFound:
    """Regions that may be cells.

    Attributes
    ----------
    names : (N,) in the labels they come from.
    diameter : (N,) um, of a ball of the same volume.
    enclosed : (N,) share of its surface within the image that is on a wall.
    surely : (N,) see `WalledCells`.
    walled : (N,) how even its wall is times how solid it is; 1 at most.
    """

    names: NDArray[np.int64]
    diameter: FloatArray
    enclosed: FloatArray
    surely: Mask
    walled: FloatArray

    def of(self, chosen: list[int] | Mask) -> RegionsFound:
        """Return only the chosen regions."""
        return RegionsFound(*(getattr(self, part.name)[chosen] for part in fields(self)))


@dataclass(frozen=True)
class Seen:
    """An image without gaps, where it is known, its noise, and the sides of its voxels.

    The noise is that of ``noise_magnitudes``; None where it cannot be told.
    """

    data: Image
    known: Mask
    noise: Image | None
    voxel: FloatArray

    def coarsened(self, step: NDArray[np.int_]) -> Seen:
        """Return the means of blocks of voxels."""
        blocks = np.float32(np.prod(step) ** 0.5)
        half = 0.5  # by definition
        return Seen(
            coarsened_image(self.data, step),
            coarsened_image(self.known.astype(np.float32), step) > half,
            None if self.noise is None else coarsened_image(self.noise, step) / blocks,
            self.voxel * step,
        )


def regions_of_size(seen: Seen, size: float, finest: float) -> tuple[Labels, RegionsFound]:
    """Find cells of a size; returns their labels and what was measured on them."""
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
    smooth = ndimage.gaussian_filter(coarse.data, _wall_sigma(side, size), mode="nearest")
    even = even_walls(regions.labels, cells.names, smooth, side)
    labels, kept = _trimmed(regions.labels, cells.names, side, size)
    cells = replace(cells.of(kept), walled=even[kept] * solidities(labels, len(kept)))
    good = cells.walled >= FINDING.even
    return _refined(renumbered(labels, good), step, seen, size), cells.of(good)


def _wall_sigma(side: FloatArray, size: float) -> FloatArray:
    """Return the standard deviation, in voxels, of the Gaussian that smooths walls."""
    sigma: FloatArray = max(FINDING.smoothing * size, FINDING.sharpest * float(side.min())) / side
    return sigma


def compressed_walls(
    data: Image, side: FloatArray, size: float, known: Mask | None = None
) -> Image:
    """Smooth an image and compress its contrast, so that dim walls count beside bright ones.

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


def _cells(regions: Regions, seen: Seen, size: float) -> RegionsFound:
    """Select the regions that are cells: enclosed, of about the size, not mostly on the border."""
    n, side = len(regions.volume), seen.voxel
    flat = regions.labels.ravel()
    border = np.bincount(flat, border_area(regions.labels.shape, side, seen.known).ravel(), n)
    diameter = 2 * ball_radius(regions.volume)
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
    return RegionsFound(names, diameter[names], quality[names], surely[names], np.ones(len(names)))


def _least(at_border: FloatArray, within: float, most: float) -> FloatArray:
    """Return the share of a surface that must be enclosed, from how much lies on the border."""
    return np.maximum(within, np.minimum(within + at_border, most))


def _trimmed(
    labels: Labels, names: NDArray[np.int64], side: FloatArray, size: float
) -> tuple[Labels, list[int]]:
    """Keep only the cells, from 1, each in one part without holes and without what has leaked out.

    Also return which of the names they are, since nothing is left of some.
    """
    result = np.zeros_like(labels)
    radius = FINDING.leak * size
    boxes = ndimage.find_objects(labels)
    whose: list[int] = []
    for place, name in enumerate(names):
        box = boxes[name - 1]
        solid = np.pad(ndimage.binary_fill_holes(labels[box] == name), 1)
        core = largest_part(distance_transform(solid, side) > radius)
        if not core.any():
            continue
        # The corners of a cell come back, its tongues do not.
        kept = solid & (distance_transform(~core, side) <= FINDING.corners * radius)
        whose.append(place)
        inner = kept[1:-1, 1:-1, 1:-1]
        result[box][inner & (result[box] == 0)] = len(whose)
    return result, whose


def without_gaps(labels: Labels, found: RegionsFound) -> WalledCells:
    """Keep only the cells, from 1: gaps between them are less enclosed, and concave.

    Gaps are as dark inside as cells are, and are enclosed by the walls of cells.
    """
    if not len(found.names):
        return WalledCells(labels, found.surely)
    volume = found.diameter**3
    solid = solidities(labels, len(found.names))
    closed, solid = (x / upper_quartile(x, volume) for x in (found.enclosed, solid))
    whole = (closed * solid >= FINDING.gap) | (closed >= FINDING.closed)
    cells = np.where(found.surely, whole, closed * solid >= FINDING.likely_gap)
    cells &= found.walled >= FINDING.as_even * upper_quartile(found.walled, volume)
    return WalledCells(renumbered(labels, cells), found.surely[cells])


def upper_quartile(values: FloatArray, volume: FloatArray) -> float:
    """Upper quartile of values weighted by volume: gaps may be many, but they are small."""
    order = np.argsort(values)
    below = np.cumsum(volume[order])
    place = 0.75 * below[-1]  # by definition
    return float(values[order][np.searchsorted(below, place)])


def _refined(labels: Labels, step: NDArray[np.int_], seen: Seen, size: float) -> Labels:
    """Refine coarse labels to the voxels of the image, with borders moved onto the crests."""
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
    """Return means of blocks of voxels; an axis's last block includes the voxels left over."""
    for axis, times in enumerate(step):
        if times > 1:
            starts = np.arange(0, max(data.shape[axis] // times, 1) * times, times)
            count = np.diff(np.append(starts, data.shape[axis]))
            shape = [-1 if a == axis else 1 for a in range(3)]
            sums = np.add.reduceat(data, starts, axis=axis)
            data = (sums / count.reshape(shape)).astype(np.float32)
    return data
