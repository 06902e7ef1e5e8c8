"""The PSF from the image of a bead: parameters, place, amplitude and background together."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, exp, log, pi

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from torch import Tensor

from ..errors import InputError
from ..fourier import Band
from ..optics import Optics
from ..optics.measured import Bead, bead_transform, checked_stack
from ..scene import Grid
from .evidence.camera import camera_from_image

_DIFFERENCE = 1e-3  # of the PSF's parameters
_PLACE_STEP = 1e-3  # um
_FIRST_DIAMETER = 0.2  # um: where a search for it starts
_DIAMETERS = (1e-2, 50.0)  # um
_SETTLED = 1e-4  # relative fall of the residual
_ACCURACY = 1e-3


@dataclass(frozen=True, eq=False)
class BeadFit:
    """What the image of a bead says of a PSF.

    Attributes
    ----------
    optics
        With the parameters found.
    errors
        Standard error of each fitted parameter, in its unit.
    centre
        um, Z Y X, from the centre of the first voxel.
    bead_diameter
        um: as given, or as found.
    amplitude, background
        Measured = amplitude * (PSF per voxel, of sum 1) + background.
    rendered, residual
        (Z, Y, X): the fitted image, and measured minus fitted.
    chi2
        Mean square of the residual over the variance of the noise: 1 where nothing is left.
    """

    optics: Optics
    errors: dict[str, float]
    centre: tuple[float, float, float]
    bead_diameter: float
    amplitude: float
    background: float
    rendered: NDArray[np.float64]
    residual: NDArray[np.float64]
    chi2: float


def fit_bead(
    image: NDArray,
    voxel_size: tuple[float, float, float],
    optics: Optics,
    *,
    bead_diameter: float | None = 0.0,
    bead: Bead = "solid",
    pixel_integration: bool = True,
    variance: NDArray | None = None,
    iterations: int = 40,
) -> BeadFit:
    """Fit the parameters of a PSF to the image of a bead.

    Levenberg-Marquardt on the residual weighted by the noise, which is taken from the image: its
    variance grows with brightness as that of a camera does.

    Parameters
    ----------
    image
        (Z, Y, X) stack of one bead.
    voxel_size
        um.
    optics
        Where to start; its fitted parameters move.
    bead_diameter
        um; 0 for a point, None to fit it too.
    pixel_integration
        Whether the pixels of the camera gather light over their size (across Z, not along it).
    variance
        (Z, Y, X) of the noise; None to take it from the image.
    iterations
        At most so many.

    Raises
    ------
    InputError
        If the stack cannot be a bead (NaN, saturated, flat), or the PSF has nothing to fit.
    """
    pixels = checked_stack(image)
    if not len(optics.parameters()) and bead_diameter is not None:
        raise InputError("this PSF has no parameter to fit")
    if variance is None:
        variance = _variance(pixels)
    weight = torch.from_numpy(1 / np.maximum(np.asarray(variance, np.float64), 1e-12))
    problem = _Problem(pixels, weight, voxel_size, optics, bead_diameter, bead, pixel_integration)
    p = torch.cat([optics.parameters().detach(), problem.start()])
    low, high = optics.limits()
    damping, cost, linear = 1e-3, *problem.cost(p)
    for _ in range(iterations):
        jacobian, residual = problem.linearised(p, linear)
        normal, right = jacobian.T @ jacobian, jacobian.T @ residual
        fallen = 0.0
        while damping < 1e8:
            diagonal = torch.diagonal(normal)
            # What the image says nothing of stays where it is.
            least = 1e-12 * diagonal.max()
            damped = normal + torch.diag(damping * diagonal + least)
            step = torch.linalg.solve(damped, right)[: len(p)]
            moved = p + step
            moved[: len(low)] = moved[: len(low)].clamp(low, high)
            if bead_diameter is None:
                moved[-1] = moved[-1].clamp(log(_DIAMETERS[0]), log(_DIAMETERS[1]))
            new, new_linear = problem.cost(moved)
            if new < cost:
                fallen = 1 - new / cost
                p, cost, linear = moved, new, new_linear
                damping = max(damping / 10, 1e-9)
                break
            damping *= 10
        if fallen < _SETTLED:
            break
    return problem.found(p, linear)


class _Problem:
    """Image of the bead as a function of (PSF parameters, place)."""

    def __init__(
        self,
        pixels: NDArray[np.float64],
        weight: Tensor,
        voxel_size: tuple[float, float, float],
        optics: Optics,
        diameter: float | None,
        bead: Bead,
        pixel_integration: bool,
    ) -> None:
        self.count = len(optics.parameters())
        self.pixels = torch.from_numpy(pixels)
        self._last: tuple[Tensor, Optics] | None = None
        self.grid = Grid(pixels.shape, voxel_size)
        self.optics = optics
        reach = np.asarray(optics.reach(_ACCURACY))
        shape = [
            next_fast_len(n + ceil(r / d), real=True)
            for n, r, d in zip(pixels.shape, reach, voxel_size, strict=True)
        ]
        self.band = Band.full((shape[0], shape[1], shape[2]), self.grid.voxel_size)
        self.axes = self.band.axes()
        z, y, x = self.axes
        self._wavenumber = torch.sqrt(z * z + y * y + x * x)
        self._kind, self._diameter = bead, diameter
        self._pixel = torch.ones((), dtype=torch.float64)
        if pixel_integration:
            sides = [k * (d / (2 * pi)) for k, d in zip((y, x), voxel_size[1:], strict=True)]
            self._pixel = torch.sinc(sides[0]) * torch.sinc(sides[1])
        self.weight = weight

    def start(self) -> Tensor:
        """(3,) um: about where the bead is."""
        signal = self.pixels - self.pixels.median()
        weight = (signal - 0.5 * signal.max()).clamp(min=0)
        grids = torch.meshgrid(*(torch.arange(n) for n in signal.shape), indexing="ij")
        middle = [float((weight * g).sum() / weight.sum()) for g in grids]
        place = [m * d for m, d in zip(middle, self.grid.voxel_size, strict=True)]
        if self._diameter is None:
            place.append(log(_FIRST_DIAMETER))
        return torch.tensor(place, dtype=torch.float64)

    def diameter(self, p: Tensor) -> float:
        """um."""
        return exp(float(p[-1])) if self._diameter is None else self._diameter

    def image(self, p: Tensor) -> Tensor:
        """(Z, Y, X) per voxel, of sum 1 over all space."""
        optics = self._optics(p)
        bead = bead_transform(self._wavenumber * (self.diameter(p) / 2), self._kind)
        spectrum = optics.otf(self.axes) * (bead * self._pixel)
        for k, place in zip(self.axes, p[self.count :][:3], strict=True):
            phase = k * place
            spectrum = spectrum * torch.complex(torch.cos(phase), -torch.sin(phase))
        return self.band.to_image(spectrum, self.grid.shape)

    def _optics(self, p: Tensor) -> Optics:
        own = p[: self.count]
        # The same object while its parameters are the same: its OTF is kept.
        if self._last is None or not torch.equal(self._last[0], own):
            self._last = (own.clone(), self.optics.with_parameters(own))
        return self._last[1]

    def _scaled(self, image: Tensor) -> tuple[float, float]:
        w, m, y = self.weight, image, self.pixels
        total, mean, seen = w.sum(), (w * m).sum(), (w * y).sum()
        a = ((w * m * y).sum() - mean * seen / total) / ((w * m * m).sum() - mean**2 / total)
        return float(a), float((seen - a * mean) / total)

    def cost(self, p: Tensor) -> tuple[float, tuple[float, float, Tensor]]:
        """Weighted sum of squares; amplitude, background and image there."""
        with torch.no_grad():
            image = self.image(p)
            a, b = self._scaled(image)
            residual = self.pixels - a * image - b
            return float((self.weight * residual**2).sum()), (a, b, image)

    def linearised(self, p: Tensor, at: tuple[float, float, Tensor]) -> tuple[Tensor, Tensor]:
        """Weighted Jacobian (voxels, parameters + 2) and residual."""
        a, b, image = at
        columns = []
        with torch.no_grad():
            for i in range(len(p)):
                change = torch.zeros_like(p)
                change[i] = _DIFFERENCE if i < self.count else _PLACE_STEP
                wide = self.image(p + change) - self.image(p - change)
                columns.append(a * wide / (2 * float(change[i])))
        columns += [image, torch.ones_like(image)]
        root = torch.sqrt(self.weight).reshape(-1)
        jacobian = torch.stack([c.reshape(-1) * root for c in columns], 1)
        residual = (self.pixels - a * image - b).reshape(-1) * root
        return jacobian, residual

    def found(self, p: Tensor, at: tuple[float, float, Tensor]) -> BeadFit:
        jacobian, _ = self.linearised(p, at)
        covariance = torch.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
        optics = self._optics(p)
        a, b, image = at
        rendered = (a * image + b).numpy()
        residual = self.pixels.numpy() - rendered
        z, y, x = (float(c) for c in p[self.count :][:3])
        return BeadFit(
            optics=optics,
            errors=physical_errors(optics, covariance[: self.count, : self.count]),
            centre=(z, y, x),
            bead_diameter=self.diameter(p),
            amplitude=a,
            background=b,
            rendered=rendered,
            residual=residual,
            chi2=float((self.weight.numpy() * residual**2).mean()),
        )


def _variance(pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    line = camera_from_image(pixels).line
    if line is not None:
        return line.variance(pixels)
    dark = float(np.median(pixels))
    spread = 1.4826 * float(np.median(np.abs(pixels - dark)))
    return np.full(pixels.shape, spread**2)


def physical_errors(optics: Optics, covariance: Tensor) -> dict[str, float]:
    """Standard errors of the fitted parameters, in their units.

    covariance : (P, P) of :meth:`Optics.parameters`.
    """
    p = optics.parameters().detach()
    names = [q.name for q in optics.described() if q.fitted]

    def values(parameters: Tensor) -> NDArray[np.float64]:
        moved = optics.with_parameters(parameters)
        return np.array([q.value for q in moved.described() if q.fitted])

    h = 1e-4
    slope = np.zeros((len(names), len(p)))
    for i in range(len(p)):
        change = torch.zeros_like(p)
        change[i] = h
        slope[:, i] = (values(p + change) - values(p - change)) / (2 * h)
    spread = slope @ covariance.numpy() @ slope.T
    return {n: float(np.sqrt(max(v, 0.0))) for n, v in zip(names, np.diag(spread), strict=True)}
