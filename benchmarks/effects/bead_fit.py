"""The PSF from the image of a bead: parameters, place, amplitude and background together."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from math import ceil, exp, log, pi
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from torch import Tensor

from napari_deltamic.common.normal import SIGMA_PER_MEDIAN_DEVIATION
from napari_deltamic.errors import InputError
from napari_deltamic.evidence.camera import camera_from_image
from napari_deltamic.fourier import Band
from napari_deltamic.optics import Optics
from napari_deltamic.optics.measured import bead_transform, checked_sizes, checked_stack
from napari_deltamic.scene import Grid

from .bead_slices import Disturbance, Slices, Term, normal_equations

Staining = Literal["solid", "shell", "rim"]
_HALF_WIDTH = 2.355  # by definition 2 sqrt(2 ln 2): at half the maximum of a Gaussian of sigma 1


@dataclass(frozen=True)
class BeadRules:
    """How a bead's image is fitted.

    Attributes
    ----------
    difference, place_step
        By which derivatives in the PSF's numbers and in the place (um) are taken: as small as
        images in double precision allow, and less than any PSF can show.
    least_first
        um: the least diameter that a search for it starts from, since a smaller bead is a point to
        any microscope and the derivative in its diameter vanishes.
    diameters
        um, least and largest: beads that are made.
    first_core, cores
        Of the diameter of a bead stained at its rim: where a search starts, and what it may be; a
        core of nothing or of all would be a solid or a shell.
    settled
        Relative fall of the residual that is the end: less than the noise of one of ten thousand
        voxels.
    accuracy
        Of the images: below the noise of any bead's image.
    first_damping, least_damping, most_damping
        Of Levenberg-Marquardt, relative to the diagonal; at the last nothing moves, so that the
        search has ended. Measured: half and twice of any change nothing.
    unit_step
        By which errors in the PSF's numbers are carried over to its units: rounding and curvature
        are both below 1e-6 then.
    """

    difference: float = 1e-3
    place_step: float = 1e-3
    least_first: float = 0.2
    diameters: tuple[float, float] = (1e-2, 50.0)
    first_core: float = 0.7
    cores: tuple[float, float] = (0.02, 0.98)
    settled: float = 1e-4
    accuracy: float = 1e-3
    first_damping: float = 1e-3
    least_damping: float = 1e-9
    most_damping: float = 1e8
    unit_step: float = 1e-4


BEAD = BeadRules()


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
    core_diameter
        um: of the middle that is not stained, of a bead stained at its rim; else 0.
    amplitude, background
        Measured = amplitude * (PSF per voxel, of sum 1) + background; means over the slices.
    slices
        What was found of each disturbance, by its name: brightness relative to the mean and
        background of each slice (Z,), drift (Z, 2: Y, X) and focus (Z,) in um, variances of the
        motion (Z, 3: YY, XX, YX) in um^2, standard deviation of the axial blur in um.
    rendered, residual
        (Z, Y, X): the fitted image, and measured minus fitted.
    chi2
        Mean square of the residual over the variance of the noise: 1 where nothing is left.
    """

    optics: Optics
    errors: dict[str, float]
    centre: tuple[float, float, float]
    bead_diameter: float
    core_diameter: float
    amplitude: float
    background: float
    slices: dict[str, NDArray[np.float64]]
    rendered: NDArray[np.float64]
    residual: NDArray[np.float64]
    chi2: float


