"""The variance of a voxel, as far as the image tells it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..fitting.model.likelihood import voxel_noise
from .camera import Camera, camera_from_image

Variance = Callable[[np.ndarray], np.ndarray]


def voxel_variance(
    image: np.ndarray, pixels: np.ndarray, known: np.ndarray, camera: Camera | None = None
) -> Variance:
    """A function from expected values to variances of voxels.

    It is the camera's noise line if the image shows one, else the same variance for all voxels.

    Parameters
    ----------
    image
        (Z, Y, X) as the file holds it.
    pixels, known
        The same with missing voxels filled, and a mask of those not missing.
    camera
        What the image tells about its camera, if already known.
    """
    camera = camera or camera_from_image(image, known)
    if camera.line is not None:
        return camera.line.variance
    least = 1e-6 * float(np.ptp(pixels[known]))  # so that an image without noise has a variance
    level = max(voxel_noise(pixels, known), least)
    return lambda expected: np.full(expected.shape, level**2)
