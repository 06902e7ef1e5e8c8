"""Kernels that spread points on a grid, and the error that their aliases leave in an image.

A kernel of width W (nodes) is the generalised Kaiser-Bessel window of order 2 (R. M. Lewitt,
"Multidimensional digital image representations using generalized Kaiser-Bessel window functions",
J. Opt. Soc. Am. A 7, 1990), ``z^2 I_2(beta z) / I_2(beta)`` with ``z^2 = 1 - (2x/W)^2``. It falls
to zero at its edge with its derivative, so that neither an image nor its gradient jumps where a
point crosses a line of the grid. Against the window of order 0 that costs a factor of 1.5 to 2 in
error.

Computations use not the window itself but a polynomial on each of the W intervals between nodes,
which keeps its value and slope at the nodes, and the derivative of that very polynomial. Results
are divided by the polynomials' own transform, not by that of the window.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import pi

import numpy as np
from numpy.polynomial import chebyshev, polynomial
from scipy.special import iv

WIDEST = 16  # nodes; csrc/particle_mesh.h has the same
_HIGHEST = 20  # degree of a polynomial
_ALIASES = np.array([1, -1, 2, -2, 3, -3])  # later ones fall as the third power
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(20)  # on an interval: exact to 3.5 cycles
_NO_KERNEL = 1e300  # square of the error where a kernel's transform vanishes within the band
# Values of beta that are tried, over ``pi W (1 - 1 / 2s)``, with s the wavenumber of the grid over
# that of the band. The best one falls from 1.07, for an OTF that has decayed at the edge of the
# band, to 0.6 for a flat one.
_SHAPES = np.array([0.6, 0.7, 0.8, 0.88, 0.95, 1.0, 1.07])


@dataclass(frozen=True, eq=False)
class AxisWeights:
    """The power along an axis of wavevectors, in several kinds of scenes.

    Attributes
    ----------
    index
        (n,) from 0 to the edge of the band.
    power
        (kinds, n) shares of the power at each.
    slope
        (kinds,) 0 for an image. For a gradient, in which an alias weighs more by the factor by
        which its wavevector is longer: 1 over the root mean square of all wavevectors, in steps of
        the index.
    """

    index: np.ndarray
    power: np.ndarray
    slope: np.ndarray


@dataclass(frozen=True, eq=False)
class Kernel:
    """Polynomials (degree + 1, width) in ``t = 2 f - 1``, highest power first.

    The l-th gives the value at the l-th node from the kernel's lower edge on; f in 0..1 is the
    distance of the first node from that edge.
    """

    coefficients: np.ndarray

    @property
    def width(self) -> int:
        """Number of nodes along an axis that a point is spread over."""
        return int(self.coefficients.shape[1])

    @cached_property
    def _at_nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Places relative to the centre, and values times weights, to integrate over the kernel."""
        values = polynomial.polyval(_NODES, self.coefficients[::-1])
        middle = np.arange(self.width) + 0.5 - self.width / 2
        places = middle[:, None] + _NODES / 2
        return places.ravel(), (values * _NODE_WEIGHTS / 2).ravel()

    def transform(self, cycles: np.ndarray) -> np.ndarray:
        """Return its Fourier transform at wavenumbers in cycles per node."""
        places, values = self._at_nodes
        return np.cos(2 * pi * np.multiply.outer(cycles, places)) @ values


def fitted(width: int, beta: float, degree: int) -> Kernel:
    """Fit polynomials (degree 3 or more) that keep the window's value and slope at the nodes."""

    def window(x: np.ndarray) -> np.ndarray:
        z = np.sqrt(np.maximum(1 - (2 * x / width) ** 2, 0.0))
        return np.asarray(z**2 * iv(2, beta * z) / iv(2, beta))

    def slope(x: np.ndarray) -> np.ndarray:
        # d/dz of z^2 I_2(beta z) is beta z^2 I_1(beta z), and dz/dx = -4 x / (W^2 z).
        z = np.sqrt(np.maximum(1 - (2 * x / width) ** 2, 0.0))
        return np.asarray(-4 * x / width**2 * beta * z * iv(1, beta * z) / iv(2, beta))

    left = np.arange(width) - width / 2
    hermite = np.array([[2, 1, -2, 1], [-3, -2, 3, -1], [0, 1, 0, 0], [1, 0, 0, 0]], float)
    ends = np.stack([window(left), slope(left), window(left + 1), slope(left + 1)])
    in_f = (hermite @ ends)[::-1]  # powers of f, lowest first
    cubic = _in_t(in_f)
    if degree < 4:
        return Kernel(cubic[::-1].copy())
    # The rest vanishes at both ends with its slope: it is (1 - t^2)^2 times a polynomial.
    n = degree - 3
    t = chebyshev.chebpts1(n)
    left_over = window(left[:, None] + (t + 1) / 2).T - polynomial.polyval(t, cubic).T
    rest = chebyshev.chebfit(t, left_over / ((1 - t**2) ** 2)[:, None], n - 1)
    found = _raised(n) @ rest
    found[:4] += cubic
    return Kernel(found[::-1].copy())


def _raised(n: int) -> np.ndarray:
    """Return (n + 4, n) coefficients in t of ``(1 - t^2)^2 T_k(t)``, lowest first, for k < n.

    One column for each Chebyshev polynomial, not for a sum of them: NumPy drops leading zeros of a
    sum, which depend on rounding, so that lengths would differ between processors.
    """
    bump = np.array([1.0, 0, -2, 0, 1])
    columns = np.zeros((n + 4, n))
    for k in range(n):
        columns[: k + 5, k] = polynomial.polymul(bump, chebyshev.cheb2poly(np.eye(n)[k]))
    return columns


