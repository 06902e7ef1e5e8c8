"""Effects of detection: the camera, and voxels that are missing. They act on the likelihood."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from .base import VoxelEffect


class Camera(VoxelEffect):
    """From photons to intensities: ``variance = gain (image - offset) + read noise^2``."""

    name: ClassVar[str] = "camera"
    help: ClassVar[str] = (
        "gain, offset and read noise weigh the voxels, saturated ones are left out; without it the "
        "histogram of the image tells the weights"
    )

    gain: Annotated[float, Field(gt=0)] = Field(default=1.0, description="intensity of a photon")
    offset: float = Field(default=0.0, description="intensity without light")
    read_noise: Annotated[float, Field(ge=0)] = Field(
        default=0.0, description="standard deviation of the intensity without light"
    )
    saturation: float | None = Field(
        default=None, description="intensity at which a voxel is full; None: none is"
    )

    def variance(self, image: np.ndarray) -> np.ndarray:
        """Of the intensities, where the image without noise is this one."""
        light: np.ndarray = np.maximum(image - self.offset, 0)
        return self.gain * light + self.read_noise**2

    def missing(self, image: np.ndarray) -> np.ndarray:
        """(Z, Y, X) bool: saturated voxels."""
        if self.saturation is None:
            return super().missing(image)
        full: np.ndarray = image >= self.saturation
        return full


class Missing(VoxelEffect):
    """Voxels that were not measured: a value that stands for nothing, or slices that failed."""

    name: ClassVar[str] = "missing"
    help: ClassVar[str] = (
        "voxels of one value (what a registration pads with) or whole slices tell nothing; left "
        "in, they pull the surface as dark ground does"
    )

    value: float | None = Field(default=None, description="intensity of missing voxels")
    slices: tuple[Annotated[int, Field(ge=0)], ...] = Field(
        default=(), description="slices along z that failed, from 0 on"
    )

    def missing(self, image: np.ndarray) -> np.ndarray:
        """(Z, Y, X) bool: voxels of that value, and those in these slices."""
        found = super().missing(image)
        if self.value is not None:
            found |= image == self.value
        found[[k for k in self.slices if k < len(found)]] = True
        return found
