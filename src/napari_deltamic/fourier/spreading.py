"""Grid and kernels that points are spread with, chosen from the OTF by summing its aliases."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, wraps
from itertools import product
from math import ceil, log2, pi, sqrt
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..common.kept import kept
from .falloff import POINT_LIKE, Falloff
from .kernel import WIDEST, AxisWeights, Kernel, beta_for, kernel_for, packed, unpacked
from .points import Points, placed
from .real_fft import RealFFT

# From components of wavevectors (rad/um) that broadcast over a box to |OTF| there.
Transfer = Callable[[tuple[Tensor, Tensor, Tensor]], Tensor]
_SAMPLES = 12  # of the OTF, along half an axis of the band
# Weight of the gradient's error, which may be three times that of the image.
_GRADIENT_SHARE = 0.35
# Margin for the sums over aliases; measured: walls one PSF apart exceed them by a hundredth.
_DIPOLES = 1.1
_UNIT = {True: 6e-8, False: 1.1e-16}  # rounding error of a number in single precision, in double
_FINEST = 2.2  # grids that are tried, times the band
# Seconds of a rendering with its gradient, in single precision on one core of 2024: for a point,
# for each row of nodes that it meets, and for a node of the grid and each doubling of their number.
POINT, ROW, NODE = 6e-8, 1.5e-9, 1.7e-10


@dataclass(frozen=True, eq=False)
class Spreading:
    """How points are spread for a band.

    Attributes
    ----------
    half, spacing
        Of the band; see :class:`napari_deltamic.fourier.Band`.
    shape
        Nodes of the grid; it has the band's period.
    kernels
        One for each axis.
    error
        Relative L2 error of an image for which it was chosen.
    """

    half: tuple[int, int, int]
    spacing: tuple[float, float, float]
    shape: tuple[int, int, int]
    kernels: tuple[Kernel, Kernel, Kernel] = field(repr=False)
    error: float

    @property
    def scale(self) -> tuple[float, float, float]:
        """Nodes per um."""
        z, y, x = (n * s / (2 * pi) for n, s in zip(self.shape, self.spacing, strict=True))
        return z, y, x

    @property
    def lanes(self) -> int:
        """Length of a row of kernel values in the compiled loops."""
        widest = max(k.width for k in self.kernels)
        return 4 if widest <= 4 else 8 if widest <= 8 else 16

    @property
    def rows(self) -> float:
        """Cost of the rows of nodes that a point is spread over; wide kernels cost more per row."""
        z, y, x = (k.width for k in self.kernels)
        return z * y * _lanes_cost(max(z, y, x))

    @cached_property
    def fft(self) -> RealFFT:
        """FFT from the grid to the band, divided by the kernels' transforms; and its adjoint."""
        z, y, x = (
            1 / kernel.transform(np.arange(k + 1) / n)
            for kernel, k, n in zip(self.kernels, self.half, self.shape, strict=True)
        )
        z, y = (np.concatenate([c[:0:-1], c]) for c in (z, y))
        # For a gradient, the inverse FFT would add the mirror images, which are no part of the box.
        once = np.where(np.arange(len(x)) == 0, x, x / 2)
        return RealFFT(self.shape, self.half, self.shape, (z, y, x), (z, y, once))

    @kept
    def scale_on(self, real: torch.dtype, device: torch.device) -> Tensor:
        """Return (3,) nodes per um, on a device."""
        return placed(np.array(self.scale), real, device)

    @kept
    def coefficients(self, real: torch.dtype, device: torch.device) -> list[Tensor]:
        """Return the coefficients of the kernels, (degree + 1, width) along each axis."""
        return [placed(k.coefficients, real, device) for k in self.kernels]

    @kept
    def joined_coefficients(self, real: torch.dtype, device: torch.device) -> Tensor:
        """Return the coefficients of the three axes, one after the other."""
        return torch.cat([c.reshape(-1) for c in self.coefficients(real, device)])


@dataclass(frozen=True, eq=False)
class Elements:
    """Triangles, segments or points, and how they are spread on a grid.

    Attributes
    ----------
    corners
        (E, 3) triangles, (E, 2) segments or (E, 1) points: vertices of each.
    points
        Rules of the elements.
    spreading
        Grid and kernels.
    single
        Whether the grid is in single precision.
    """

    corners: Tensor
    points: Points
    spreading: Spreading
    single: bool

    @property
    def real(self) -> torch.dtype:
        """Type of the grid."""
        return torch.float32 if self.single else torch.float64


def gaussian(width: Sequence[float]) -> Transfer:
    """Return the OTF of a Gaussian PSF; width : um along Z, Y, X."""

    def transfer(axes: tuple[Tensor, Tensor, Tensor]) -> Tensor:
        squared = sum((w * k) ** 2 for w, k in zip(width, axes, strict=True))
        return torch.exp(-0.5 * torch.as_tensor(squared))

    return transfer


