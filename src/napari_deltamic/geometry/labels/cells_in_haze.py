"""Bright cells in the light of what holds them: the nuclei of an embryo that shines all over.

A threshold finds the whole embryo, or nothing. So light that is wider than a cell is subtracted
first: the morphological opening of the image (S. R. Sternberg, Computer 16, 1983). The bright
things that are left are cells only if they are round, many, and explain most of the differences in
brightness within the embryo: chromatin in a nucleus is not round, and grains are few or small.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.filters import threshold_otsu

from ..distance_transform import distance_transform
from .bright_things import Smoothed, bright_things, smoothed, typical_diameter, unexplained
from .crowded_cells import blob_answers
from .solidity import solidities
from .voxels import renumbered


@dataclass(frozen=True)
class HazeRules:
    """Thresholds that decide whether bright things are cells in a haze.

    Attributes
    ----------
    wider
        Than a cell: what counts as haze, in diameters. Chosen.
    smaller
        Of what holds them, or of the longest side of the image: up to this, cells are. Chosen.
    few
        Things that may hold cells: of more, each is a cell, and what is in it are its grains.
        Chosen.
    many
        Cells that each such thing must hold. Chosen: large nucleoli are fewer.
    whole
        Least solidity. Measured, on average: 0.93 to 0.97 in seven simulated embryos and a real
        one, 0.69 in one whose cells are missed, 0.49 to 0.66 for noise and texture in five without.
    clear
        Least height over the haze, in parts of that of the others. Chosen; noise had 0.4, once.
    left
        Of the differences in brightness, what evenly bright cells may leave unexplained. Measured
        there: 0.06 to 0.24, 0.39, and 0.23 to 0.87.
    """

    wider: float = 1.5
    smaller: float = 1 / 3
    few: int = 3
    many: int = 8
    whole: float = 0.8
    clear: float = 0.5
    left: float = 0.5


HAZE = HazeRules()


def cells_in_haze(
    seen: Smoothed, large: NDArray[np.int32] | None, size: float | None
) -> NDArray[np.int32] | None:
    """Label, from 1, cells in the light of what holds them; None if there are none.

    Parameters
    ----------
    large : (Z, Y, X) labels of bright things that may hold them; None: the whole image may.
    size : um; the diameter of a typical cell. None: that at which blobs respond most.
    """
    count = 1 if large is None else int(large.max())
    if count > HAZE.few:
        return None
    inside = seen.known if large is None else seen.known & (large > 0)
    depth = _depth(inside, seen) if large is not None else None
    for diameter in _diameters(seen, large, depth, size):
        clear = _without_haze(seen, inside, diameter)
        cells, hollow = bright_things(clear, diameter, threshold_otsu)
        if cells is None or hollow:
            continue
        cells = _round_and_clear(cells, clear)
        deep = inside if depth is None else inside & (depth > diameter)
        if not deep.any() or int(cells.max()) < HAZE.many * count:
            continue
        within = Smoothed(clear.data, clear.smooth, deep, clear.voxel)
        if unexplained(within, cells) < HAZE.left * float(clear.smooth[deep].var()):
            return cells
    return None


def _round_and_clear(things: NDArray[np.int32], clear: Smoothed) -> NDArray[np.int32]:
    """Remove things that are dim beside the others (noise) or not solid (the rim of a body)."""
    names = np.arange(1, int(things.max()) + 1)
    solid = solidities(things)
    height = np.asarray(ndimage.median(clear.smooth, things, names))
    of_voxels = float(np.median(height[things[things > 0] - 1]))
    kept = (solid >= HAZE.whole) & (height >= HAZE.clear * of_voxels)
    return renumbered(things, kept)


def _diameters(
    seen: Smoothed,
    large: NDArray[np.int32] | None,
    depth: NDArray[np.float32] | None,
    size: float | None,
) -> list[float]:
    """Return diameters (um) at which blobs away from borders respond more than at the next ones."""
    whole = float((np.array(seen.data.shape) * seen.voxel).max())
    most = HAZE.smaller * (whole if large is None else typical_diameter(large, seen.voxel))
    if size is not None:
        return [size] if size < most else []
    answers = blob_answers(seen.data, seen.voxel, most, depth)
    three = zip(answers, answers[1:], answers[2:], strict=False)
    return [size for (_, below), (size, here), (_, above) in three if below < here > above]


def _depth(inside: NDArray[np.bool_], seen: Smoothed) -> NDArray[np.float32]:
    """Return depths (um) below the surface; things cut by the image's border go on beyond it."""
    padded = np.pad(inside, 1, mode="edge")
    deep = distance_transform(padded, seen.voxel)[1:-1, 1:-1, 1:-1]
    depth: NDArray[np.float32] = deep.astype(np.float32)
    return depth


def _without_haze(seen: Smoothed, inside: NDArray[np.bool_], size: float) -> Smoothed:
    """Subtract the haze where cells may be."""
    box = np.maximum(2 * np.round(HAZE.wider * size / seen.voxel / 2) + 1, 3).astype(int)
    haze = ndimage.grey_opening(seen.smooth, size=tuple(box), mode="nearest")
    haze = ndimage.gaussian_filter(haze, size / 2 / seen.voxel, mode="nearest")
    return smoothed(np.maximum(seen.data - haze, 0), inside, seen.voxel)
