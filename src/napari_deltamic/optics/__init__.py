"""Models of the microscope: from a point spread function (PSF) to its transfer function (OTF).

What the engine asks of a model is the :class:`Optics` protocol. :func:`microscope` makes one from
the numbers on the objective.
"""

from typing import Protocol

from torch import Tensor

from ..fourier.plan import Cutoff
from .gaussian import GaussianPSF
from .measured import MeasuredPSF
from .microscope import microscope
from .mixture import GaussianMixturePSF
from .modalities import ConfocalPSF, LightSheetPSF
from .objective import GibsonLanniPSF, ScalarPSF, VectorialPSF
from .parameters import Parameter
from .pupil import PupilPSF


class Optics(Protocol):
    """What rendering and fitting need to know of a PSF."""

    @property
    def sigma_um(self) -> tuple[float, float, float]:
        """Width in space along Z, Y, X (um): how far an image reaches beyond a structure."""

    @property
    def diagonal(self) -> bool:
        """Whether the axes of the PSF are those of the grid."""

    def width(self) -> tuple[float, float, float]:
        """um: the OTF of a Gaussian falls below t at ``sqrt(2 ln(1/t)) / width`` along each axis.

        For other PSFs, that of a Gaussian about as wide.
        """

    def reach(self, accuracy: float) -> tuple[float, float, float]:
        """um along Z, Y, X: what lies beyond adds less than the accuracy to an image."""

    def cutoff(self, blur: tuple[float, float, float] = ...) -> Cutoff | None:
        """Where the OTF ends, with a further blur; None where the law of Gaussians holds."""

    def otf(self, axes: tuple[Tensor, Tensor, Tensor]) -> Tensor:
        """Optical transfer function at wavevector components that broadcast over a box (rad/um).

        Real, or complex where the PSF is not symmetric.
        """

    def described(self) -> tuple[Parameter, ...]:
        """Every parameter: name, unit, value, bounds, and whether it is fitted."""

    def parameters(self) -> Tensor:
        """The fitted parameters as unbounded numbers (P,)."""

    def limits(self) -> tuple[Tensor, Tensor]:
        """Range (P,), (P,) of :meth:`parameters` that a fit started here stays within."""

    def with_parameters(self, parameters: Tensor) -> "Optics":
        """The same model with other values of :meth:`parameters`; differentiable."""

    def sharpened(self, factor: float) -> "Optics":
        """The sharpest PSF that a fit may make of it before the band is planned anew."""

    def widened(self, by: float) -> "Optics":
        """A PSF of the same kind whose variance is larger by about the square of ``by`` (um)."""

    def detach(self) -> "Optics":
        """A copy that is no part of any gradient."""


__all__ = [
    "ConfocalPSF",
    "GaussianMixturePSF",
    "GaussianPSF",
    "GibsonLanniPSF",
    "LightSheetPSF",
    "MeasuredPSF",
    "Optics",
    "Parameter",
    "PupilPSF",
    "ScalarPSF",
    "VectorialPSF",
    "microscope",
]
