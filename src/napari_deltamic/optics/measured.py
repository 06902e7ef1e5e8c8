"""A PSF measured from the image of a bead."""

from __future__ import annotations

from math import pi
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from torch import Tensor

from ..common.choices import Bead
from ..common.normal import SIGMA_PER_MEDIAN_DEVIATION
from ..errors import InputError
from .otf_table import l2_width
from .parameters import Spec, check_unit
from .parametric_psf import Axes, ParametricPSF

_LEAST_VOXELS = 5
_BORDER = 0.25  # of the peak: brighter at the border, and the stack does not hold the PSF
_TAPER_SHARE = 0.15  # of the half size, at every edge
_ABOVE_NOISE = 4.0  # standard deviations: what counts as signal
_SAFE = 0.3  # transform of the bead, relative to its volume: division by less would amplify noise
_VOXELS, _DIAMETERS = (1e-3, 10.0), (1e-3, 20.0)  # um, of stacks and beads that show a PSF
_SATURATED = 4  # voxels that share the highest value


class MeasuredPSF(ParametricPSF):
    """A PSF measured from the image of a bead.

    The background is subtracted, the bead is centred to a fraction of a voxel, the edges are
    tapered and the sum is made 1. The OTF is the transform of the samples, cut off where it drowns
    in noise; its values at any grid's wavevectors are those of the band-limited image, which
    resamples it. If a diameter is given, the OTF is divided by the transform of the bead where that
    is large enough.

    Parameters
    ----------
    image
        (Z, Y, X) stack of one bead, near its middle.
    voxel_size
        um, Z, Y, X.
    bead_diameter
        um; 0 for a bead much smaller than the PSF.
    bead
        ``"solid"``, or ``"shell"`` for a bead that is stained on its surface.

    Raises
    ------
    InputError
        If the stack is not 3D, holds NaN, is saturated, constant, or smaller than its PSF, or the
        bead lies off-centre.
    """

    def __init__(
        self,
        image: NDArray,
        voxel_size: tuple[float, float, float],
        bead_diameter: float = 0.0,
        bead: Bead = "solid",
    ) -> None:
        super().__init__((), {}, ())
        pixels = checked_stack(image)
        size = checked_sizes(voxel_size, bead_diameter)
        if bead not in ("solid", "shell"):
            raise InputError(f"a bead is 'solid' or 'shell', not {bead!r}")
        self.voxel_size = (float(size[0]), float(size[1]), float(size[2]))
        self.bead_diameter, self.bead = float(bead_diameter), bead
        held, noise = _prepared(pixels)
        self._held = torch.from_numpy(held / held.sum())
        self._centre = _centroid(held)
        self._noise = float(noise * np.sqrt((held != 0).sum()) / held.sum())
        self._support = self._seen()

    @property
    def size(self) -> tuple[int, int, int]:
        """Number of voxels (Z, Y, X) of the part of the stack that holds the PSF."""
        z, y, x = self._held.shape
        return z, y, x

    def _with_values(self, values: object) -> Self:
        return self  # it has no parameters that could change

    def _positions(self, axis: int) -> Tensor:
        n = self._held.shape[axis]
        return (torch.arange(n, dtype=torch.float64) - self._centre[axis]) * self.voxel_size[axis]

    def _transform(self, axes: tuple[Tensor, Tensor, Tensor]) -> Tensor:
        """Return the transform of the prepared stack at 1D wavevector components."""
        found = self._held.to(torch.complex128)
        for axis in (2, 1, 0):
            wave = torch.exp(-1j * self._positions(axis)[:, None] * axes[axis])
            found = torch.movedim(torch.tensordot(found, wave, dims=([axis], [0])), -1, axis)
        return found

    def _seen(self) -> tuple[float, float, float]:
        """Return where the OTF sinks into the noise, rad/um along each axis."""
        found = []
        for axis, d in enumerate(self.voxel_size):
            k = torch.linspace(0, pi / d, 129, dtype=torch.float64)
            line = [torch.zeros(1, dtype=torch.float64) for _ in range(3)]
            line[axis] = k
            above = self._transform((line[0], line[1], line[2])).abs().reshape(-1)
            # Off the axis, too: a widefield OTF is zero along Z right above the origin.
            for other in range(3):
                if other != axis:
                    for share in (0.15, 0.3):
                        line[other] = torch.full((1,), share * pi / self.voxel_size[other]).double()
                        tilted = self._transform((line[0], line[1], line[2])).abs().reshape(-1)
                        above = torch.maximum(above, tilted)
                    line[other] = torch.zeros(1, dtype=torch.float64)
            seen = torch.nonzero(above > _ABOVE_NOISE * max(self._noise, 1e-6))[:, 0]
            found.append(float(k[int(seen[-1])]) if len(seen) > 1 else float(k[8]))
        z, y, x = found
        return z, y, x

    def _otf(self, axes: Axes) -> Tensor:
        z, y, x = (a.reshape(-1).to(torch.float64) for a in axes)
        otf = self._transform((z, y, x))
        inside = torch.zeros((), dtype=torch.float64)
        squared = torch.zeros((), dtype=torch.float64)
        shapes = ((-1, 1, 1), (1, -1, 1), (1, 1, -1))
        for k, shape, end, d in zip((z, y, x), shapes, self._support, self.voxel_size, strict=True):
            component = k.reshape(shape)
            inside = inside + (component / end) ** 2
            squared = squared + component**2
            # Beyond the wavenumbers of its voxels the transform repeats itself.
            otf = otf * (component.abs() <= pi / d)
        # Each axis ends where the noise begins: over the last tenth, smoothly.
        u = ((torch.sqrt(inside) - 1.0) / 0.1).clamp(0, 1)
        otf = otf * torch.cos(u * (pi / 2)) ** 2
        if self.bead_diameter > 0:
            b = bead_transform(torch.sqrt(squared) * (self.bead_diameter / 2), self.bead)
            otf = otf * (b / torch.clamp(b * b, min=_SAFE**2))
        return otf.to(torch.complex64) if axes[0].dtype == torch.float32 else otf

    def support(self) -> tuple[float, float, float]:
        """Return wavenumbers (rad/um) along Z, Y, X beyond which the OTF is zero."""
        z, y, x = (
            min(1.1 * k, pi / d) for k, d in zip(self._support, self.voxel_size, strict=True)
        )
        return z, y, x

    @property
    def extent(self) -> tuple[float, float, float]:
        """Distances (um) along Z, Y, X beyond which the PSF is zero."""
        z, y, x = (
            max(c, n - 1 - c) * d
            for c, n, d in zip(self._centre, self._held.shape, self.voxel_size, strict=True)
        )
        return z, y, x

    def _widths(self) -> tuple[float, float, float]:
        found = []
        middle = tuple(round(c) for c in self._centre)
        for axis, d in enumerate(self.voxel_size):
            where: list[int | slice] = list(middle)
            where[axis] = slice(None)
            line = self._held[tuple(where)].clamp(min=0)
            found.append(l2_width(line, torch.full_like(line, d)))
        z, y, x = found
        return z, y, x

    def __repr__(self) -> str:
        z, y, x = self.sigma_um
        return f"MeasuredPSF(size={self.size}, sigma=({z:.4g}, {y:.4g}, {x:.4g}) um)"


