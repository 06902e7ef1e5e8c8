"""How alike two images are: MSE, PSNR and SSIM, on one scale of brightness."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, log10

import numpy as np
from numpy.typing import ArrayLike, NDArray
from skimage.metrics import structural_similarity

from napari_deltamic.errors import InputError

SSIM_SIGMA = 1.5  # voxels: the Gaussian window of the paper that introduced SSIM
_RANGE = (0.1, 99.9)  # percentiles: single hot voxels would be the range otherwise


@dataclass(frozen=True)
class ImageSimilarity:
    """Of a rendered image to a measured one whose range is 1.

    mse : mean squared difference.
    psnr : peak signal-to-noise ratio, dB.
    ssim : structural similarity, 1 for equal images.
    amplitude, background : what brought the rendered image onto the scale of the measured one.
    """

    mse: float
    psnr: float
    ssim: float
    amplitude: float
    background: float


def image_similarity(
    measured: ArrayLike,
    rendered: ArrayLike,
    voxels: ArrayLike | None = None,
) -> ImageSimilarity:
    """Compare a rendered image with a measured one; amplitude and background are solved for.

    A rendered image has no scale of its own, so it is first brought onto that of the measured one
    by least squares. The range of the measured image is that from its 0.1 to its 99.9 percentile.
    SSIM is that of Z. Wang et al., "Image quality assessment: from error visibility to structural
    similarity", IEEE Trans. Image Process. 13, 2004, with Gaussian windows in 3D.

    Parameters
    ----------
    measured, rendered : (Z, Y, X)
    voxels : (Z, Y, X) bool, those that count; default all. Not finite ones never do.

    Raises
    ------
    InputError
        Shapes differ, nothing is left to count, or the measured image is flat.
    """
    image, model = np.asarray(measured, np.float64), np.asarray(rendered, np.float64)
    if image.shape != model.shape or image.ndim != 3:
        raise InputError(f"images of one 3D shape are needed, not {image.shape} and {model.shape}")
    counted = np.isfinite(image) & np.isfinite(model)
    if voxels is not None:
        counted &= np.asarray(voxels, bool)
    if not counted.any():
        raise InputError("no voxel is left to compare")
    low, high = np.percentile(image[counted], _RANGE)
    if not high > low:
        raise InputError("the measured image is flat")
    image = (np.where(counted, image, low) - low) / (high - low)
    amplitude, background = _scale(model[counted], image[counted])
    model = np.where(counted, amplitude * model + background, 0.0)
    mse = float(((image - model)[counted] ** 2).mean())
    ssim = float(_ssim(image, model)[counted].mean())
    psnr = -10 * log10(mse) if mse > 0 else inf
    span = float(high - low)
    return ImageSimilarity(mse, psnr, ssim, amplitude * span, background * span + float(low))


def _scale(model: NDArray[np.float64], image: NDArray[np.float64]) -> tuple[float, float]:
    away = model - model.mean()
    spread = float(away @ away)
    amplitude = float(away @ (image - image.mean())) / spread if spread > 0 else 0.0
    return amplitude, float(image.mean() - amplitude * model.mean())


def _ssim(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of each voxel. The window is the Gaussian: win_size would only refuse small images."""
    whole: NDArray[np.float64] = structural_similarity(
        a,
        b,
        data_range=1.0,
        gaussian_weights=True,
        sigma=SSIM_SIGMA,
        use_sample_covariance=False,
        win_size=1,
        full=True,
    )[1]
    return whole
