"""The variance of a voxel, as well as the image tells it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..fitting.model.likelihood import voxel_noise
from .camera import Camera, camera_from_image

Variance = Callable[[np.ndarray], np.ndarray]


def voxel_variance(
    image: np.ndarray, pixels: np.ndarray, known: np.ndarray, camera: Camera | None = None
) -> Variance:
    """Function from expected values to variances.

    The line of the camera where the image shows one, else the same for all voxels.

    Parameters
    ----------
    image
        (Z, Y, X) as the file holds it.
    pixels, known
        The same without missing voxels, and where they are not missing.
    camera
        Of the image, where it is known already.
    """
    camera = camera or camera_from_image(image, known)
    if camera.line is not None:
        return camera.line.variance
    least = 1e-6 * float(np.ptp(pixels[known]))  # so that an image without noise has a variance
    level = max(voxel_noise(pixels, known), least)
    return lambda expected: np.full(expected.shape, level**2)
