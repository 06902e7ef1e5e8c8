"""Effects that change along the optical axis: attenuation, bleaching, a PSF that widens."""

from __future__ import annotations

from math import log, sqrt
from typing import Annotated, ClassVar

import torch
from pydantic import Field
from torch import Tensor

from ..grid import Grid
from .base import Axes, Bounds, Cost, DepthEffect, FaceEffect, GainEffect, middle


class Attenuation(FaceEffect):
    """Attenuation of light on its way: faces dim exponentially with depth."""

    name: ClassVar[str] = "attenuation"
    title: ClassVar[str] = "dimmer with depth"
    help: ClassVar[str] = (
        "structures dim with depth, as absorption and scattering make them; left out, at 2 % per "
        "um, surfaces shift by about 10 nm along z"
    )
    contradicts: ClassVar[tuple[str, ...]] = ("bleaching",)
    bounds: ClassVar[dict[str, Bounds]] = {"per_um": Bounds("1/um", -0.5, 0.5, 0.02)}

    per_um: Annotated[float, Field(ge=-0.5, le=0.5)] = Field(
        default=0.0,
        description="1/um; rate of the exponential loss of light along z, 0.02 for 2 % per um; "
        "1 in the middle of the image; below 0 where the last slice is the nearest",
    )

    def face_weights(self, centroids: Tensor, frame: Grid) -> Tensor:
        """``exp(-mu (z - z_middle))``."""
        return torch.exp(-self.per_um * (centroids[:, 0] - float(middle(frame)[0])))


class Bleaching(GainEffect):
    """Bleaching while a stack is taken: slices dim exponentially, one after the other."""

    name: ClassVar[str] = "bleaching"
    title: ClassVar[str] = "bleaching during the stack"
    help: ClassVar[str] = (
        "slices dim one after the other while the stack is taken; left out, surfaces shift "
        "slightly along z"
    )
    contradicts: ClassVar[tuple[str, ...]] = ("attenuation",)
    bounds: ClassVar[dict[str, Bounds]] = {"per_slice": Bounds("1/slice", -0.5, 0.5, 0.01)}

    per_slice: Annotated[float, Field(ge=-0.5, le=0.5)] = Field(
        default=0.0,
        description="1/slice; rate of the exponential loss of light, 0.01 for 1 % from a slice to "
        "the next; 1 in the middle slice; below 0 where the last slice was taken first",
    )

    def gain(self, grid: Grid, frame: Grid) -> Tensor:
        """``exp(-rate (k - k_middle))`` in slice k."""
        z = grid.origin[0] + grid.voxel_size[0] * torch.arange(grid.shape[0], dtype=torch.float64)
        slices = (z - float(middle(frame)[0])) / frame.voxel_size[0]
        return torch.exp(-self.per_slice * slices)[:, None, None]


class DepthPSF(DepthEffect):
    """The PSF widens with depth, as a mismatch of refractive indices or scattering makes it.

    The OTF at relative depth t is that of the first slice times ``1 - t`` plus that of the last
    times t: two modes, each with its own sum over the faces.
    """

    name: ClassVar[str] = "depth_psf"
    title: ClassVar[str] = "blur grows with depth"
    help: ClassVar[str] = (
        "the PSF widens from one end of the stack to the other; left out, surfaces are seen too "
        "thick at one end and too thin at the other"
    )
    cost: ClassVar[Cost] = Cost(transforms=1, bands=10)
    bounds: ClassVar[dict[str, Bounds]] = {
        "variance_z": Bounds("um^2", -4.0, 4.0, 0.1),
        "variance_yx": Bounds("um^2", -1.0, 1.0, 0.02),
    }

    variance_z: Annotated[float, Field(ge=-4, le=4)] = Field(
        default=0.0,
        description="um^2 by which the variance of the PSF along z is larger in the last slice "
        "than in the first; below 0: smaller",
    )
    variance_yx: Annotated[float, Field(ge=-1, le=1)] = Field(
        default=0.0, description="um^2, the same along y and x"
    )

    def reach(self, share: float) -> float:
        """Return the distance (um) beyond which it adds less than ``share`` of the light."""
        largest = max(abs(self.variance_z), abs(self.variance_yx))
        return sqrt(2 * largest * log(1 / max(share, 1e-12)))

    def depths(self, centroids: Tensor, frame: Grid) -> Tensor:
        """Return (F,) relative depths: 0 up to the first slice, 1 from the last on."""
        first, last = frame.extent
        depth = (centroids[:, 0] - float(first[0])) / max(float(last[0] - first[0]), 1e-12)
        return depth.clamp(0, 1)

    def transfers(self, axes: Axes) -> tuple[Tensor, Tensor]:
        """Return factors on the OTF in the first and in the last slice."""
        z, yx = axes[0] ** 2, axes[1] ** 2 + axes[2] ** 2
        first = max(-self.variance_z, 0.0) * z + max(-self.variance_yx, 0.0) * yx
        last = max(self.variance_z, 0.0) * z + max(self.variance_yx, 0.0) * yx
        return torch.exp(-0.5 * first), torch.exp(-0.5 * last)
