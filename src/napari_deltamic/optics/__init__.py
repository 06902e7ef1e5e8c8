"""Models of the microscope: from a point spread function (PSF) to its transfer function (OTF).

What the engine asks of a model is the :class:`Optics` protocol; :class:`GaussianPSF` is one.
"""

from typing import Protocol

from torch import Tensor

from .gaussian import GaussianPSF


class Optics(Protocol):
    """What rendering and fitting need to know of a PSF."""

    @property
    def sigma_um(self) -> tuple[float, float, float]:
        """Width in space along Z, Y, X (um): how far an image reaches beyond a structure."""

    @property
    def diagonal(self) -> bool:
        """Whether the axes of the PSF are those of the grid."""

    def width(self) -> tuple[float, float, float]:
        """um: the OTF falls below t at ``sqrt(2 ln(1/t)) / width`` along each axis."""

    def otf(self, axes: tuple[Tensor, Tensor, Tensor]) -> Tensor:
        """Optical transfer function at wavevector components that broadcast over a box (rad/um)."""

    def parameters(self) -> Tensor:
        """Free numbers, unbounded; the first three are log widths along Z, Y, X."""

    def with_parameters(self, parameters: Tensor) -> "Optics":
        """The same model with other values of :meth:`parameters`."""

    def detach(self) -> "Optics":
        """A copy that is no part of any gradient."""


__all__ = ["GaussianPSF", "Optics"]
