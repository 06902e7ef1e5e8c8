"""Effects on the OTF: the voxels' own size, and light far from the focus."""

from __future__ import annotations

from math import log, pi, sqrt
from typing import Annotated, ClassVar

import torch
from pydantic import Field
from torch import Tensor

from ..grid import Grid
from .base import Axes, Bounds, Cost, TransferEffect


class PixelIntegration(TransferEffect):
    """A voxel collects light over its whole size instead of at its centre."""

    name: ClassVar[str] = "pixel_integration"
    title: ClassVar[str] = "voxel averaging"
    help: ClassVar[str] = (
        "a voxel collects light over its whole size instead of at its centre: widens the image by "
        "0.29 voxel; for voxels that are not much smaller than the PSF; takes no time that can be "
        "measured"
    )
    cost: ClassVar[Cost] = Cost(bands=2)

    fit: bool = Field(default=False, description="it has no numbers: the voxel size is known")

    def transfer(self, axes: Axes, frame: Grid) -> Tensor:
        """``sinc(xi_i d_i / 2)`` along each axis."""
        z, y, x = (
            torch.sinc(k * (d / (2 * pi))) for k, d in zip(axes, frame.voxel_size, strict=True)
        )
        return z * y * x


class Halo(TransferEffect):
    """A share of the light that lands far from where it should, as out-of-focus light does."""

    name: ClassVar[str] = "halo"
    title: ClassVar[str] = "halo"
    help: ClassVar[str] = (
        "part of the light is spread far around the focus; left out, it passes for background or "
        "for light from inside the cells; the image is padded by its reach"
    )
    cost: ClassVar[Cost] = Cost(bands=4)
    bounds: ClassVar[dict[str, Bounds]] = {
        "fraction": Bounds("1", 0.0, 0.8, 0.1),
        "width": Bounds("um", 0.05, 10.0, 1.0),
    }
    tried_widths: ClassVar[dict[str, tuple[float, ...]]] = {"width": (3.0, 6.0, 12.0)}

    fraction: Annotated[float, Field(ge=0, le=0.8)] = Field(
        default=0.02, description="share of the light in the halo"
    )
    width: Annotated[float, Field(ge=0.05, le=10)] = Field(
        default=1.0, description="um: standard deviation of the Gaussian by which it is spread"
    )

    @classmethod
    def neutral(cls) -> Halo:
        """Return a halo without light, as wide as the default."""
        return cls(fraction=0.0)

    def transfer(self, axes: Axes, frame: Grid) -> Tensor:
        """``1 - f + f exp(-w^2 |xi|^2 / 2)``."""
        z, y, x = axes
        half = -0.5 * self.width**2
        spread = torch.exp(half * z**2) * torch.exp(half * y**2) * torch.exp(half * x**2)
        return (1 - self.fraction) + self.fraction * spread

    @property
    def spread(self) -> float:
        """The width of the halo (um), within which its light counts."""
        return self.width

    def hides_reach(self) -> bool:
        """True: a halo is seen everywhere, so that everything would count."""
        return True

    def reach(self, share: float) -> float:
        """Return the distance (um) beyond which it adds less than ``share`` of the light."""
        return self.width * sqrt(2 * log(max(self.fraction / max(share, 1e-12), 1.0)))
