"""What images may have gone through before they are fitted: one function each.

``python -m benchmarks.defaults --processed`` fits a membrane, a nucleus and two groups of cells
after each of them. Cut images are what the fit should take as they are; the others show what an
image loses that is no longer what the camera counted.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass

import imageio.v3 as iio
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, median_filter, shift
from skimage.restoration import richardson_lucy

BASES = ("plain", "nucleus", "tissue", "crowd-nuclei", "crowd-both")
_JPEG = 75  # quality; what most programs write
_ITERATIONS = 20  # of Richardson and Lucy's deconvolution; the default of many programs


@dataclass(frozen=True)
class Stack:
    """The image, and what a processing may need besides: the blur (voxels), a generator."""

    image: NDArray[np.float32]
    sigma: NDArray[np.float64]
    rng: np.random.Generator


def _cut(percent: float) -> Callable[[Stack], NDArray[np.floating]]:
    """Saturated: so many percent of all voxels lie beyond the camera's range."""
    return lambda s: np.minimum(s.image, np.percentile(s.image, 100 - percent))


def _stretched(s: Stack) -> NDArray[np.floating]:
    """To 8 bits, with 0.35 % of the voxels saturated, as Fiji's *Enhance Contrast* does."""
    low, high = np.percentile(s.image, (0.175, 99.825))
    return np.asarray(np.rint(np.clip((s.image - low) / (high - low), 0, 1) * 255))


def _jpeg(s: Stack) -> NDArray[np.floating]:
    """Slice by slice, in 8 bits."""
    slices = []
    for plane in (s.image / s.image.max() * 255).astype(np.uint8):
        file = io.BytesIO()
        iio.imwrite(file, plane, extension=".jpg", quality=_JPEG)
        slices.append(iio.imread(file.getvalue(), extension=".jpg").astype(np.float32))
    return np.stack(slices)


def _deconvolved(s: Stack) -> NDArray[np.floating]:
    """By the true PSF."""
    reach = [int(np.ceil(4 * w)) for w in s.sigma]
    axes = np.meshgrid(*(np.arange(-r, r + 1) for r in reach), indexing="ij")
    psf = np.exp(-sum((x / w) ** 2 for x, w in zip(axes, s.sigma, strict=True)) / 2)
    scale = float(s.image.max())
    sharp = richardson_lucy(s.image / scale, psf / psf.sum(), num_iter=_ITERATIONS, clip=False)
    return np.asarray(sharp * scale)


def _jittered(s: Stack) -> NDArray[np.floating]:
    """Slices that wobble by 0.7 voxels in plane."""
    moves = s.rng.normal(0, 0.7, (len(s.image), 2))
    pairs = zip(s.image, moves, strict=True)
    return np.stack([shift(plane, move, order=1, mode="nearest") for plane, move in pairs])


def _flickering(s: Stack) -> NDArray[np.floating]:
    """Slices whose brightness varies by a fifth."""
    return s.image * np.exp(0.2 * s.rng.normal(size=(len(s.image), 1, 1)))


def _striped(s: Stack) -> NDArray[np.floating]:
    """Lines along X whose brightness varies by a tenth, alike in all slices."""
    return s.image * np.exp(0.1 * s.rng.normal(size=(1, s.image.shape[1], 1)))


def _vignetted(s: Stack) -> NDArray[np.floating]:
    """Half as bright in the corners as in the middle of a slice."""
    y, x = (np.linspace(-1, 1, n) for n in s.image.shape[1:])
    return s.image * (1 - 0.25 * (y[:, None] ** 2 + x**2))


PROCESSINGS: dict[str, Callable[[Stack], NDArray[np.floating]]] = {
    "cut-3": _cut(3),
    "cut-5": _cut(5),
    "cut-10": _cut(10),
    "stretched": _stretched,
    "jpeg": _jpeg,
    "smoothed": lambda s: gaussian_filter(s.image, 1.0),
    "median": lambda s: median_filter(s.image, 3),
    "deconvolved": _deconvolved,
    "offset-off": lambda s: np.maximum(s.image - np.percentile(s.image, 60), 0),
    "square-root": lambda s: 10 * np.sqrt(s.image),
    "logarithm": lambda s: 20 * np.log1p(s.image),
    "squared": lambda s: s.image**2 / s.image.max(),
    "vignetted": _vignetted,
    "striped": _striped,
    "flickering": _flickering,
    "jittered": _jittered,
}


def processed(stack: Stack, name: str) -> NDArray[np.float32]:
    """The image after one of `PROCESSINGS`."""
    return np.asarray(PROCESSINGS[name](stack), np.float32)