def _in_t(powers_of_f: np.ndarray) -> np.ndarray:
    """Convert (4, width) cubics of f to powers of ``t = 2 f - 1``, both lowest first (Horner)."""
    total = np.zeros_like(powers_of_f)
    for c in powers_of_f[::-1]:
        total = total / 2
        total[1:] += total[:-1].copy()
        total[0] += c
    return total


def window_transform(cycles: np.ndarray, width: int, beta: np.ndarray | float) -> np.ndarray:
    """Window's transform up to a factor: ``i_2(y) / y^2``, ``y^2 = beta^2 - (pi W k)^2``."""
    squared = np.asarray(beta) ** 2 - (pi * width * cycles) ** 2
    y = np.sqrt(np.abs(squared))
    safe = np.maximum(y, 0.3)
    grows = ((safe**2 + 3) * np.sinh(safe) - 3 * safe * np.cosh(safe)) / safe**5
    waves = ((3 - safe**2) * np.sin(safe) - 3 * safe * np.cos(safe)) / safe**5
    # Near zero the terms cancel, so a series is used.
    series = 1 / 15 + squared / 210 + squared**2 / 7560
    return np.where(y < 0.3, series, np.where(squared > 0, grows, waves))


def alias_error(
    transform: Callable[[np.ndarray], np.ndarray], nodes: int, weights: AxisWeights
) -> np.ndarray:
    """Return the relative L2 error from aliases along one axis, in the worst kind of scene.

    At each wavevector of the band the grid also holds those that lie multiples of its ``nodes``
    beyond, times the ratio of the kernel's transforms there and here; the OTF then weighs them as
    it weighs the wavevector itself.

    Parameters
    ----------
    transform
        Of the kernel, at cycles per node; may have further axes in front, which the result has too.
    nodes
        Number of nodes of the grid along the axis.
    """
    here = transform(weights.index / nodes)
    places = weights.index + nodes * _ALIASES[:, None]
    ratio = (transform(places / nodes) / here[..., None, :]) ** 2
    summed = ratio.sum(-2)[..., None, :]
    if weights.slope.any():
        steep = (ratio * places**2).sum(-2)[..., None, :]
        slope = weights.slope[:, None]
        summed = np.where(slope > 0, slope**2 * steep, summed)
    summed = np.nan_to_num(summed, nan=_NO_KERNEL, posinf=_NO_KERNEL)
    return np.asarray(np.sqrt((summed * weights.power).sum(-1)).max(-1))


def rounding_error(
    transform: Callable[[np.ndarray], np.ndarray], nodes: int, weights: AxisWeights, unit: float
) -> np.ndarray:
    """Return the relative L2 error from rounding on the grid, if all three axes are alike.

    For the first kind of scene. Rounding is as strong at the edge of the band as in its middle,
    where the kernel's transform, the divisor, may be thousands of times larger.
    """
    here = transform(weights.index / nodes) ** 2
    grown = ((1 / here) @ weights.power[0]) * here.mean(-1)
    return np.asarray(unit * grown**1.5)


def beta_for(
    width: int, nodes: int, weights: AxisWeights, error: float, unit: float
) -> float | None:
    """Return beta of the best kernel of this width; None if its error is above ``error``.

    ``unit`` is the rounding error of a single number.
    """
    bandwidth = 1 - weights.index.max() / nodes  # to the first alias, in nodes: 1 - 1 / 2s
    betas = _SHAPES * pi * width * bandwidth

    def transform(k: np.ndarray) -> np.ndarray:
        return window_transform(k, width, betas.reshape((-1,) + (1,) * k.ndim))

    worst = alias_error(transform, nodes, weights)
    if worst.min() <= error:
        worst = np.maximum(worst, rounding_error(transform, nodes, weights, unit))
    best = int(np.argmin(worst))
    return float(betas[best]) if worst[best] <= error else None


def polynomials_for(
    width: int, beta: float, nodes: int, weights: AxisWeights, error: float
) -> Kernel:
    """Return polynomials of the lowest degree that keep to ``error``, including aliases."""
    best: tuple[float, Kernel] | None = None
    for degree in range(3, _HIGHEST + 1):
        kernel = fitted(width, beta, degree)
        found = float(alias_error(kernel.transform, nodes, weights))
        if found <= error:
            return kernel
        if best is None or found < best[0]:
            best = found, kernel
    assert best is not None
    return best[1]


@lru_cache(maxsize=256)
def kernel_for(width: int, beta: float, nodes: int, key: bytes, error: float) -> Kernel:
    """Cached :func:`polynomials_for`; ``key`` comes from :func:`packed`."""
    return polynomials_for(width, beta, nodes, unpacked(key), error)


def packed(weights: AxisWeights) -> bytes:
    """Convert weights to a key, rounded so that a mesh that moves a little finds what was kept."""
    rows = np.vstack([weights.index, weights.power])
    slope = np.concatenate([[0.0], weights.slope])
    return np.column_stack([rows, slope]).astype(np.float32).tobytes() + bytes([len(rows)])


def unpacked(key: bytes) -> AxisWeights:
    """Convert a key of :func:`packed` back to weights."""
    rows = np.frombuffer(key[:-1], np.float32).astype(np.float64).reshape(key[-1], -1)
    return AxisWeights(rows[0, :-1], rows[1:, :-1], rows[1:, -1])
