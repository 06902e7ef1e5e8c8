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
from scipy.spatial import ConvexHull
from skimage.morphology import local_minima
from skimage.segmentation import watershed

from napari_deltamic.errors import InputError, NoCellsFound
from napari_deltamic.geometry.labels.basins import border_area, noise_after, noise_gain
from napari_deltamic.geometry.labels.cell_rules import FINDING
from napari_deltamic.geometry.labels.clear_rims import clear_rims, noise_magnitudes
from napari_deltamic.geometry.labels.region_merging import Image, Labels, Regions, join_regions
from napari_deltamic.geometry.mesh import FloatArray
from napari_deltamic.geometry.three_numbers import three_numbers
from napari_deltamic.images.missing import filled, unmasked

Mask = NDArray[np.bool_]
_GAP = np.ones((3, 3, 3), bool)  # chosen: narrower ones are bridged


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
    data, known, voxel = checked_image(image, voxel_size)
    diameter = _checked_size(size, data.shape, voxel)
    seen = _Seen(data, known, noise_magnitudes(data, known), voxel)
    labels, diameters, enclosed = _find(seen, diameter, FINDING.finest)
    labels = _without_gaps(labels, enclosed, diameters**3)
    if not labels.any():
        raise NoCellsFound(
            f"no cells of about {diameter:g} um were found: try another size, or start from points "
            "or labels"
        )
    return labels


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
    while size >= FINDING.smallest_tried * _mean_side(seen.voxel):
        _, found, enclosed = _find(seen, size, 0.0)
        if len(found):
            typical = float(np.median(found))
            # Pieces of cells and of the outside are less enclosed than cells.
            score = float((enclosed**4 * found**3).sum()) * np.exp(-2 * np.log(typical / size) ** 2)
            tried.append(SizeFound(typical, len(found), score))
        size /= FINDING.step
    kept: list[SizeFound] = []
    for one in sorted(tried, key=lambda one: -one.score):
        if one.score > 0 and all(abs(np.log(one.size / x.size)) > FINDING.alike for x in kept):
            kept.append(one)
    return kept


def _find(seen: _Seen, size: float, finest: float) -> tuple[Labels, FloatArray, FloatArray]:
    """Labels of the cells; of each its diameter (um), and how enclosed it is."""
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
    names, quality = _cells(regions, coarse, size)
    labels, kept = _trimmed(regions.labels, names, side, size)
    diameters = np.cbrt(6 / np.pi * regions.volume[names[kept]])
    return _refined(labels, step, seen, size), diameters, quality[kept]


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


def _cells(regions: Regions, seen: _Seen, size: float) -> tuple[NDArray[np.int64], FloatArray]:
    """The regions that are cells, and how enclosed each is.

    Enclosed, of about the size, and not mostly on the border.
    """
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
    quality = np.where(bright, regions.enclosed, 0)
    if seen.noise is not None:
        sigma = _wall_sigma(side, size)
        smooth = ndimage.gaussian_filter(seen.data, sigma, mode="nearest")
        reach = FINDING.noise_reach * size / side
        noise = ndimage.gaussian_filter(seen.noise, reach, mode="nearest") * noise_gain(sigma)
        clear, height = clear_rims(regions.labels, n, smooth, noise, side)
        dim = clear >= _least(share, FINDING.clear, FINDING.clear_at_border)
        dim &= share <= FINDING.clear_border
        dim &= (height >= FINDING.rim_mean) & (regions.height >= FINDING.rim_contrast)
        quality = np.maximum(quality, np.where(dim, clear, 0))
    good &= quality > 0
    good[0] = False  # what is missing
    names = np.flatnonzero(good)
    return names, quality[names]


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


def _without_gaps(labels: Labels, enclosed: FloatArray, volume: FloatArray) -> Labels:
    """Only the cells, from 1: gaps between them are less enclosed, and concave.

    They are as dark inside as cells are, and what encloses them are the walls of cells.
    """
    if not len(enclosed):
        return labels
    boxes = enumerate(ndimage.find_objects(labels), 1)
    solid = np.array([0.0 if box is None else solidity(labels[box] == k) for k, box in boxes])
    shares = [x / _upper_quartile(x, volume) for x in (enclosed, solid)]
    cells = np.flatnonzero((shares[0] * shares[1] >= FINDING.gap) | (shares[0] >= FINDING.closed))
    numbers = np.zeros(len(enclosed) + 1, labels.dtype)
    numbers[cells + 1] = np.arange(1, len(cells) + 1)
    found: Labels = numbers[labels]
    return found


def solidity(region: Mask) -> float:
    """Volume over that of the convex hull, from the middles of the faces of voxels."""
    sides = np.vstack([-np.eye(3), np.eye(3)]) / 2
    # Corners of the hull are the first or the last voxels of lines along any axis.
    along = np.moveaxis(region, int(np.argmax(region.shape)), 0)
    lines = np.argwhere(along.any(0))
    inside = along[:, lines[:, 0], lines[:, 1]]
    ends = inside.argmax(0), len(inside) - 1 - inside[::-1].argmax(0)
    outer = np.vstack([np.column_stack([end, lines]) for end in ends])
    hull = ConvexHull((outer[:, None] + sides).reshape(-1, 3))
    return float(region.sum() / hull.volume)


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


def _mean_side(voxel: FloatArray) -> float:
    return float(np.cbrt(np.prod(voxel)))


# Checks ---------------------------------------------------------------------------------------


def checked_image(image: ArrayLike, voxel_size: Sequence[float]) -> tuple[Image, Mask, FloatArray]:
    """The image, its gaps filled, where it is known, and the voxel size.

    Gaps of a voxel or a slice count as known: a cell goes on beyond them.
    """
    array = np.asarray(unmasked(image))
    if array.ndim != 3 or not array.size:
        raise InputError(f"a 3D image is needed to find cells, not one of shape {array.shape}")
    if (
        array.dtype == np.bool_
        or not np.issubdtype(array.dtype, np.number)
        or np.iscomplexobj(array)
    ):
        raise InputError(f"an image of real numbers is needed to find cells, not {array.dtype}")
    voxel = three_numbers(voxel_size, "voxel size")
    missing = ~np.isfinite(array)
    if missing.all():
        raise InputError("the image has no value anywhere")
    known = ~ndimage.binary_opening(missing, _GAP) if missing.any() else ~missing
    array = filled(array, tuple(voxel))  # flooding needs every voxel
    low, high = float(array.min()), float(array.max())
    if low == high:
        raise InputError("the image has the same value everywhere")
    # Single precision would lose a faint image on a high pedestal.
    data = ((array - array.dtype.type(low)) / (high - low)).astype(np.float32)
    return data, known, voxel


def positive_size(size: float) -> float:
    """um. InputError where it is no positive number."""
    try:
        diameter = float(size)
    except (TypeError, ValueError):
        raise InputError(f"the size of a cell must be a number (um), not {size!r}") from None
    if not (np.isfinite(diameter) and diameter > 0):
        raise InputError(f"the size of a cell must be positive (um), not {diameter:g}")
    return diameter


def _checked_size(size: float, shape: tuple[int, ...], voxel: FloatArray) -> float:
    diameter = positive_size(size)
    longest = float((np.array(shape) * voxel).max())
    if diameter > longest:
        raise InputError(
            f"a cell of {diameter:g} um is larger than the image, whose longest side is"
            f" {longest:g} um"
        )
    least = FINDING.least_voxels * _mean_side(voxel)
    if diameter < least:
        raise InputError(
            f"a cell of {diameter:g} um is too small for these voxels: at least {least:.3g} um"
        )
    return diameter
