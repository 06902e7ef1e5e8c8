"""Cells that are brighter than what is around them, such as nuclei; and which kind an image shows.

What is brighter than a threshold is cut where it is narrow, and each part ends at half of its own
brightness. Where that leaves clumps, as among crowded cells with hardly a gap, each blob is a cell
(`crowded_cells`): so it is where evenly bright blobs explain the image better. In an image of
membranes the same finds whole cells, too, or pieces of walls: so what walls enclose comes first
where most of the light lies there, and a net of walls around dark places holds no bright cells.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from skimage.filters import threshold_li, threshold_otsu
from skimage.morphology import h_maxima
from skimage.segmentation import watershed

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.labels.crowded_cells import crowded_cells, without_halves
from napari_deltamic.geometry.labels.find_cells import (
    SizeFound,
    checked_image,
    find_cells,
    likeliest,
    solidity,
    suggest_sizes,
)
from napari_deltamic.geometry.labels.region_merging import Image, Labels
from napari_deltamic.geometry.mesh import FloatArray


@dataclass(frozen=True)
class BrightRules:
    """When a bright thing is a cell, and when cells are bright.

    Attributes
    ----------
    smoothing
        Smallest sides of a voxel: of the image, and of distances to the border.
    large
        Quantile of the depths of voxels that counts as the radius of large cells. Chosen.
    narrow
        Two cells meet where both are this much of the radius of large ones deeper. Chosen, not
        measured.
    half
        Of its own brightness: where a cell ends, by definition of a blurred edge.
    sizes
        Diameters of the typical cell between which others lie: those of *Find cells*, and more.
        Chosen, not measured.
    core, rim
        Of the greatest depth: deeper is the core of a cell, less deep its rim. Chosen.
    hollow
        Share of the volume that is in things whose rim is brighter than their core from which
        bright things are cells with walls. Chosen; one of 27 nuclei in a well-known sample is
        hollow, with 0.06 of the volume. Measured: 0.82 to 1 in images of single membranes.
    enclosed, surely
        Shares of the light at and in cells with walls: up to the first, bright ones come first if
        they are whole; above the second, if those with walls are whole, there are none. Else the
        more solid are the cells: crowded bright cells have walls of darkness, and the light of a
        haze is not at walls. Chosen. Measured: 0.04 to 0.59 in images of nuclei, 0.82 once, where
        what walls of darkness enclosed had a solidity of 0.63; 0.29 to 0.86 with membranes in a
        haze, 0.86 and more in 14 tissues without.
    whole
        Mean solidity from which things count as cells. Measured: 0.33 to 0.58 for pieces of walls
        in real images, 0.44 to 0.55 for noise, 0.72 for red blood cells.
    reach
        Sides of a voxel around them that count.
    holes
        What is bright holds cells up to so much of it in dark places that it surrounds within a
        slice, as walls do. Measured: 0 to 0.06 in 19 images of cells that shine from inside,
        seven of them real, and 0.105 on a lattice of balls that touch; 0.14 and more in six real
        ones of membranes, mitochondria and pollen.
    explained
        Of the variance of the image that large things leave: smaller ones that leave less are
        better; between that and all of it, the more solid (volume over that of the convex hull).
        Measured: 0.58 to 0.91 in crowds of nuclei, one real and nine simulated, and in a real
        biofilm; 0.92 to 1.04 in three real and twelve simulated images where large ones are right
        as well, 0.99 where cells with hardly a gap had been one, and 2 for pieces.
    """

    smoothing: float = 1.0
    large: float = 0.99
    narrow: float = 0.12
    half: float = 0.5
    sizes: tuple[float, float] = (0.4, 2.5)
    core: float = 0.6
    rim: float = 0.3
    hollow: float = 0.5
    enclosed: float = 0.4
    surely: float = 0.75
    whole: float = 0.65
    reach: float = 2.0
    holes: float = 0.12
    explained: float = 0.95


RULES = BrightRules()


@dataclass(frozen=True, eq=False)
class CellsFound:
    """The cells of an image.

    Attributes
    ----------
    labels
        (Z, Y, X) int32: 1 to n; 0 is background.
    size
        um: diameter of the typical cell.
    bright
        Whether they were found as bright things, not by their walls.
    others
        Of those with walls: other sizes that they may have, the likeliest first.
    """

    labels: NDArray[np.int32]
    size: float
    bright: bool
    others: tuple[SizeFound, ...] = ()


def cells_of(
    image: ArrayLike, voxel_size: Sequence[float], size: float | None = None
) -> CellsFound:
    """The cells of an image, whether their membranes shine or their insides.

    Parameters
    ----------
    image : (Z, Y, X) array; NaN where missing.
    voxel_size : um, Z, Y, X.
    size : um; the diameter of a usual cell. None: estimated.

    Raises
    ------
    InputError
        As :func:`~.find_cells.find_cells`.
    """
    data, known, voxel = checked_image(image, voxel_size)
    tried = suggest_sizes(image, voxel_size) if size is None else []
    asked = size or likeliest(tried, data.shape, voxel)
    walled: NDArray[np.int32] | None
    try:
        walled, refused = find_cells(image, voxel_size, asked), None
    except InputError as error:
        walled, refused = None, error
    bright = _instead(walled, _smoothed(data, known, voxel), size)
    if bright is not None:
        whole = _without_holes(bright)
        return CellsFound(whole, _typical(whole, voxel), True)
    if walled is None:
        assert refused is not None, "what was not found was refused"
        raise refused
    return CellsFound(walled, asked, False, tuple(tried[1:]))


@dataclass(frozen=True, eq=False)
class _Smoothed:
    """An image, its gaps filled; smoothed; and where it is known: the rest counts for nothing."""

    data: Image
    smooth: Image
    known: NDArray[np.bool_]
    voxel: FloatArray

    def above(self, threshold: Callable[[Image], float]) -> NDArray[np.bool_]:
        """What is brighter than a threshold of what is known."""
        found: NDArray[np.bool_] = (self.smooth > threshold(self.smooth[self.known])) & self.known
        return found


def _smoothed(data: Image, known: NDArray[np.bool_], voxel: FloatArray) -> _Smoothed:
    smooth = ndimage.gaussian_filter(data, RULES.smoothing * voxel.min() / voxel, mode="nearest")
    return _Smoothed(data, smooth, known, voxel)


def _instead(
    walled: NDArray[np.int32] | None, seen: _Smoothed, size: float | None
) -> NDArray[np.int32] | None:
    """Bright cells where they are likelier than those that walls enclose, if any do; else None."""
    share = 0.0 if walled is None else _light_at(seen, walled)
    solid = 0.0 if walled is None else _mean_solidity(walled)
    surely = share >= RULES.surely and solid > RULES.whole
    if surely or _holes(seen.above(threshold_li)) > RULES.holes:
        return None
    bright, hollow = _bright_things(seen, size, threshold_li)
    if walled is None and (bright is None or hollow):
        # In the halo of a bead, or of a few bright nuclei, that threshold holds the halo.
        brighter, ring = _bright_things(seen, size, threshold_otsu)
        if brighter is not None and not ring:
            bright, hollow = brighter, False
    if bright is None:
        return None
    first = share < RULES.enclosed and _mean_solidity(bright) > RULES.whole
    if not first and (hollow or walled is None):
        return None  # pieces of walls, or of noise
    if not hollow:
        bright = _without_clumps(bright, seen, size)
    return bright if first or _mean_solidity(bright) > solid else None


def _bright_things(
    seen: _Smoothed, size: float | None, threshold: Callable[[Image], float]
) -> tuple[NDArray[np.int32] | None, bool]:
    """Labels of what is brighter than a threshold, if anything is; and whether any is hollow."""
    voxel = seen.voxel
    things = ndimage.binary_fill_holes(ndimage.binary_opening(seen.above(threshold)))
    if not things.any():
        return None, False
    depth = ndimage.distance_transform_edt(things, voxel)  # a cell may go on beyond the border
    depth = ndimage.gaussian_filter(depth, RULES.smoothing * voxel.min() / voxel)
    large = float(np.quantile(depth[things], RULES.large)) if size is None else size / 2
    peaks, _ = ndimage.label(h_maxima(depth, RULES.narrow * large))
    parts = watershed(-depth, peaks, mask=things)
    hollow = _hollow(seen.smooth, parts, depth) > RULES.hollow
    return _of_a_size(_ended(seen, parts, depth), voxel, size), hollow


def _of_a_size(parts: Labels, voxel: FloatArray, size: float | None) -> NDArray[np.int32] | None:
    """Those about as large as the typical one, from 1; None where there are none."""
    diameters = _diameters(parts, voxel)
    typical = size or _typical(parts, voxel)
    low, high = (times * typical for times in RULES.sizes)
    kept = np.flatnonzero((diameters > low) & (diameters < high))
    if not len(kept):
        return None
    numbers = np.zeros(len(diameters), np.int32)
    numbers[kept] = np.arange(1, len(kept) + 1)
    return numbers[parts]


def _without_clumps(
    found: NDArray[np.int32], seen: _Smoothed, size: float | None
) -> NDArray[np.int32]:
    """Those found, or, if they are clumps, the smaller ones that explain the image better."""
    smaller = _smaller_cells(seen, size)
    if smaller is None:
        return found
    left = _unexplained(seen, smaller) / max(_unexplained(seen, found), 1e-30)
    if left < 1 and _mean_solidity(smaller) > _mean_solidity(found):
        return smaller
    return smaller if left < RULES.explained else found


def _smaller_cells(seen: _Smoothed, size: float | None) -> NDArray[np.int32] | None:
    """Each blob, up to half of its own brightness; None where there are none."""
    blobs = np.where(seen.known, crowded_cells(seen.data, seen.voxel, size), 0)
    if not blobs.any():
        return None
    depth = ndimage.distance_transform_edt(blobs > 0, seen.voxel)
    return _of_a_size(without_halves(_ended(seen, blobs, depth)), seen.voxel, size)


def _unexplained(seen: _Smoothed, labels: Labels) -> float:
    """Variance that is left of an image by cells that are evenly bright, each in its own way."""
    smooth, names = seen.smooth[seen.known], labels[seen.known]
    count = int(labels.max()) + 1
    means = np.bincount(names, smooth, count) / np.maximum(np.bincount(names, None, count), 1)
    light = np.append(0.0, means[1:] - means[0]).astype(np.float32)[labels]
    sigma = RULES.smoothing * seen.voxel.min() / seen.voxel
    light = ndimage.gaussian_filter(light, sigma, mode="nearest")
    rise = np.cov(light[seen.known], smooth)
    return float(rise[1, 1] - rise[0, 1] ** 2 / max(float(rise[0, 0]), 1e-30))


def _mean_solidity(labels: Labels) -> float:
    """By volume."""
    boxes = enumerate(ndimage.find_objects(labels), 1)
    each = [0.0 if box is None else solidity(labels[box] == k) for k, box in boxes]
    return float(np.average(each, weights=np.bincount(labels.ravel())[1:]))


def _holes(things: NDArray[np.bool_]) -> float:
    """Volume of what it surrounds within a slice, over its own."""
    things = ndimage.binary_opening(things)
    inside = sum(int((ndimage.binary_fill_holes(plane) & ~plane).sum()) for plane in things)
    return inside / max(int(things.sum()), 1)


def _ended(seen: _Smoothed, parts: Labels, depth: FloatArray) -> Labels:
    """Each part up to half of its own brightness, without crumbs of that beside it."""
    smooth, around = seen.smooth, seen.known & (parts == 0)
    dark = float(np.median(smooth[around])) if around.any() else float(smooth.min())
    ends = np.full(int(parts.max()) + 1, np.inf)
    for k, box in enumerate(ndimage.find_objects(parts), 1):
        if box is not None:
            own = parts[box] == k
            core = own & (depth[box] >= RULES.core * depth[box][own].max())
            ends[k] = dark + RULES.half * (float(np.median(smooth[box][core])) - dark)
    ended = np.where((parts > 0) & (smooth > ends[parts]), parts, 0)
    for k, box in enumerate(ndimage.find_objects(ended), 1):
        if box is not None:
            pieces, _ = ndimage.label(ended[box] == k)
            largest = int(np.bincount(pieces[pieces > 0]).argmax())
            ended[box][(pieces > 0) & (pieces != largest)] = 0
    return ended


def _without_holes(labels: NDArray[np.int32]) -> NDArray[np.int32]:
    """Dark places that a cell encloses are its own."""
    whole = labels.copy()
    for k, box in enumerate(ndimage.find_objects(labels), 1):
        if box is not None:
            own = ndimage.binary_fill_holes(labels[box] == k)
            whole[box][own & (labels[box] == 0)] = k
    return whole


def _hollow(smooth: Image, parts: Labels, depth: FloatArray) -> float:
    """Of the volume of the parts: how much is in those whose rim is brighter than their core."""
    told = hollow = 0
    for k, box in enumerate(ndimage.find_objects(parts), 1):
        own = parts[box] == k
        deepest = depth[box][own].max()
        core = own & (depth[box] > RULES.core * deepest)
        rim = own & (depth[box] < RULES.rim * deepest)
        if core.any() and rim.any():
            volume = int(own.sum())
            told += volume
            hollow += volume * bool(smooth[box][rim].mean() > smooth[box][core].mean())
    return hollow / max(told, 1)


def _light_at(seen: _Smoothed, labels: Labels) -> float:
    """Share of the light that lies in cells or near them."""
    light = np.maximum(seen.smooth - threshold_li(seen.smooth[seen.known]), 0) * seen.known
    reach = RULES.reach * seen.voxel.min()
    near = ndimage.distance_transform_edt(labels == 0, seen.voxel) <= reach
    return float((light * near).sum()) / max(float(light.sum()), 1e-30)


def _diameters(labels: Labels, voxel: FloatArray) -> FloatArray:
    """um, of the balls as large as each label; 0 of the background."""
    volumes = np.bincount(labels.ravel()) * float(np.prod(voxel))
    volumes[0] = 0
    found: FloatArray = np.cbrt(6 / np.pi * volumes)
    return found


def _typical(labels: Labels, voxel: FloatArray) -> float:
    """um: mean diameter, of voxels rather than of labels, so that crumbs do not count."""
    each = _diameters(labels, voxel)
    return float((each**4).sum() / max((each**3).sum(), 1e-30))
