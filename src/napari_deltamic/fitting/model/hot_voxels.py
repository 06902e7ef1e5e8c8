"""Hot voxels: single ones, and camera pixels that are hot in every slice."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter

from ...common.normal import SIGMA_PER_MEDIAN_DEVIATION
from ...common.words import counted as number_of
from .likelihood import voxel_noise

_FEWEST_SLICES = 8  # in which a camera pixel must be seen: chosen; chance may do it in fewer
# Share of its excess that the neighbours of a hot pixel may have. The image of a vertical fibre by
# a PSF of 0.6 voxel gives at least 0.19 to the three darker of the four neighbours of its brightest
# pixel, by the Gaussian, wherever in this pixel it stands; a wider PSF or a thicker fibre more.
_SHARED = 0.125
# Errors of the mean over the slices that are added to what neighbours have: three to five that a
# faint fibre stays above the share, since its own light then is at least 16 such errors.
_SURELY = 2.0
_OF_NOISE = 2.0  # least excess, over the noise of a voxel: less moves no surface. Chosen
# Least share of the slices in which a hot pixel has so much of its mean excess. Chosen: of a
# pixel twice as bright as the noise of a voxel, 88 % have, by the normal distribution.
_IN_SLICES = 0.8
_ALIKE = 1 / 3  # of the mean excess. Chosen, see above


def hot_voxels(pixels: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(Z, Y, X) bool: voxels so far above their neighbours that no PSF can have made them.

    A PSF of 0.8 voxel or wider gives the neighbours of its brightest voxel almost half of what it
    holds; a camera's hot pixel or a cosmic ray gives them nothing. One such voxel can pull a mesh.
    In images of few photons, where most have none beside them, one alone is a sign of neither.
    A camera pixel that is hot in every slice is as bright above and below: it is found by its
    neighbours in the slices.
    """
    if not known.any():
        return np.zeros(pixels.shape, bool)
    around = np.ones((3, 3, 3), bool)
    around[1, 1, 1] = False
    neighbours = maximum_filter(pixels, footprint=around, mode="mirror")
    dark = float(np.median(pixels[known]))
    noise = voxel_noise(pixels, known) or _faintest(pixels[known] - dark)
    single = known & (pixels - dark > 4 * np.maximum(neighbours - dark, 3 * noise))
    return single | (known & _hot_pixels(pixels, known & ~single, noise))


def without_hot(image: np.ndarray) -> tuple[np.ndarray, int]:
    """An image with NaN for its hot voxels, and how many they are; itself where there is none.

    image : (Z, Y, X); one that no fit could take is given back as it is.
    """
    if image.ndim != 3 or not image.size:
        return image, 0
    known = np.isfinite(image)
    hot = hot_voxels(np.where(known, image, 0).astype(np.float32), known)
    number = int(hot.sum())
    if not number:
        return image, 0
    kind = image.dtype if np.issubdtype(image.dtype, np.floating) else np.float32
    return np.where(hot, np.nan, image).astype(kind), number


def hot_told(number: int) -> str:
    """What users are told of hot voxels."""
    are = "is" if number == 1 else "are"
    return f"{number_of(number, 'hot voxel')}, brighter than any PSF can make one, {are} left out"


def _hot_pixels(pixels: np.ndarray, known: np.ndarray, noise: float) -> np.ndarray:
    """(Y, X) bool: pixels that are hot in nearly every slice."""
    seen = known.sum(0)
    hot = np.zeros(seen.shape, bool)
    if min(seen.shape) < 5 or seen.max() < _FEWEST_SLICES:  # 5 voxels hold all that are compared
        return hot
    mean = np.where(known, pixels, 0).sum(0, dtype=float) / np.maximum(seen, 1)
    mean[2 * seen < seen.max()] = np.nan  # others are the mean of other slices; half is enough
    while True:  # the fainter of two neighbours is seen without the brighter one
        found = _sharp(mean, noise)
        for y, x in np.argwhere(found):
            found[y, x] = _in_every_slice(pixels, known & ~hot, int(y), int(x))
        if not found.any():
            return hot
        hot |= found
        mean[found] = np.nan


def _sharp(mean: np.ndarray, noise: float) -> np.ndarray:
    """(Y, X) bool: where a mean over slices is so far above its neighbours that no PSF made it."""
    n, m = mean.shape
    wide = np.pad(mean, 2, mode="reflect")

    def moved(j: int, i: int) -> np.ndarray:
        return wide[2 + j : 2 + j + n, 2 + i : 2 + i + m]

    four = np.sort([moved(-1, 0), moved(1, 0), moved(0, -1), moved(0, 1)], 0)  # NaN comes last
    beside = four[:3].mean(0)  # one of them may be hot, too
    above = mean - beside
    sure = np.isfinite(above)
    if not sure.any():
        return sure
    error = SIGMA_PER_MEDIAN_DEVIATION * float(
        np.median(np.abs(above[sure] - np.median(above[sure])))
    )
    corners = [np.nan_to_num(moved(j, i), nan=-np.inf) for j in (-1, 1) for i in (-1, 1)]
    peak = (mean >= np.max(corners, 0)) & (mean >= np.nan_to_num(four, nan=-np.inf).max(0))
    found: np.ndarray = sure & peak & (above > (1 - _SHARED) * _OF_NOISE * noise)
    for y, x in np.argwhere(found):
        around = wide[y : y + 5, x : x + 5]
        ring = np.concatenate([around[0], around[-1], around[1:-1, 0], around[1:-1, -1]])
        ground = np.median(ring[np.isfinite(ring)]) if np.isfinite(ring).any() else np.inf
        excess = mean[y, x] - ground
        shared = excess - above[y, x] + _SURELY * error
        found[y, x] = excess > _OF_NOISE * noise and shared < _SHARED * excess
    return found


def _in_every_slice(pixels: np.ndarray, known: np.ndarray, y: int, x: int) -> bool:
    """Whether a pixel has a like excess over its neighbours in nearly all slices."""
    (_, n, m), here = pixels.shape, known[:, y, x]
    sides = [(y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)]
    inside = [(j, i) for j, i in sides if 0 <= j < n and 0 <= i < m]
    beside = np.median([pixels[here, j, i] for j, i in inside], 0)
    above = pixels[here, y, x] - beside
    return bool((above > _ALIKE * above.mean()).mean() >= _IN_SLICES)


def _faintest(light: np.ndarray) -> float:
    """The least light above the dark level, such as one photon; 0 where there is none."""
    above = light[light > 0]
    return float(above.min()) if above.size else 0.0