def fit_bead(
    image: NDArray,
    voxel_size: tuple[float, float, float],
    optics: Optics,
    *,
    bead_diameter: float | None = 0.0,
    bead: Staining = "solid",
    disturbances: Collection[Disturbance] = (),
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
    bead
        ``"solid"``, ``"shell"`` (stained on its surface), or ``"rim"``: solid but for a middle that
        the stain has not reached, whose diameter is fitted.
    disturbances
        What of the acquisition is fitted too; see :class:`.bead_slices.Slices`. A still bead seen
        by even steps needs none.
    pixel_integration
        Whether the pixels of the camera gather light over their size (across Z, not along it).
    variance
        (Z, Y, X) of the noise; None to take it from the image.
    iterations
        At most so many.

    Raises
    ------
    InputError
        If the stack cannot be a bead (NaN, saturated, flat), a size is in another unit, or the PSF
        has nothing to fit.
    """
    pixels = checked_stack(image)
    checked_sizes(voxel_size, bead_diameter or 0.0)
    if not len(optics.parameters()) and bead_diameter is not None:
        raise InputError("this PSF has no parameter to fit")
    if variance is None:
        variance = _variance(pixels)
    weight = torch.from_numpy(1 / np.maximum(np.asarray(variance, np.float64), 1e-12))
    problem = _Problem(
        pixels, weight, voxel_size, optics, bead_diameter, bead, disturbances, pixel_integration
    )
    p = problem.start()
    damping, cost, linear = BEAD.first_damping, *problem.cost(p)
    for _ in range(iterations):
        normal, right = problem.unblocked(p, *problem.normal(p, linear))
        fallen = 0.0
        while damping < BEAD.most_damping:
            diagonal = torch.diagonal(normal)
            # What the image says nothing of stays where it is.
            least = 1e-12 * diagonal.max()
            damped = normal + torch.diag(damping * diagonal + least)
            moved = problem.bounded(p + torch.linalg.solve(damped, right)[: len(p)])
            new, new_linear = problem.cost(moved)
            if new < cost:
                fallen = 1 - new / cost
                p, cost, linear = moved, new, new_linear
                damping = max(damping / 10, BEAD.least_damping)
                break
            damping *= 10
        if fallen < BEAD.settled:
            break
    return problem.found(p, linear)


class _Problem:
    """Image of the bead as a function of (PSF parameters, place, size, disturbances)."""

    def __init__(
        self,
        pixels: NDArray[np.float64],
        weight: Tensor,
        voxel_size: tuple[float, float, float],
        optics: Optics,
        diameter: float | None,
        bead: Staining,
        disturbances: Collection[str],
        pixel_integration: bool,
    ) -> None:
        self.count = len(optics.parameters())
        self.pixels = torch.from_numpy(pixels)
        self._last: tuple[Tensor, Optics] | None = None
        self.grid = Grid(pixels.shape, voxel_size)
        self.optics = optics
        reach = np.asarray(optics.reach(BEAD.accuracy))
        shape = [
            next_fast_len(n + ceil(r / d), real=True)
            for n, r, d in zip(pixels.shape, reach, voxel_size, strict=True)
        ]
        band = Band.full((shape[0], shape[1], shape[2]), self.grid.voxel_size)
        self.axes = band.axes()
        self.slices = Slices(disturbances, band, self.grid.shape)
        z, y, x = self.axes
        self._wavenumber = torch.sqrt(z * z + y * y + x * x)
        self._staining, self._diameter = bead, diameter
        self._pixel = torch.ones((), dtype=torch.float64)
        if pixel_integration:
            sides = [k * (d / (2 * pi)) for k, d in zip((y, x), voxel_size[1:], strict=True)]
            self._pixel = torch.sinc(sides[0]) * torch.sinc(sides[1])
        self.weight = weight
        low, high = optics.limits()
        bounds = [(-np.inf, np.inf)] * 3
        if diameter is None:
            bounds.append((log(BEAD.diameters[0]), log(BEAD.diameters[1])))
        if bead == "rim":
            bounds.append(BEAD.cores)
        self._low = torch.cat([low.detach(), torch.tensor([b[0] for b in bounds])]).double()
        self._high = torch.cat([high.detach(), torch.tensor([b[1] for b in bounds])]).double()

    def start(self) -> Tensor:
        """(P,) about where the bead is, and the PSF as given."""
        signal = self.pixels - self.pixels.median()
        weight = (signal - 0.5 * signal.max()).clamp(min=0)
        grids = torch.meshgrid(*(torch.arange(n) for n in signal.shape), indexing="ij")
        middle = [float((weight * g).sum() / weight.sum()) for g in grids]
        own = [m * d for m, d in zip(middle, self.grid.voxel_size, strict=True)]
        if self._diameter is None:
            own.append(log(self._apparent_diameter(signal)))
        if self._staining == "rim":
            own.append(BEAD.first_core)
        known = self.optics.parameters().detach()
        return torch.cat([known, torch.tensor(own, dtype=torch.float64), self.slices.start()])

    def _apparent_diameter(self, signal: Tensor) -> float:
        """um: of a disc as large as what is brighter than half of the peak, less the PSF's own."""
        pixel = self.grid.voxel_size[1] * self.grid.voxel_size[2]
        bright = (signal > 0.5 * signal.max()).sum((1, 2)).max()
        own = _HALF_WIDTH * float(np.mean(self.optics.width()[1:]))
        squared = 4 / pi * float(bright) * pixel - own**2
        return min(max(squared, BEAD.least_first**2), BEAD.diameters[1] ** 2 / 4) ** 0.5

    def bounded(self, p: Tensor) -> Tensor:
        """Parameters within their bounds."""
        own = len(self._low)
        return torch.cat([p[:own].clamp(self._low, self._high), self.slices.bounded(p[own:])])

    def diameter(self, p: Tensor) -> float:
        """um."""
        return exp(float(p[self.count + 3])) if self._diameter is None else self._diameter

    def core(self, p: Tensor) -> float:
        """Of the diameter: what is not stained."""
        return float(p[len(self._low) - 1]) if self._staining == "rim" else 0.0

    def spectrum(self, p: Tensor) -> Tensor:
        """Of the bead seen without disturbances, per voxel, of sum 1 over all space."""
        optics = self._optics(p)
        kind: Literal["solid", "shell"] = "shell" if self._staining == "shell" else "solid"
        radius = self.diameter(p) / 2
        bead = bead_transform(self._wavenumber * radius, kind, self.core(p))
        spectrum = optics.otf(self.axes) * (bead * self._pixel)
        for k, place in zip(self.axes, p[self.count :][:3], strict=True):
            phase = k * place
            spectrum = spectrum * torch.complex(torch.cos(phase), -torch.sin(phase))
        return spectrum

    def image(self, p: Tensor) -> Tensor:
        """(Z, Y, X) per voxel, of sum 1 over all space."""
        return self.slices.image(self.spectrum(p), p[len(self._low) :])

    def _optics(self, p: Tensor) -> Optics:
        own = p[: self.count]
        # The same object while its parameters are the same: its OTF is kept.
        if self._last is None or not torch.equal(self._last[0], own):
            self._last = (own.clone(), self.optics.with_parameters(own))
        return self._last[1]

    def cost(self, p: Tensor) -> tuple[float, tuple[Tensor, Tensor]]:
        """Weighted sum of squares; amplitudes and backgrounds, and the image there."""
        with torch.no_grad():
            image = self.image(p)
            linear = self.slices.scaled(image, self.pixels, self.weight)
            residual = self.pixels - self.slices.applied(image, linear)
            unlikely = p[len(self._low) :] / self.slices.expected()
            square = float((self.weight * residual**2).sum() + (unlikely**2).sum())
            return square, (linear, image)

    def normal(self, p: Tensor, at: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        """Normal matrix and right side of the step of (parameters, linear parts)."""
        linear, image = at
        residual = self.pixels - self.slices.applied(image, linear)
        terms = self.terms(p, at)
        normal, right = normal_equations(terms, residual, self.weight)
        own, end = len(self._low), len(p)
        precision = 1 / self.slices.expected() ** 2
        normal.diagonal()[own:end] += precision
        right[own:end] -= precision * p[own:]
        return normal, right

    def unblocked(self, p: Tensor, normal: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
        """The same without what would leave its bounds: the others step as if it were held."""
        low = torch.cat([self._low, self.slices.lowest()])
        high = torch.cat([self._high, torch.full((self.slices.count,), torch.inf)])
        downhill = right[: len(p)]
        blocked = torch.zeros(len(right), dtype=torch.bool)
        blocked[: len(p)] = ((p <= low) & (downhill <= 0)) | ((p >= high) & (downhill >= 0))
        normal, right = normal.clone(), right.clone()
        normal[blocked], normal[:, blocked], right[blocked] = 0.0, 0.0, 0.0
        normal.diagonal()[blocked] = 1.0
        return normal, right

    def terms(self, p: Tensor, at: tuple[Tensor, Tensor]) -> list[Term]:
        """Derivatives of the stack by the parameters and by its linear parts."""
        linear, image = at
        gain = self.slices.brightness(linear)[:, None, None]
        found: list[Term] = []
        with torch.no_grad():
            for i in range(len(self._low)):
                change = torch.zeros_like(p)
                change[i] = BEAD.difference if i < self.count else BEAD.place_step
                wide = self.image(p + change) - self.image(p - change)
                found.append((wide / (2 * float(change[i])), self.slices.all))
            found += self.slices.terms(self.spectrum(p), p[len(self._low) :])
        return [(gain * t, share) for t, share in found] + self.slices.linear_terms(image)

    def found(self, p: Tensor, at: tuple[Tensor, Tensor]) -> BeadFit:
        normal, _ = self.normal(p, at)
        scale = torch.sqrt(torch.diagonal(normal).clamp(min=1e-300))
        inverse = torch.linalg.pinv(normal / (scale[:, None] * scale), hermitian=True)
        covariance = (inverse / (scale[:, None] * scale))[: self.count, : self.count]
        optics = self._optics(p)
        linear, image = at
        rendered = self.slices.applied(image, linear).numpy()
        residual = self.pixels.numpy() - rendered
        z, y, x = (float(c) for c in p[self.count :][:3])
        described = self.slices.described(p[len(self._low) :], linear)
        return BeadFit(
            optics=optics,
            errors=physical_errors(optics, covariance),
            centre=(z, y, x),
            bead_diameter=self.diameter(p),
            core_diameter=self.core(p) * self.diameter(p),
            amplitude=float(self.slices.brightness(linear).mean()),
            background=float(self.slices.background(linear).mean()),
            slices={name: value.numpy() for name, value in described.items()},
            rendered=rendered,
            residual=residual,
            chi2=float((self.weight.numpy() * residual**2).mean()),
        )


def _variance(pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    line = camera_from_image(pixels).line
    if line is not None:
        return line.variance(pixels)
    dark = float(np.median(pixels))
    spread = SIGMA_PER_MEDIAN_DEVIATION * float(np.median(np.abs(pixels - dark)))
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

    h = BEAD.unit_step
    slope = np.zeros((len(names), len(p)))
    for i in range(len(p)):
        change = torch.zeros_like(p)
        change[i] = h
        slope[:, i] = (values(p + change) - values(p - change)) / (2 * h)
    spread = slope @ covariance.numpy() @ slope.T
    return {n: float(np.sqrt(max(v, 0.0))) for n, v in zip(names, np.diag(spread), strict=True)}
