"""Effects of detection: the camera, and voxels that are missing. They act on the likelihood."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from .base import Detection, DetectorEffect, VoxelEffect


class Camera(DetectorEffect):
    """A camera, with noise of ``variance = gain (image - offset) + read noise^2``."""

    name: ClassVar[str] = "camera"
    title: ClassVar[str] = "camera"
    help: ClassVar[str] = (
        "gain, offset and read noise weigh the voxels; without it the histogram of the image tells "
        "the weights"
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
        """Return the variance of intensities whose means are this image."""
        light: np.ndarray = np.maximum(image - self.offset, 0)
        return self.gain * light + self.read_noise**2

    @classmethod
    def seen(cls, detection: Detection) -> Camera | None:
        """Return a camera if the image shows saturated voxels; else None."""
        if detection.saturation is None:
            return None
        return cls(
            gain=detection.gain,
            offset=detection.offset,
            read_noise=detection.read_noise,
            saturation=detection.saturation,
        )


class Missing(VoxelEffect):
    """Voxels that were not measured: a value that stands for nothing, or slices that failed."""

    name: ClassVar[str] = "missing"
    title: ClassVar[str] = "missing voxels"
    help: ClassVar[str] = (
        "voxels of one value (what a registration pads with) or whole slices tell nothing; left "
        "in, they pull the surface as dark ground does"
    )

    value: float | None = Field(default=None, description="intensity of missing voxels")
    slices: tuple[Annotated[int, Field(ge=0)], ...] = Field(
        default=(), description="slices along z that failed, from 0 on"
    )

    def missing(self, image: np.ndarray) -> np.ndarray:
        """Return (Z, Y, X) bool: voxels with the value, and those in failed slices."""
        found = super().missing(image)
        if self.value is not None:
            found |= image == self.value
        found[[k for k in self.slices if k < len(found)]] = True
        return found

    def about_missing(self) -> str:
        """See ``VoxelEffect``."""
        return "voxels lie in slices without an image"

    def spoil(self, image: np.ndarray) -> None:
        """Set such voxels to the value, or 0 if there is none."""
        image[self.missing(image)] = self.value or 0

    @classmethod
    def seen(cls, detection: Detection) -> Missing | None:
        """Return the effect if the image shows failed slices; else None."""
        return cls(slices=detection.failed) if detection.failed else None
