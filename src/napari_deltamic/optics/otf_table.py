"""PSFs computed in space, on planes around the focus, and transformed to an OTF.

The intensity is band-limited, so that few samples suffice: planes evenly spaced along Z, and
Gauss-Legendre nodes along the radius. It is kept within an extent of the focus and falls smoothly
to zero beyond: the light of a widefield PSF is the same in every plane, so that its total would be
infinite otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from math import ceil, pi, sqrt
from typing import NamedTuple, Self

import numpy as np
import torch
from scipy.special import roots_legendre
from torch import Tensor

from ..common.kept import Kept
from ..errors import InputError
from .bessel import j0
from .parameters import Spec
from .parametric_psf import Axes, ParametricPSF

Extent = tuple[float, float]
# In extents: over this distance beyond the extent the PSF falls to zero. A shorter one would have
# side lobes that pass the band.
TAPER = 1.0
_LEAK = 6.3  # rad: where the transform of a window of extent 1 has fallen to a thousandth
_DENSER = 1.25  # than the Nyquist rate: planes and nodes
# Share of the nodes that a wave over the whole extent needs: at its end, the window is near zero.
# Measured (NA 1.2, up to 3 rad of aberration or 80 um deep): with 0.7 across, OTFs change by less
# than 1e-8, with 0.5 by 5e-8; with 0.6 over the pupil by 1e-13, with 0.4 by 1e-10, 0.25 by 1e-2.
FEWER_ACROSS, FEWER_IN_PUPIL = 0.7, 0.6
_GROWTH = 1.25  # of the support that a fit may ask for


def window(distance: Tensor, extent: float) -> Tensor:
    """Return 1 up to the extent, and from there smoothly down to 0."""
    u = ((distance / extent - 1) / TAPER).clamp(0, 1)
    return torch.cos(u * (pi / 2)) ** 2


def gauss_legendre(low: float, high: float, count: int) -> tuple[Tensor, Tensor]:
    """Return Gauss-Legendre nodes and weights (count,) on an interval."""
    nodes, weights = _legendre(count)
    half = (high - low) / 2
    return torch.from_numpy(nodes * half + (low + high) / 2), torch.from_numpy(weights * half)


@lru_cache(64)
def _legendre(count: int) -> tuple[np.ndarray, np.ndarray]:
    nodes, weights = roots_legendre(count)
    return nodes, weights


def nodes_for(phase: float) -> int:
    """Return the number of nodes for an integrand whose phase runs over so many rad."""
    return ceil(0.5 * phase) + 14


class TablePSF(ParametricPSF):
    """A PSF given by its intensity on planes.

    Subclasses give the intensity (:meth:`_intensity`) and the transform across the axis
    (:meth:`_lateral`), in a compact form that :meth:`_on_plane` expands.
    """

    def __init__(
        self,
        specs: Sequence[Spec],
        values: Mapping[str, object],
        fitted: Sequence[str],
        extent: Extent | None,
    ) -> None:
        super().__init__(specs, values, fitted)
        with torch.no_grad():
            z, r = self._default_extent() if extent is None else extent
            if not (z > 0 and r > 0):
                raise InputError(f"the extent of a PSF must be positive (um), not {(z, r)}")
            self._keep_within((float(z), float(r)))

    def _keep_within(self, extent: Extent) -> None:
        self._flat: Extent = extent
        kz, _, kr = self._needed()
        self._resolved = (_GROWTH * kz, _GROWTH * kr)
        self._place_planes()
        self._place_nodes()

    # ------------------------------------------------------------------------- for subclasses

    def _default_extent(self) -> Extent:
        raise NotImplementedError

    def _place_nodes(self) -> None:
        """Choose the nodes across the axis."""
        raise NotImplementedError

    _outgrown = False  # whether a PSF that this one is made of has other nodes by now

    def _intensity(self, z: Tensor) -> Tensor:
        """Return (Nz, ...) intensity on the planes ``z``, at the nodes across the axis."""
        raise NotImplementedError

    def _lateral(self, planes: Tensor, ky: Tensor, kx: Tensor) -> Tensor:
        """Return (Nz, M) the compact transform of (windowed) planes, exact where resolved."""
        raise NotImplementedError

    def _on_plane(self, across: Tensor, ky: Tensor, kx: Tensor) -> Tensor:
        """Expand N rows of :meth:`_lateral` to (N, Ky, Kx); linear."""
        raise NotImplementedError

    def _totals(self, planes: Tensor) -> Tensor:
        """Return (Nz,) the integral of each plane."""
        raise NotImplementedError

    def _sections(self, plane: Tensor) -> tuple[float, float]:
        """Return L2 widths along Y and X through the middle of a plane."""
        raise NotImplementedError

    def _bandwidth(self) -> tuple[float, float, float]:
        """Return the bandwidth of the intensity without its window, rad/um along Z, Y, X."""
        raise NotImplementedError

    # ------------------------------------------------------------------------------ in common

    def _place_planes(self) -> None:
        total = (1 + TAPER) * self._flat[0]
        step = pi / (_DENSER * self._resolved[0])
        half = ceil(total / step)
        self._z = torch.arange(-half, half + 1, dtype=torch.float64) * (total / half)
        self._z_weight = window(self._z.abs(), self._flat[0]) * (total / half)
        self._known: Kept[Tensor] = Kept(3)  # planes by values, also of PSFs made of this one

    def _with_values(self, values: Mapping[str, Tensor]) -> Self:
        other = super()._with_values(values)
        with torch.no_grad():
            kz, _, kr = other._needed()
            if kz > other._resolved[0] or kr > other._resolved[1] or other._outgrown:
                other._resolved = (_GROWTH * kz, _GROWTH * kr)
                other._place_planes()
                other._place_nodes()
        return other

    def _needed(self) -> tuple[float, float, float]:
        """Return the bandwidth (rad/um, Z Y X) of the windowed intensity without weak lobes."""
        widths = (self._flat[0], self._flat[1], self._flat[1])
        z, y, x = (k + _LEAK / w for k, w in zip(self._bandwidth(), widths, strict=True))
        return z, y, x

    def support(self) -> tuple[float, float, float]:
        """Return wavenumbers (rad/um) along Z, Y, X beyond which the OTF is zero."""
        z, r = self._resolved
        return z, r, r

    @property
    def extent(self) -> tuple[float, float, float]:
        """Distances (um) along Z, Y, X beyond which the PSF is zero."""
        z, r = ((1 + TAPER) * e for e in self._flat)
        return z, r, r

    def _planes(self) -> Tensor:
        """Return the intensity on the planes, and keep a copy without its gradient.

        A fit needs it again at the values at which it has needed the gradient.
        """
        values = tuple(self._number(name) for name in self._values)
        if not self._differentiable():
            return self._known.get(values, lambda: self._intensity(self._z))
        planes = self._intensity(self._z)
        self._known.get(values, planes.detach)
        return planes

    def _otf(self, axes: Axes) -> Tensor:
        kz, ky, kx = (a.reshape(-1).to(torch.float64) for a in axes)
        planes = self._planes()
        across = self._lateral(planes, ky, kx)
        phase = kz[:, None] * self._z
        weight = self._z_weight * (kz.abs() <= self._resolved[0])[:, None]
        total = (self._totals(planes) * self._z_weight).sum()
        waves = ((weight * wave).to(across.dtype) for wave in (torch.cos(phase), -torch.sin(phase)))
        real, imag = (self._on_plane(wave @ across / total, ky, kx) for wave in waves)
        otf = real + 1j * imag if real.is_complex() else torch.complex(real, imag)
        single = axes[0].dtype == torch.float32
        return otf.to(torch.complex64) if single else otf

    def _widths(self) -> tuple[float, float, float]:
        planes = self._planes()
        brightest = planes.reshape(len(planes), -1).amax(1)
        weight = self._z_weight
        z = l2_width(brightest * window(self._z.abs(), self._flat[0]), weight.clamp(min=0))
        return (z, *self._sections(planes[int(brightest.argmax())]))

    def density(self, z: Tensor, y: Tensor, x: Tensor) -> Tensor:
        """Return the PSF (Nz, Ny, Nx), per um^3, at the points of a grid around the focus (um)."""
        kz, ky, kx = self.support()
        axes, weight = [], 1.0
        for k, extent in zip((kz, ky, kx), self.extent, strict=True):
            step = 2 * pi / (3 * extent)
            n = ceil(1.1 * k / step)
            axes.append(torch.arange(-n, n + 1, dtype=torch.float64) * step)
            weight *= step / (2 * pi)
        otf = self.otf((axes[0][:, None, None], axes[1][None, :, None], axes[2][None, None, :]))
        waves = [torch.exp(1j * p[:, None] * k) for p, k in zip((z, y, x), axes, strict=True)]
        found = torch.einsum("kyx,zk,by,cx->zbc", otf, *waves)
        return found.real * weight


def l2_width(profile: Tensor, weight: Tensor) -> float:
    """Sigma of the Gaussian with equal ``(integral f)^2 / integral f^2``: tails hardly count."""
    first, second = float((profile * weight).sum()), float((profile**2 * weight).sum())
    return first**2 / max(second, 1e-300) / (2 * sqrt(pi))


class RadialPSF(TablePSF):
    """A PSF that is symmetric about the Z axis."""

    def _place_nodes(self) -> None:
        reach = (1 + TAPER) * self._flat[1]
        # The nodes resolve the product of the intensity and the wave of its transform.
        count = nodes_for(FEWER_ACROSS * 2 * self._resolved[1] * reach)
        self._r, weight = gauss_legendre(0.0, reach, count)
        self._line_weight = weight * window(self._r, self._flat[1])
        self._r_weight = 2 * pi * self._r * self._line_weight

    def intensity_at(self, z: Tensor, r: Tensor) -> Tensor:
        """Return (Nz, Nr) intensity at focus positions ``z`` and axis distances ``r`` (um)."""
        raise NotImplementedError

    def _intensity(self, z: Tensor) -> Tensor:
        return self.intensity_at(z, self._r)

    def _totals(self, planes: Tensor) -> Tensor:
        return planes @ self._r_weight

    def _lateral(self, planes: Tensor, ky: Tensor, kx: Tensor) -> Tensor:
        return (planes * self._r_weight) @ self._hankel(ky, kx).to_coefficients

    def _on_plane(self, across: Tensor, ky: Tensor, kx: Tensor) -> Tensor:
        hankel = self._hankel(ky, kx)
        found = (across @ hankel.polynomials).index_select(1, hankel.where)
        return found.reshape(len(across), len(ky), len(kx))

    def _hankel(self, ky: Tensor, kx: Tensor) -> _Hankel:
        return _hankel(tuple(ky.tolist()), tuple(kx.tolist()), self._r, self._resolved[1])

    def _sections(self, plane: Tensor) -> tuple[float, float]:
        # Both halves of the line.
        width = l2_width(plane, 2 * self._line_weight)
        return width, width


class _Hankel(NamedTuple):
    """A Hankel transform of order 0, from radii r <= R to a plane of wavevectors, in two steps.

    The transform of a function within R is an entire function of k^2: it needs as many Chebyshev
    polynomials as there are half waves of J0(k R) (L. N. Trefethen, "Approximation Theory and
    Approximation Practice", 2013), far fewer than there are lengths k in a plane.

    Attributes
    ----------
    to_coefficients
        (Nr, M) from values at the nodes along r to coefficients of the polynomials.
    polynomials
        (M, N) at the distinct lengths k; 0 where they are not resolved.
    where
        (Ky * Kx,) index of the length of each wavevector.
    """

    to_coefficients: Tensor
    polynomials: Tensor
    where: Tensor


# Planes. Measured: a fit asks for seven in turn whenever it plans anew.
_hankels: Kept[_Hankel] = Kept(8)


def _hankel(ky: tuple[float, ...], kx: tuple[float, ...], r: Tensor, resolved: float) -> _Hankel:
    """Return a transform; cached by grid, so that iterations of a fit need no Bessel functions."""

    def make() -> _Hankel:
        y, x = torch.tensor(ky, dtype=torch.float64), torch.tensor(kx, dtype=torch.float64)
        squared = (y**2)[:, None] + x**2
        scale = float(squared.max()) or 1.0
        # Lengths that differ only by rounding count as one.
        rounded = torch.round(squared.reshape(-1) / scale * 1e12)
        lengths, where = torch.unique(rounded, return_inverse=True)
        k = torch.sqrt(lengths * (scale / 1e12))
        longest = min(resolved, float(k.max())) or 1.0
        degree = torch.arange(nodes_for(longest * float(r[-1])), dtype=torch.float64)
        # Chebyshev's nodes in 2 (k / longest)^2 - 1 are the cosines of these.
        angles = (degree + 0.5) * (pi / len(degree))
        at_nodes = j0(r[:, None] * (longest * torch.cos(angles / 2)))
        to_coefficients = torch.cos(angles[:, None] * degree) * (2 / len(degree))
        to_coefficients[:, 0] /= 2
        angle = 2 * torch.arccos((k / longest).clamp(max=1.0))
        polynomials = torch.cos(degree[:, None] * angle) * (k <= resolved)
        return _Hankel(at_nodes @ to_coefficients, polynomials, where)

    return _hankels.get((ky, kx, len(r), float(r[0]), float(r[-1]), resolved), make)
