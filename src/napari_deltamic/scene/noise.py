"""Noise: from the light that reaches a camera to the intensities that it records."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from ..common.choices import Bits
from ..errors import InputError
from .effects import DetectorEffect

_MOST = 1e18  # photons in a voxel: nearly as many as a whole number of 64 bits can count


def detected(
    light: NDArray[Any], camera: DetectorEffect | None, rng: np.random.Generator, bits: Bits = 16
) -> NDArray[Any]:
    """Make a noisy image: Poisson counts, then what the camera makes of them.

    ``min(gain * Poisson(light) + offset + read noise * Normal(0, 1), saturation)``, rounded and
    held within the range of the bits. Without a camera an intensity is a count, and no normal
    number is drawn.

    Parameters
    ----------
    light
        (Z, Y, X) photons expected in each voxel; negative values of a rendering count as 0.
    camera
        Gain, offset, read noise and saturation.
    rng
        Source of the noise; the same state gives the same bytes.
    bits
        8 (uint8), 12 or 16 (uint16), or 32 (float32).

    Raises
    ------
    InputError
        If the light is not finite or too much to be counted, or the brightest voxel is beyond the
        range of the bits and the camera does not say that it saturates.
    """
    if bits not in get_args(Bits):
        raise InputError(f"bits must be 8, 12, 16 or 32 (float32), not {bits}")
    expected = intensities(light, camera)
    if light.max() > _MOST:
        raise InputError(
            f"{light.max():.4g} photons in a voxel are too many to simulate: use fewer"
        )
    top = highest(bits)
    if expected.max() > top and (camera is None or camera.saturation is None):
        raise InputError(
            f"the brightest voxel would be {expected.max():.4g}, but {bits} bits hold {top:g}: "
            "take more bits, fewer photons, or a camera that saturates"
        )
    image = rng.poisson(np.maximum(light, 0)).astype(np.float64)
    if camera is not None:
        image *= camera.gain
        image += camera.offset
        if camera.read_noise > 0:
            image += camera.read_noise * rng.standard_normal(image.shape)
        if camera.saturation is not None:
            np.minimum(image, camera.saturation, out=image)
    if bits == 32:
        return image.astype(np.float32)
    return np.rint(image).clip(0, top).astype(np.uint8 if bits == 8 else np.uint16)


def intensities(light: NDArray[Any], camera: DetectorEffect | None) -> NDArray[np.float64]:
    """Return (Z, Y, X) mean intensities of a camera without saturation. InputError for NaN."""
    found = np.asarray(light, dtype=np.float64)
    if not np.isfinite(found).all():
        raise InputError("the expected light is not finite: check the numbers of the effects")
    return found if camera is None else camera.gain * found + camera.offset


def highest(bits: Bits) -> float:
    """Return the largest number that so many bits hold; infinity for float32."""
    return np.inf if bits == 32 else float(2**bits - 1)
