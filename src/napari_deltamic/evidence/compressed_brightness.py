"""Whether the intensities of an image are logarithms of camera counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d, gaussian_filter

from ..images.missing import filled


@dataclass(frozen=True)
class CompressedRules:
    """When noise decreases with brightness, which no camera's does.

    Attributes
    ----------
    smoothed
        Width of the blur in the plane, voxels; chosen: about a PSF, so that brightness is told
        without the noise that is compared with it.
    dark, bright
        Percentiles of brightness; chosen: in most stacks more voxels than the first are dark.
    least
        Least ratio of noise in bright parts to that in dark parts. Measured: 1.2 and more in real
        stacks and in all kinds of ``benchmarks.defaults``, 0.99 to 1.17 after a square root, which
        a camera's own noise may look like, and 0.31 to 0.46 after a logarithm.
    white
        Least ratio of fourth to second differences in the dark; chosen: white noise gives
        (70 / 6)^(1/2), that of an image smoothed by a Gaussian of 0.8 voxels 2.3; without noise,
        differences are those of structures, which tell nothing.
    fewest
        Voxels needed of either; chosen, so that their mean noise is known to a tenth.
    most
        Approximate number of voxels to look at, in whole slices; chosen: more would take longer
        than a second.
    """

    smoothed: float = 1.5
    dark: float = 40.0
    bright: float = 95.0
    least: float = 0.7
    white: float = 2.5
    fewest: int = 100
    most: int = 4_000_000


RULES = CompressedRules()
# By definition: second and fourth differences.
_SECOND, _FOURTH = (1.0, -2.0, 1.0), (1.0, -4.0, 6.0, -4.0, 1.0)


def compressed(image: NDArray[np.floating]) -> bool:
    """Whether the noise of an image (Z, Y, X; NaN where missing) is smaller where it is bright.

    The variance of photons and of a camera grows with brightness, or stays the same; a logarithm
    reverses that. Noise is measured by second differences along X; structures make them larger
    where the image is bright. Voxels at the largest value, which may be cut off, do not count.
    """
    return (ratio := bright_over_dark(image)) is not None and ratio < RULES.least


def bright_over_dark(image: NDArray[np.floating]) -> float | None:
    """Mean noise where an image is bright, over that where it is dark; None if unknown."""
    some = image[:: max(1, -(-image.size // RULES.most))]
    if some.shape[2] < len(_FOURTH) or not np.isfinite(some).any():
        return None
    pixels = filled(np.asarray(some, np.float32))
    brightness = gaussian_filter(pixels, (0, RULES.smoothed, RULES.smoothed))
    second, fourth = (np.abs(convolve1d(pixels, d, axis=2)) for d in (_SECOND, _FOURTH))
    low, high = np.percentile(brightness, (RULES.dark, RULES.bright))
    below = pixels < pixels.max()
    bright, dark = below & (brightness >= high), below & (brightness <= low)
    if min(bright.sum(), dark.sum()) < RULES.fewest or not second[dark].any():
        return None
    if fourth[dark].mean() < RULES.white * second[dark].mean():
        return None
    return float(second[bright].mean() / second[dark].mean())
