"""Models of the microscope: from a point spread function (PSF) to its transfer function (OTF).

The engine uses any model that follows the :class:`Optics` protocol. :func:`microscope` makes one
from the numbers on the objective.
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
    """What rendering and fitting need to know about a PSF."""

    @property
    def sigma_um(self) -> tuple[float, float, float]:
        """Standard deviations along Z, Y, X (um); effective widths if the PSF is not Gaussian."""

    @property
    def diagonal(self) -> bool:
        """Whether the axes of the PSF are those of the grid."""

    def width(self) -> tuple[float, float, float]:
        """Return widths (um): a Gaussian's OTF falls below t at ``sqrt(2 ln(1/t)) / width``.

        One for each axis; for other PSFs, that of a Gaussian about as wide.
        """

    def reach(self, accuracy: float) -> tuple[float, float, float]:
        """Return distances (um) by axis beyond which a PSF adds less than the accuracy."""

    def cutoff(self, blur: tuple[float, float, float] = ...) -> Cutoff | None:
        """Return where the OTF ends, with a further blur (um); None for a Gaussian PSF."""

    def otf(self, axes: tuple[Tensor, Tensor, Tensor]) -> Tensor:
        """Return the OTF at wavevector components (rad/um) that broadcast over a box.

        It is real, or complex if the PSF is not symmetric.
        """

    def described(self) -> tuple[Parameter, ...]:
        """Describe every parameter: name, unit, value, bounds, and whether it is fitted."""

    def parameters(self) -> Tensor:
        """Return the fitted parameters as unbounded numbers (P,)."""

    def limits(self) -> tuple[Tensor, Tensor]:
        """Return bounds (P,), (P,) of :meth:`parameters` for a fit that starts here."""

    def with_parameters(self, parameters: Tensor) -> "Optics":
        """Return the model with other values of :meth:`parameters`, differentiable in them."""

    def sharpened(self, factor: float) -> "Optics":
        """Return the sharpest PSF that a fit may reach before the band is planned anew."""

    def widened(self, by: float) -> "Optics":
        """Return a PSF of the same kind, its variance larger by about ``by`` (um) squared."""

    def detach(self) -> "Optics":
        """Return a copy detached from any gradient."""


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
