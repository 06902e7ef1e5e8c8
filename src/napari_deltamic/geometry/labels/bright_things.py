"""Things in an image that are brighter than what is around them, and where each of them ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.morphology import h_maxima
from skimage.segmentation import watershed

from ...common.ball import ball_radius
from ..distance_transform import distance_transform
from ..mesh import FloatArray
from .label_repair import label_boxes
from .region_merging import Image, Labels
from .voxels import largest_part, renumbered


@dataclass(frozen=True)
class ThingRules:
    """Thresholds that decide whether a bright thing is a cell, and where it ends.

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
    """

    smoothing: float = 1.0
    large: float = 0.99
    narrow: float = 0.12
    half: float = 0.5
    sizes: tuple[float, float] = (0.4, 2.5)
    core: float = 0.6
    rim: float = 0.3
    hollow: float = 0.5


THINGS = ThingRules()


@dataclass(frozen=True, eq=False)
class Smoothed:
    """An image without gaps, its smoothed copy, and where it is known: only that part counts."""

    data: Image
    smooth: Image
    known: NDArray[np.bool_]
    voxel: FloatArray

    def above(self, threshold: Callable[[Image], float]) -> NDArray[np.bool_]:
        """Return the mask of what is brighter than a threshold chosen on the known part."""
        found: NDArray[np.bool_] = (self.smooth > threshold(self.smooth[self.known])) & self.known
        return found


def smoothed(data: Image, known: NDArray[np.bool_], voxel: FloatArray) -> Smoothed:
    """Smooth an image without gaps by a Gaussian of ``THINGS.smoothing`` smallest voxel sides."""
    smooth = ndimage.gaussian_filter(data, THINGS.smoothing * voxel.min() / voxel, mode="nearest")
    return Smoothed(data, smooth, known, voxel)


def bright_things(
    seen: Smoothed, size: float | None, threshold: Callable[[Image], float]
) -> tuple[NDArray[np.int32] | None, bool]:
    """Label (Z, Y, X) what is brighter than a threshold; also return whether most of it is hollow.

    size : um; the diameter of a typical cell. None: that of the things. None if no label is left.
    """
    voxel = seen.voxel
    things = ndimage.binary_fill_holes(ndimage.binary_opening(seen.above(threshold)))
    if not things.any():
        return None, False
    depth = distance_transform(things, voxel)  # a cell may go on beyond the border
    depth = ndimage.gaussian_filter(depth, THINGS.smoothing * voxel.min() / voxel)
    large = float(np.quantile(depth[things], THINGS.large)) if size is None else size / 2
    peaks, _ = ndimage.label(h_maxima(depth, THINGS.narrow * large))
    parts = watershed(-depth, peaks, mask=things)
    hollow = _hollow(seen.smooth, parts, depth) > THINGS.hollow
    return of_a_size(ended(seen, parts, depth), voxel, size), hollow


def of_a_size(parts: Labels, voxel: FloatArray, size: float | None) -> NDArray[np.int32] | None:
    """Keep labels (Z, Y, X) about as large as the typical one, from 1; None if none is left.

    size : um; the typical diameter. None: measured on the labels.
    """
    diameters = _diameters(parts, voxel)
    typical = size or typical_diameter(parts, voxel)
    low, high = (times * typical for times in THINGS.sizes)
    kept = (diameters[1:] > low) & (diameters[1:] < high)
    return renumbered(parts, kept) if kept.any() else None


def unexplained(seen: Smoothed, labels: Labels) -> float:
    """Variance of an image that cells leave, if each is evenly bright, with its own brightness."""
    smooth, names = seen.smooth[seen.known], labels[seen.known]
    count = int(labels.max()) + 1
    means = np.bincount(names, smooth, count) / np.maximum(np.bincount(names, None, count), 1)
    light = np.append(0.0, means[1:] - means[0]).astype(np.float32)[labels]
    sigma = THINGS.smoothing * seen.voxel.min() / seen.voxel
    light = ndimage.gaussian_filter(light, sigma, mode="nearest")
    rise = np.cov(light[seen.known], smooth)
    return float(rise[1, 1] - rise[0, 1] ** 2 / max(float(rise[0, 0]), 1e-30))


def ended(seen: Smoothed, parts: Labels, depth: FloatArray) -> Labels:
    """Cut each part off at half of its own brightness, and remove the crumbs that this leaves.

    parts : (Z, Y, X) labels. depth : (Z, Y, X) um, below the surface of what they are parts of.
    """
    smooth, dark = seen.smooth, ground_beside(seen, parts)
    ends = np.full(int(parts.max()) + 1, np.inf)
    for k, box in label_boxes(parts):
        own = parts[box] == k
        core = own & (depth[box] >= THINGS.core * depth[box][own].max())
        ends[k] = dark + THINGS.half * (float(np.median(smooth[box][core])) - dark)
    kept = np.where((parts > 0) & (smooth > ends[parts]), parts, 0)
    for k, box in label_boxes(kept):
        own = kept[box] == k
        kept[box][own & ~largest_part(own)] = 0
    return kept


def ground_beside(seen: Smoothed, parts: Labels) -> float:
    """Return how bright it is beside the parts; the darkest voxel if nothing is beside them."""
    around = seen.known & (parts == 0)
    return float(np.median(seen.smooth[around])) if around.any() else float(seen.smooth.min())


def _hollow(smooth: Image, parts: Labels, depth: FloatArray) -> float:
    """Share of the parts' volume in parts whose rim is brighter than their core."""
    told = hollow = 0
    for k, box in label_boxes(parts):
        own = parts[box] == k
        deepest = depth[box][own].max()
        core = own & (depth[box] > THINGS.core * deepest)
        rim = own & (depth[box] < THINGS.rim * deepest)
        if core.any() and rim.any():
            volume = int(own.sum())
            told += volume
            hollow += volume * bool(smooth[box][rim].mean() > smooth[box][core].mean())
    return hollow / max(told, 1)


def _diameters(labels: Labels, voxel: FloatArray) -> FloatArray:
    """Diameters (um) of the balls as large as each label; 0 for the background."""
    volumes = np.bincount(labels.ravel()) * float(np.prod(voxel))
    volumes[0] = 0
    found: FloatArray = 2 * ball_radius(volumes)
    return found


def typical_diameter(labels: Labels, voxel: FloatArray) -> float:
    """Mean diameter (um) over voxels rather than over labels, so that crumbs hardly count."""
    each = _diameters(labels, voxel)
    return float((each**4).sum() / max((each**3).sum(), 1e-30))
