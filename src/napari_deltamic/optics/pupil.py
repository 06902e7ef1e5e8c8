"""Scalar PSF of a pupil with any aberration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil, pi, sqrt

import torch
from torch import Tensor

from .objective import APODISATION, INDEX, NA, WAVELENGTH, check_aperture
from .otf_table import _DENSER, TAPER, Extent, TablePSF, gauss_legendre, l2_width, nodes_for, window
from .parameters import Spec, plain
from .zernike import NAMES, check_noll, zernike

# Units of resolution: extents that hold most of a PSF, and the largest extent across, since the
# time that a PSF takes grows with its third power.
_AXIAL_UNITS, _LATERAL_UNITS, _MOST_UNITS = 2.0, 4.0, 8.0


class PupilPSF(TablePSF):
    """Scalar PSF of a pupil with Zernike phases and apodisation.

    ``field(x, z) = integral over the pupil of cos(angle)^(-1/2) exp(-apodisation rho^2)
    exp(i (phase - k z cos(angle))) exp(i x.kappa)``, the intensity its squared modulus (B. M.
    Hanser et al., "Phase-retrieved pupil functions in wide-field fluorescence microscopy", J.
    Microsc. 216, 2004). The nodes of the integral follow the rim, so the PSF is smooth in the NA.

    Parameters
    ----------
    na, wavelength, index
        Numerical aperture; um, of the emitted light in vacuum; refractive index of the immersion.
        Numbers or tensors: the OTF is differentiable in all parameters.
    zernike
        Phases by Noll index, rad (root mean square over the pupil); from 5 on, as tilt and defocus
        are translations. They are the parameters ``z5``, ``z6``, ...
    apodisation
        0 for none.
    amplitude
        Logarithms of the amplitude by Noll index, from 5 on: the parameters ``a5``, ``a6``, ...
    fitted
        Names of the parameters to fit; by default the Zernike coefficients.
    extent
        um along Z and across: the PSF is kept this far and falls to zero over as far again.

    Raises
    ------
    InputError
        If the NA is not below the index, a value is in another unit, or a Zernike is a translation.
    """

    def __init__(
        self,
        na: float | Tensor,
        wavelength: float | Tensor,
        index: float | Tensor = 1.515,
        zernike: Mapping[int, float | Tensor] | None = None,
        apodisation: float | Tensor = 0.0,
        amplitude: Mapping[int, float | Tensor] | None = None,
        *,
        fitted: Sequence[str] | None = None,
        extent: Extent | None = None,
    ) -> None:
        check_aperture(plain(na), plain(index))
        phases = dict(sorted((zernike or {}).items()))
        logs = dict(sorted((amplitude or {}).items()))
        for noll in (*phases, *logs):
            check_noll(noll)
        self._noll, self._amplitudes = tuple(phases), tuple(logs)
        specs = [
            Spec(f"z{j}", "rad", f"Zernike phase: {NAMES.get(j, f'Noll {j}')}") for j in phases
        ] + [Spec(f"a{j}", "", f"Zernike log amplitude: {NAMES.get(j, f'Noll {j}')}") for j in logs]
        values = {"na": na, "wavelength": wavelength, "index": index, "apodisation": apodisation}
        values |= {f"z{j}": phase for j, phase in phases.items()}
        values |= {f"a{j}": log for j, log in logs.items()}
        super().__init__(
            (NA, WAVELENGTH, INDEX, APODISATION, *specs),
            values,
            tuple(s.name for s in specs) if fitted is None else fitted,
            extent,
        )

    def _bandwidth(self) -> tuple[float, float, float]:
        """Return the bandwidth of the intensity, rad/um along Z, Y, X."""
        s, n = self._number("na"), self._number("index")
        k = 2 * pi / self._number("wavelength")
        return k * (n - sqrt(n * n - s * s)), 2 * k * s, 2 * k * s

    def _phase_range(self) -> float:
        """Return about how far (rad) the aberration runs from the pupil's middle to its rim."""
        return sum(4 * abs(self._number(f"z{j}")) for j in self._noll)

    def _default_extent(self) -> Extent:
        kz, _, kr = self._bandwidth()
        s, n = self._number("na"), self._number("index")
        waves = self._phase_range() / (2 * pi)
        z = (_AXIAL_UNITS + waves) * 2 * pi / kz
        cone = z * s / sqrt(n * n - s * s)
        unit = 2 * pi / kr
        return z, min(max((_LATERAL_UNITS + waves) * unit, cone), (_MOST_UNITS + waves) * unit)

    def _place_nodes(self) -> None:
        kz, kr = self._resolved
        z, r = (1 + TAPER) * self._flat[0], (1 + TAPER) * self._flat[1]
        half = ceil(r * _DENSER * kr / pi)
        self._x = torch.arange(-half, half + 1, dtype=torch.float64) * (r / half)
        distance = torch.sqrt(self._x[:, None] ** 2 + self._x**2)
        self._area = window(distance, self._flat[1]) * (r / half) ** 2
        count = nodes_for(kr * r + kz * z / 2 + self._phase_range() + 6)
        # Columns x = sin t, and along each the points y = cos t u: the rim itself is never cut.
        t, t_weight = gauss_legendre(-pi / 2, pi / 2, count)
        u, u_weight = gauss_legendre(-1.0, 1.0, count)
        self._px = torch.sin(t)
        self._py = torch.cos(t)[:, None] * u
        weight = (torch.cos(t) ** 2 * t_weight)[:, None] * u_weight
        squared = self._px[:, None] ** 2 + self._py**2
        px = self._px[:, None].expand_as(self._py)
        used = {*self._noll, *self._amplitudes}
        self._pupil = (weight, squared, {j: zernike(j, self._py, px) for j in used})

    def _intensity(self, z: Tensor) -> Tensor:
        v = self._values
        weight, squared, polynomials = self._pupil
        k = 2 * pi / v["wavelength"]
        cosine = torch.sqrt(1 - squared * (v["na"] / v["index"]) ** 2)
        amplitude = weight * cosine**-0.5 * torch.exp(-v["apodisation"] * squared)
        phase = -(k * v["index"] * z)[:, None, None] * cosine
        for j in self._noll:
            phase = phase + v[f"z{j}"] * polynomials[j]
        for j in self._amplitudes:
            amplitude = amplitude * torch.exp(v[f"a{j}"] * polynomials[j])
        pupil = torch.polar(amplitude.expand_as(phase), phase)  # (Nz, Nx', Ny')
        kappa = k * v["na"]
        along_y = _wave(kappa * self._py[:, :, None] * self._x)  # (Nx', Ny', Ny)
        along_x = _wave(kappa * self._px[:, None] * self._x)  # (Nx', Nx)
        columns = torch.bmm(pupil.transpose(0, 1), along_y)  # (Nx', Nz, Ny)
        field = torch.tensordot(columns, along_x, dims=([0], [0]))  # (Nz, Ny, Nx)
        return field.real**2 + field.imag**2

    def _totals(self, planes: Tensor) -> Tensor:
        return (planes * self._area).sum((1, 2))

    def _lateral(self, planes: Tensor, ky: Tensor, kx: Tensor) -> Tensor:
        resolved = self._resolved[1]
        y = _wave(-self._x[:, None] * ky) * (ky.abs() <= resolved)
        x = _wave(-self._x[:, None] * kx) * (kx.abs() <= resolved)
        held = (planes * self._area).to(x.dtype)
        return torch.matmul(y.T, torch.matmul(held, x)).flatten(1)

    def _on_plane(self, across: Tensor, ky: Tensor, kx: Tensor) -> Tensor:
        return across.reshape(len(across), len(ky), len(kx))

    def _sections(self, plane: Tensor) -> tuple[float, float]:
        row, column = divmod(int(plane.argmax()), plane.shape[1])
        weight = window(self._x.abs(), self._flat[1]) * float(self._x[1] - self._x[0])
        return l2_width(plane[:, column], weight), l2_width(plane[row], weight)


def _wave(phase: Tensor) -> Tensor:
    return torch.complex(torch.cos(phase), torch.sin(phase))
