"""How blurred the noise of an image is: white in a camera's, as the image itself in a deconvolved.

Optics blur light before it is counted, so noise is sharper than any structure. Deconvolution ends
where both are alike; then edges overshoot, and a bright rim says nothing of a membrane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...geometry.mesh import FloatArray


@dataclass(frozen=True)
class NoiseBlurRules:
    """When noise is no longer that of a camera.

    Attributes
    ----------
    long_enough
        Voxels: in a shorter axis few have others three apart on both sides. Chosen, not measured.
    coloured
        Times what neighbours differ by, of what is left: voxels three apart may differ by so much.
        Chosen between white noise, which gives 1, and one smoothed by a Gaussian of half a voxel,
        which gives 1.4 (from the correlations that it leaves, exp(-n^2 / 4 s^2) over n voxels).
    sharpened
        Width of the noise over that of the PSF along each axis, from which an image was
        deconvolved. Measured (benchmarks.defaults): up to 0.35 in 48 fits of images as a camera
        takes them, 0.65 in four of images smoothed by a voxel, 0.82 to 1.7 in 20 after 5 to 100
        iterations of Richardson-Lucy or by Wiener's filter, 0.71 to 0.75 in five nuclei, each after
        20 iterations; 0.19 along Z and 0.9 across in a real stack of nuclei, one PSF to a voxel.
    most
        Voxels that are looked at along each axis, about; chosen: more would take longer than a
        tenth of a second.
    """

    long_enough: int = 12
    coloured: float = 1.25
    sharpened: float = 0.68
    most: int = 2_000_000


RULES = NoiseBlurRules()
_NEAR, _FAR = 1, 3  # voxels apart, by definition of the rules above
_WIDTHS = np.linspace(0.05, 3.0, 300)  # voxels; wider noise hardly differs over three of them


def is_white(left: FloatArray) -> bool:
    """Whether neighbours differ as much as voxels three apart, along each axis.

    left : (Z, Y, X) what a fit leaves; NaN where nothing is known.
    """
    return all(far <= RULES.coloured for far in _far_over_near(left).values())


def is_sharpened(left: FloatArray, sigma: Sequence[float], voxel_size: Sequence[float]) -> bool:
    """Whether noise is about as blurred as the image itself, as in one that was deconvolved.

    left : (Z, Y, X) what a fit leaves. sigma : um, of its PSF, Z Y X. voxel_size : um.
    """
    ratios = [
        float(np.interp(far, _FAR_OVER_NEAR, _WIDTHS)) * voxel_size[axis] / sigma[axis]
        for axis, far in _far_over_near(left).items()
    ]
    return min(ratios, default=0.0) > RULES.sharpened


def _far_over_near(left: FloatArray) -> dict[int, float]:
    """By axis: medians of second differences over three voxels, over those over one."""
    found = {}
    for axis in np.flatnonzero(np.array(left.shape) >= RULES.long_enough):
        rows = np.moveaxis(left, axis, -1)[:: max(1, -(-left.size // RULES.most))]
        near, far = (_second_differences(rows, n) for n in (_NEAR, _FAR))
        if near > 0 and np.isfinite(far):
            found[int(axis)] = far / near
    return found


def _second_differences(rows: FloatArray, n: int) -> float:
    """Their median size along the last axis, over n voxels; NaN if too few are known for any."""
    both = rows[..., : -2 * n] - 2 * rows[..., n:-n] + rows[..., 2 * n :]
    known = np.abs(both[np.isfinite(both)])
    return float(np.median(known)) if known.size else np.nan


def _expected(width: FloatArray, n: int) -> FloatArray:
    """Variance of second differences over n voxels of white noise that a Gaussian smoothed."""
    near, far = (np.exp(-((k * n) ** 2) / (4 * width**2)) for k in (1, 2))
    return np.asarray(6 - 8 * near + 2 * far)


_FAR_OVER_NEAR = np.sqrt(_expected(_WIDTHS, _FAR) / _expected(_WIDTHS, _NEAR))
