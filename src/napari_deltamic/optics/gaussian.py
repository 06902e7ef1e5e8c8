"""Gaussian point spread function (PSF)."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, copysign, degrees, inf, log, sqrt

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from ..geometry.arrays import FARTHEST
from .parameters import RANGE, Parameter


class GaussianPSF:
    """A Gaussian PSF of unit mass; its OTF is ``exp(-xi' Sigma xi / 2)``.

    Parameters
    ----------
    sigma
        um along Z, Y, X (one number: the same along each). A torch tensor is kept as it is, so that
        rendering is differentiable in it.
    covariance
        (3, 3) um^2, symmetric and positive definite, instead of sigma.

    Raises
    ------
    InputError
        If sigma is not positive and finite, or the covariance not positive definite.
    """

    def __init__(
        self,
        sigma: float | Sequence[float] | np.ndarray | Tensor | None = None,
        covariance: Sequence[Sequence[float]] | np.ndarray | Tensor | None = None,
    ) -> None:
        if (sigma is None) == (covariance is None):
            raise InputError("a Gaussian PSF takes either sigma or a covariance")
        if sigma is not None:
            self._cholesky = torch.diag(_checked_sigma(sigma))
            self._diagonal = True
        else:
            self._cholesky = _checked_cholesky(covariance)
            self._diagonal = False

    @property
    def diagonal(self) -> bool:
        """Whether the covariance is diagonal, so that the PSF's axes are those of the grid."""
        return self._diagonal

    @property
    def covariance(self) -> Tensor:
        """Covariance of the PSF, (3, 3) um^2."""
        return self._cholesky @ self._cholesky.T

    @property
    def sigma(self) -> Tensor:
        """(3,) standard deviations along Z, Y, X, um."""
        if self._diagonal:
            return torch.diagonal(self._cholesky)
        return torch.sqrt(torch.diagonal(self.covariance))

    @property
    def sigma_um(self) -> tuple[float, float, float]:
        """``sigma`` as plain numbers."""
        z, y, x = (float(s) for s in self.sigma.detach())
        return z, y, x

    @property
    def tilt(self) -> tuple[float, float]:
        """Degrees by which the longest axis leans from Z towards Y and X; 0 along the axes."""
        if self._diagonal:
            return 0.0, 0.0
        z, *across = torch.linalg.eigh(self.covariance.detach())[1][:, -1].tolist()
        y, x = (degrees(atan2(copysign(1, z) * a, abs(z))) for a in across)
        return y, x

    def width(self) -> tuple[float, float, float]:
        """Return widths (um) by axis: the OTF falls below t at ``sqrt(2 ln(1/t)) / width``."""
        inverse = torch.linalg.inv(self.covariance.detach())
        z, y, x = (float(1 / torch.sqrt(i)) for i in torch.diagonal(inverse))
        return z, y, x

    def reach(self, accuracy: float) -> tuple[float, float, float]:
        """Return distances (um) by axis beyond which a PSF adds less than the accuracy."""
        z, y, x = (gaussian_reach(accuracy) * s for s in self.sigma_um)
        return z, y, x

    def cutoff(self, blur: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        """Return None: the OTF is Gaussian, see :meth:`width`."""

    def otf(self, axes: tuple[Tensor, Tensor, Tensor]) -> Tensor:
        """Return the OTF at wavevector components (rad/um) that broadcast over a box."""
        z, y, x = axes
        if self._diagonal:
            s = self.sigma.to(z.dtype)
            return (
                torch.exp(-0.5 * (s[0] * z) ** 2)
                * torch.exp(-0.5 * (s[1] * y) ** 2)
                * torch.exp(-0.5 * (s[2] * x) ** 2)
            )
        c = self._cholesky.to(z.dtype)
        a = c[0, 0] * z + c[1, 0] * y + c[2, 0] * x
        b = c[1, 1] * y + c[2, 1] * x
        return torch.exp(-0.5 * (a * a + b * b + (c[2, 2] * x) ** 2))

    # ------------------------------------------------------------------ parameters of a fit

    def parameters(self) -> Tensor:
        """Return the log diagonal of the covariance's Cholesky factor, then its lower triangle.

        Any values of these give a positive definite covariance.
        """
        log_diagonal = torch.log(torch.diagonal(self._cholesky))
        if self._diagonal:
            return log_diagonal
        lower = self._cholesky[(1, 2, 2), (0, 0, 1)]
        return torch.cat([log_diagonal, lower])

    def limits(self) -> tuple[Tensor, Tensor]:
        """Return bounds of :meth:`parameters` for a fit that starts here: widths times 1/4 to 4.

        In an image that says nothing about the PSF, noise for example, widths would otherwise go to
        zero or beyond the image.
        """
        p = self.parameters().detach()
        reach = torch.full_like(p, inf)
        reach[:3] = RANGE
        return p - reach, p + reach

    def sharpened(self, factor: float) -> GaussianPSF:
        """Return the PSF with widths times ``factor``."""
        p = self.parameters().detach().clone()
        p[:3] += float(np.log(factor))
        return self.with_parameters(p)

    def widened(self, by: float) -> GaussianPSF:
        """Return the PSF with a variance larger by the square of ``by`` (um)."""
        covariance = self.covariance.detach() + by**2 * torch.eye(3, dtype=torch.float64)
        if self.diagonal:
            return GaussianPSF(covariance.diagonal().sqrt())
        return GaussianPSF(covariance=covariance)

    def described(self) -> tuple[Parameter, ...]:
        """Describe every parameter with its unit, value and bounds."""
        widths = [
            Parameter(f"sigma_{axis}", "um", f"standard deviation along {axis.upper()}",
                      value, 0.0, None, True, "")
            for axis, value in zip("zyx", self.sigma_um, strict=True)
        ]  # fmt: skip
        leans = [] if self._diagonal else zip("yx", self.tilt, strict=True)
        about = "tilt of the longest axis from Z towards"
        return *widths, *(
            Parameter(f"tilt_{axis}", "degrees", f"{about} {axis.upper()}",
                      value, -90.0, 90.0, True, "")
            for axis, value in leans
        )  # fmt: skip

    def with_parameters(self, parameters: Tensor) -> GaussianPSF:
        """Return the PSF with other values of :meth:`parameters`, differentiable in them."""
        if self._diagonal:
            return GaussianPSF(sigma=torch.exp(parameters))
        lower = torch.zeros(3, 3, dtype=parameters.dtype)
        lower = lower.index_put((torch.tensor([1, 2, 2]), torch.tensor([0, 0, 1])), parameters[3:])
        return GaussianPSF._from_cholesky(lower + torch.diag(torch.exp(parameters[:3])))

    @classmethod
    def _from_cholesky(cls, cholesky: Tensor) -> GaussianPSF:
        psf = cls.__new__(cls)
        psf._cholesky, psf._diagonal = cholesky, False
        return psf

    def detach(self) -> GaussianPSF:
        """Return a copy detached from any gradient."""
        psf = GaussianPSF._from_cholesky(self._cholesky.detach().clone())
        psf._diagonal = self._diagonal
        return psf

    def __repr__(self) -> str:
        z, y, x = self.sigma_um
        return f"GaussianPSF(sigma=({z:.4g}, {y:.4g}, {x:.4g}) um)"


def gaussian_reach(accuracy: float) -> float:
    """Return how many sigma an image reaches beyond a surface until it is below the accuracy."""
    return sqrt(2 * log(1 / max(accuracy * 0.1, 1e-12)))


def _tensor(values: object, name: str) -> Tensor:
    if isinstance(values, Tensor):
        return values
    try:
        return torch.as_tensor(np.asarray(values, dtype=float))
    except (TypeError, ValueError):
        raise InputError(f"{name} takes numbers (um), not {values!r}") from None


def _checked_sigma(sigma: float | Sequence[float] | np.ndarray | Tensor) -> Tensor:
    s = _tensor(sigma, "sigma")
    s = s.to(torch.float64) if not s.is_floating_point() else s
    if s.ndim == 0:
        s = s.expand(3)
    if s.shape != (3,):
        raise InputError(f"sigma takes one number or three (Z, Y, X), not shape {tuple(s.shape)}")
    values = s.detach()
    if not bool(((values > 0) & (values < FARTHEST)).all()):  # false for NaN, too
        shown = ", ".join(f"{float(v):g}" for v in values)
        raise InputError(f"sigma must be positive (um), not ({shown})")
    return s


def _checked_cholesky(covariance: object) -> Tensor:
    c = _tensor(covariance, "a covariance")
    if c.shape != (3, 3):
        raise InputError(f"a covariance has shape (3, 3), not {tuple(c.shape)}")
    if not torch.allclose(c, c.T, rtol=1e-6, atol=0):
        raise InputError("a covariance is symmetric")
    factor, failed = torch.linalg.cholesky_ex((c + c.T) / 2)
    if int(failed) != 0 or not bool((factor.abs() < FARTHEST).all()):
        raise InputError("a covariance is positive definite")
    return factor