def bead_transform(q: Tensor, bead: Bead, core: float = 0.0) -> Tensor:
    """Return the transform of a bead of unit mass; q : length of the wavevector times the radius.

    core : diameter of an unstained core of a solid bead, relative to the bead's.
    """
    if bead == "shell":
        return torch.sinc(q / pi)
    if core > 0:
        return (_ball(q) - core**3 * _ball(core * q)) / (1 - core**3)
    return _ball(q)


def _ball(q: Tensor) -> Tensor:
    small = q < 0.05
    safe = torch.where(small, torch.ones_like(q), q)
    ball = 3 * (torch.sin(safe) - safe * torch.cos(safe)) / safe**3
    return torch.where(small, 1 - q * q / 10, ball)


# ------------------------------------------------------------------------------------ preparing


def checked_sizes(
    voxel_size: tuple[float, float, float], bead_diameter: float
) -> NDArray[np.float64]:
    """Return the voxel size (3,), um. InputError if it or the diameter is wrong or not in um."""
    size = np.asarray(voxel_size, float)
    if size.shape != (3,) or not (np.isfinite(size).all() and (size > 0).all()):
        raise InputError(f"voxel size must be three positive numbers (um), not {voxel_size}")
    for axis, d in zip("ZYX", size, strict=True):
        check_unit(Spec(f"voxel size along {axis}", "um", "", typical=_VOXELS), float(d))
    if not 0 <= bead_diameter < np.inf:
        raise InputError(f"the diameter of a bead must be 0 um or more, not {bead_diameter}")
    if bead_diameter > 0:
        check_unit(Spec("diameter of the bead", "um", "", typical=_DIAMETERS), bead_diameter)
    return size