def flat(axes: tuple[Tensor, Tensor, Tensor]) -> Tensor:
    """Return an OTF of 1 everywhere."""
    # NumPy's broadcast_shapes: that of torch loads SymPy, which takes half a second.
    return torch.ones(np.broadcast_shapes(*(a.shape for a in axes)), dtype=axes[0].dtype)


def _untraced(function: Callable[..., Spreading]) -> Callable[..., Spreading]:
    """Exclude a function from torch.compile, which cannot trace how plans are kept.

    ``torch.compiler.disable`` loads the tracer, which takes a second: done only in compiled code.
    """

    @wraps(function)
    def called(*given: Any, **named: Any) -> Spreading:
        if "torch._dynamo" not in sys.modules:
            return function(*given, **named)
        disabled: Callable[..., Spreading] = torch.compiler.disable(function)
        return disabled(*given, **named)

    return called


@_untraced
def choose_spreading(
    half: tuple[int, int, int],
    spacing: tuple[float, float, float],
    transfer: Transfer,
    error: float,
    points: int,
    single: bool,
    falloff: Falloff = POINT_LIKE,
    width: Sequence[float] = (1.0, 1.0, 1.0),
    dipoles: bool = False,
) -> Spreading:
    """Choose the cheapest grid and kernels that keep an image within ``error``.

    Parameters
    ----------
    half, spacing
        Of the band.
    transfer
        |OTF|; its aliases are summed as they are, as it need not fall towards the band's edge.
    error
        Relative L2 error of the image that aliases may cause.
    points
        Their approximate number.
    single
        Whether the grid is in single precision.
    falloff
        How the power of the structure falls, in widths of the PSF.
    width
        Of the PSF, um along Z, Y, X.
    dipoles
        Whether kernels' gradients are spread, of which ``1 / |xi|^2`` is taken (:mod:`.flux`).
    """
    # Similar Gaussians share what is kept.
    each = error / sqrt(3)
    keys = [packed(w) for w in _weights(half, spacing, transfer, falloff, width, dipoles)]
    about, unit = 2 ** ceil(log2(max(points, 1))), _UNIT[single]
    shape, chosen = _cheapest(tuple(half), tuple(keys), each, about, unit)
    kernels = [
        kernel_for(w, beta, n, key, each)
        for (w, beta), n, key in zip(chosen, shape, keys, strict=True)
    ]
    return Spreading(half, spacing, shape, (kernels[0], kernels[1], kernels[2]), error)


# --------------------------------------------------------------------------------------- the OTF


def _weights(
    half: tuple[int, int, int],
    spacing: tuple[float, float, float],
    transfer: Transfer,
    falloff: Falloff,
    width: Sequence[float],
    dipoles: bool,
) -> list[AxisWeights]:
    """Return, for each axis, the shares of the power along it, for several kinds of scenes.

    These are images of round scenes, images of walls across the axis, and the gradient; for
    dipoles, the first two once more. The power of a flat wall falls less along its normal. Power
    beyond the band is taken to be as strong as at its edge. An alias of dipoles is stronger by the
    factor by which its wavevector is longer; they have no part at zero (:mod:`.solid`).
    """
    index = [_samples(k) for k in half]
    whole = [np.concatenate([-i[:0:-1], i]) for i in index[:2]] + [index[2]]
    shapes = ((-1, 1, 1), (1, -1, 1), (1, 1, -1))
    k = [(i * s).reshape(at) for i, s, at in zip(whole, spacing, shapes, strict=True)]
    power = _power(k, transfer)
    in_widths = np.asarray(sum((w * a) ** 2 for w, a in zip(width, k, strict=True)))
    steps = [_steps(w) for w in whole]
    steps[2][1:] *= 2  # stand for their mirror images, too
    every = steps[0][:, None, None] * steps[1][:, None] * steps[2]
    volume = power * falloff.of(in_widths) * every
    volume = volume / volume.sum()
    squared = np.asarray(sum(a**2 for a in k))
    mean = sqrt(float((volume * squared).sum()))
    divided = _over(volume, squared)
    found = []
    for axis in range(3):
        others = tuple(a for a in range(3) if a != axis)
        along: list = [half_index(w) for w in whole]
        along[axis] = slice(None)
        wall = (power * falloff.of_a_wall().of(in_widths))[tuple(along)] * steps[axis]

        def folded(line: np.ndarray, axis: int = axis) -> np.ndarray:
            return _folded(line, whole[axis], index[axis])

        scene, flat_wall = folded(volume.sum(others)), folded(wall / max(wall.sum(), 1e-300))
        powers = [scene, flat_wall, scene]
        slopes = [0.0, 0.0, _GRADIENT_SHARE * spacing[axis] / mean if mean > 0 else 0.0]
        if dipoles:
            powers += [folded(divided.sum(others)), _over(flat_wall, index[axis] ** 2)]
            slopes += [_DIPOLES * spacing[axis], _DIPOLES]
        found.append(AxisWeights(index[axis], np.stack(powers), np.array(slopes)))
    return found


def _power(k: Sequence[np.ndarray], transfer: Transfer) -> np.ndarray:
    """Return |OTF|^2 at wavevector components that broadcast over a box; 1 where not known."""
    z, y, x = (torch.from_numpy(a) for a in k)
    with torch.no_grad():
        otf = transfer((z, y, x)).abs().to(torch.float64).cpu().numpy()
    while otf.ndim > 3:  # a PSF that changes with depth
        otf = otf.max(0)
    power = np.broadcast_to(otf, np.broadcast_shapes(*(a.shape for a in k))) ** 2
    return power if np.isfinite(power).all() and power.any() else np.ones_like(power)


def _over(power: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Divide, with 0 / 0 = 0."""
    return np.divide(power, by, out=np.zeros_like(power), where=by > 0)


def _samples(half: int) -> np.ndarray:
    """Return indices 0 .. half, or some of them at which the OTF is sampled."""
    if half <= _SAMPLES:
        return np.arange(half + 1, dtype=float)
    return np.linspace(0, half, _SAMPLES + 1)


def half_index(whole: np.ndarray) -> int:
    """Return the position of index zero."""
    return int(np.argmin(np.abs(whole)))


def _steps(index: np.ndarray) -> np.ndarray:
    """Return the number of wavevectors that each sample stands for, by the trapezoidal rule."""
    if len(index) == 1:
        return np.ones(1)
    gaps = np.diff(index)
    ends = np.concatenate([[0.5], gaps / 2]), np.concatenate([gaps / 2, [0.5]])
    return ends[0] + ends[1]


def _folded(line: np.ndarray, whole: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Add up values of both signs of each index."""
    total = np.zeros(len(index))
    np.add.at(total, np.searchsorted(index, np.abs(whole)), line)
    return total


# ---------------------------------------------------------------------------------------- choices


@lru_cache(maxsize=256)
def _cheapest(
    half: tuple[int, int, int], keys: tuple[bytes, ...], error: float, points: int, unit: float
) -> tuple[tuple[int, int, int], list[tuple[int, float]]]:
    """Return the cheapest grid, with width and beta of the kernel along each axis."""
    options = [_options(k, key, error, unit) for k, key in zip(half, keys, strict=True)]
    best = min(product(*options), key=lambda choice: _seconds(choice, points))
    z, y, x = (n for n, _ in best)
    return (z, y, x), [kernel for _, kernel in best]


@lru_cache(maxsize=256)
def _options(
    half: int, key: bytes, error: float, unit: float
) -> list[tuple[int, tuple[int, float]]]:
    """Return numbers of nodes, each with its narrowest kernel; finer grids only if it is narrower.

    On a grid the error falls as kernels grow wider: if one is too narrow, so are narrower ones.
    """
    weights = unpacked(key)
    found: list[tuple[int, tuple[int, float]]] = []
    n = grid_size(2 * half + 2)
    while n <= max(_FINEST * (2 * half + 1), 40) or not found:
        # Widths go up until one suffices; on finer grids, down from there.
        widths = range(found[-1][1][0] - 1, 1, -1) if found else range(2, min(WIDEST, n) + 1)
        upwards, kernel = not found, None
        for width in widths:
            beta = beta_for(width, n, weights, error, unit)
            if beta is not None:
                kernel = width, beta
            if (beta is not None) == upwards:
                break
        if kernel is not None:
            found.append((n, kernel))
        n = grid_size(n + 1)
    return found


def _seconds(choice: tuple[tuple[int, tuple[int, float]], ...], points: int) -> float:
    (nz, (wz, _)), (ny, (wy, _)), (nx, (wx, _)) = choice
    nodes = nz * ny * nx
    rows = wz * wy * _lanes_cost(max(wz, wy, wx))
    return points * (POINT + ROW * rows) + NODE * nodes * log2(nodes + 1)


def _lanes_cost(widest: int) -> float:
    """Return the cost of a row, relative to one of 8 nodes."""
    return 1.0 if widest <= 8 else 1.6


def grid_size(n: int) -> int:
    """Return the smallest even number from n on with no prime factor above 5."""
    n += n % 2
    while True:
        rest = n
        for p in (2, 3, 5):
            while rest % p == 0:
                rest //= p
        if rest == 1:
            return n
        n += 2