def checked_stack(image: NDArray) -> NDArray[np.float64]:
    """Return the stack of a bead as float64. InputError if it cannot be one."""
    pixels = np.asarray(image)
    if pixels.ndim != 3:
        raise InputError(f"a PSF is a 3D stack (Z, Y, X), not one of {pixels.ndim} dimensions")
    if min(pixels.shape) < _LEAST_VOXELS:
        raise InputError(
            f"a PSF of {pixels.shape} voxels is too small: {_LEAST_VOXELS} along each axis at least"
        )
    wrong = int((~np.isfinite(pixels)).sum())
    if wrong:
        raise InputError(f"the PSF holds {wrong} voxels that are NaN or infinite")
    high = pixels.max()
    if high == pixels.min():
        raise InputError(f"the PSF is flat: every voxel is {high:g}")
    top = int((pixels == high).sum())
    if top >= _SATURATED:
        raise InputError(
            f"the PSF is saturated: {top} voxels have the highest value, {high:g}; "
            "take it with less light"
        )
    return pixels.astype(np.float64)


def _prepared(pixels: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return the stack around the bead, tapered and without background, and its voxels' noise."""
    rim = np.zeros(pixels.shape, bool)
    for axis, n in enumerate(pixels.shape):
        # Far from the focus the light of a bead fills the planes; only far to the side it is dark.
        width = max(1, n // 12)
        if axis > 0:
            rim.swapaxes(0, axis)[:width] = rim.swapaxes(0, axis)[-width:] = True
    dark = float(np.median(pixels[rim]))
    noise = SIGMA_PER_MEDIAN_DEVIATION * float(np.median(np.abs(pixels[rim] - dark)))
    signal = pixels - dark
    smooth = gaussian_filter(signal, 0.7)
    peak = np.unravel_index(int(smooth.argmax()), smooth.shape)
    top = float(smooth[peak])
    half = [min(int(p), n - 1 - int(p)) for p, n in zip(peak, pixels.shape, strict=True)]
    for axis, (h, n) in enumerate(zip(half, pixels.shape, strict=True)):
        name = "ZYX"[axis]
        if h < max(2, n // 5):
            raise InputError(
                f"the bead lies off-centre along {name}: {h} of {n} voxels from the border; "
                "cut the stack so that it lies in the middle"
            )
        ends = np.take(smooth, [0, n - 1], axis)
        if float(ends.max()) > _BORDER * top:
            raise InputError(
                f"the stack is smaller than its PSF: at the border along {name} the light is still "
                f"{float(ends.max()) / top:.0%} of the peak"
            )
    half = _cropped(smooth, peak, half, noise)
    cut = tuple(slice(int(p) - h, int(p) + h + 1) for p, h in zip(peak, half, strict=True))
    held = signal[cut].copy()
    for axis, h in enumerate(half):
        u = ((np.abs(np.arange(-h, h + 1)) / (h + 0.5) - (1 - _TAPER_SHARE)) / _TAPER_SHARE).clip(0)
        shape = [1, 1, 1]
        shape[axis] = -1
        held *= (np.cos(u * pi / 2) ** 2).reshape(shape)
    return held, noise


def _cropped(smooth: NDArray[np.float64], peak: tuple, half: list[int], noise: float) -> list[int]:
    """Return half sizes that hold everything above the noise, and the taper."""
    wide = gaussian_filter(smooth, 1.5)
    # Noise of voxels smoothed twice, by Gaussians of 0.7 and 1.5 voxels.
    level = max(5 * noise / (8 * pi**1.5 * (0.7**2 + 1.5**2) ** 1.5) ** 0.5, 1e-3 * wide.max())
    found = []
    for axis, h in enumerate(half):
        others = tuple(a for a in range(3) if a != axis)
        seen = np.flatnonzero(wide.max(others) > level)
        far = max(int(np.abs(seen - peak[axis]).max()), 2)
        found.append(min(h, int(np.ceil(far / (1 - _TAPER_SHARE))) + 1))
    return found


def _centroid(held: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return the centroid of the bright core, above 0.4 of the peak, smoothly weighted."""
    smooth = gaussian_filter(held, 0.7)
    weight = (smooth - 0.4 * smooth.max()).clip(0)
    grid = np.indices(held.shape)
    z, y, x = (float((weight * g).sum() / weight.sum()) for g in grid)
    return z, y, x
