"""PSFs by how a sample is lit and detected: confocal, spinning disk, light sheet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi

import torch
from torch import Tensor

from ..errors import InputError
from .bessel import j0, jinc
from .objective import WAVELENGTHS, ObjectivePSF
from .otf_table import FEWER_ACROSS, TAPER, Extent, RadialPSF, TablePSF, gauss_legendre, nodes_for
from .parameters import Spec, plain

AIRY = 0.61  # radius of the Airy disc, in wavelength / NA
_FWHM = 2.3548200450309493  # of a Gaussian, in sigma
EXCITATION = Spec("excitation", "um", "wavelength of the excitation light", 0.0, None, WAVELENGTHS)
PINHOLE = Spec(
    "pinhole", "Airy units", "diameter of the pinhole, seen in the sample", 0.0, None, (0.01, 100.0)
)
SHEET = Spec(
    "sheet", "um", "full width at half maximum of the light sheet along Z", 0.0, None, (0.1, 100.0)
)
_AXIAL_UNITS, _LATERAL_UNITS = 2.0, 5.0  # a product of two PSFs falls fast
_MARGIN = 1.5  # of the emission PSF beyond what a pinhole gathers, in pinhole radii


class ConfocalPSF(RadialPSF):
    """Excitation PSF times the emission PSF seen through a pinhole.

    T. Wilson and C. Sheppard, "Theory and Practice of Scanning Optical Microscopy", 1984.

    Parameters
    ----------
    detection
        PSF of the objective at the emitted wavelength: :class:`ScalarPSF`,
        :class:`GibsonLanniPSF` or :class:`VectorialPSF`.
    excitation
        Wavelength of the excitation, um.
    pinhole
        Diameter in Airy units, ``1.22 wavelength / NA``.
    disk
        Whether the excitation passes the pinhole too, as in a spinning disk. Light that reaches
        neighbouring pinholes is not part of the model.
    fitted
        Names of the parameters to fit; those of the objective are shared.
    extent
        um along Z and across: the PSF is kept this far and falls to zero over as far again.

    Raises
    ------
    InputError
        If the pinhole is not positive, or a wavelength is in another unit.
    """

    def __init__(
        self,
        detection: ObjectivePSF,
        excitation: float | Tensor,
        pinhole: float | Tensor = 1.0,
        *,
        disk: bool = False,
        fitted: Sequence[str] = ("na",),
        extent: Extent | None = None,
    ) -> None:
        if not isinstance(detection, ObjectivePSF):
            raise InputError("a confocal PSF is made of one of the objective, symmetric about Z")
        if not plain(pinhole) > 0:
            raise InputError(f"the pinhole must be larger than 0 Airy units, not {plain(pinhole)}")
        self._detection = detection._moving(fitted)
        self._disk = disk
        own = {"excitation": excitation, "pinhole": pinhole}
        super().__init__(
            (*detection._specs, EXCITATION, PINHOLE), {**detection.values, **own}, fitted, extent
        )

    def _adopt(self, values: Mapping[str, Tensor]) -> None:
        nodes = self._detection._r
        self._detection = self._detection._with_values(values)
        self._outgrown = self._detection._r is not nodes

    def _pinhole_radius(self) -> Tensor:
        """Return the radius of the pinhole in the sample, um."""
        v = self._values
        return v["pinhole"] * AIRY * v["wavelength"] / v["na"]

    def _excitation(self) -> ObjectivePSF:
        return self._detection.with_wavelength(self._values["excitation"])

    def _bandwidth(self) -> tuple[float, float, float]:
        """Return the bandwidth of the intensity, rad/um along Z, Y, X."""
        emitted, exciting = self._detection._bandwidth(), self._excitation()._bandwidth()
        z, y, x = (a + b for a, b in zip(emitted, exciting, strict=True))
        return z, y, x

    def _default_extent(self) -> Extent:
        kz, _, kr = self._detection._bandwidth()
        along, across = self._detection._ray_spread()
        return _AXIAL_UNITS * 2 * pi / kz + along, _LATERAL_UNITS * 2 * pi / kr + across

    def _place_nodes(self) -> None:
        super()._place_nodes()
        self._outgrown = False
        z, r = (1 + TAPER) * self._flat[0], (1 + TAPER) * self._flat[1]
        # The emission that a pinhole collects, and a margin over which it falls to zero.
        gathered = (r + float(self._pinhole_radius().detach()) * _MARGIN, z)
        self._detection = self._detection.with_extent((gathered[1], gathered[0]))
        q = self._detection._resolved[1]
        phase = q * (r + (1 + TAPER) * gathered[0])
        self._q, q_weight = gauss_legendre(0.0, q, nodes_for(FEWER_ACROSS * phase))
        inner = self._detection._r
        self._inverse = (q_weight * self._q / (2 * pi))[:, None] * j0(self._q[:, None] * self._r)
        self._forward = (
            j0(inner[:, None] * self._q) * (2 * pi * inner * self._detection._line_weight)[:, None]
        )

    def _through_pinhole(self, psf: ObjectivePSF, z: Tensor) -> Tensor:
        """Return (Nz, Nr) the intensity collected by a pinhole centred at each radius."""
        spectrum = psf.intensity_at(z, self._detection._r) @ self._forward
        return (spectrum * jinc(self._q * self._pinhole_radius())) @ self._inverse

    def intensity_at(self, z: Tensor, r: Tensor) -> Tensor:
        """Return (Nz, Nr) intensity at focus positions ``z``; ``r`` are the nodes of this PSF."""
        emitted = self._through_pinhole(self._detection, z)
        exciting = self._excitation()
        if self._disk:
            return emitted * self._through_pinhole(exciting, z)
        return emitted * exciting.intensity_at(z, r)


class LightSheetPSF(TablePSF):
    """PSF of the detection times a Gaussian light sheet across Z.

    For a Gaussian detection, ``1 / sigma_z^2 = 1 / sigma_detection^2 + 1 / sigma_sheet^2``.

    Parameters
    ----------
    detection
        PSF of the detection objective, at the emitted wavelength.
    sheet
        Full width at half maximum of the sheet, um.
    fitted
        Names of the parameters that a fit moves.
    """

    def __init__(
        self,
        detection: TablePSF,
        sheet: float | Tensor,
        *,
        fitted: Sequence[str] = ("na",),
    ) -> None:
        if not isinstance(detection, TablePSF):
            raise InputError("a light sheet PSF is made of the PSF of an objective")
        if not plain(sheet) > 0:
            raise InputError(f"the light sheet must be thicker than 0 um, not {plain(sheet)}")
        self._detection = detection._moving(fitted)
        super().__init__(
            (*detection._specs, SHEET), {**detection.values, "sheet": sheet}, fitted, None
        )

    def _adopt(self, values: Mapping[str, Tensor]) -> None:
        planes = self._detection._known
        self._detection = self._detection._with_values(values)
        self._outgrown = self._detection._known is not planes

    def _bandwidth(self) -> tuple[float, float, float]:
        """Return the bandwidth of the intensity, rad/um along Z, Y, X."""
        z, y, x = self._detection._bandwidth()
        return z + 5 * _FWHM / self._number("sheet"), y, x

    def _default_extent(self) -> Extent:
        z, r = self._detection._flat
        return min(z, 3 / _FWHM * self._number("sheet")), r

    def _place_nodes(self) -> None:
        self._outgrown = False  # the nodes are those of the detection

    def _intensity(self, z: Tensor) -> Tensor:
        planes = self._detection._intensity(z)
        light = torch.exp(-0.5 * (z * _FWHM / self._values["sheet"]) ** 2)
        return planes * light.reshape(-1, *[1] * (planes.ndim - 1))

    def _lateral(self, planes: Tensor, ky: Tensor, kx: Tensor) -> Tensor:
        return self._detection._lateral(planes, ky, kx)

    def _on_plane(self, across: Tensor, ky: Tensor, kx: Tensor) -> Tensor:
        return self._detection._on_plane(across, ky, kx)

    def _totals(self, planes: Tensor) -> Tensor:
        return self._detection._totals(planes)

    def _sections(self, plane: Tensor) -> tuple[float, float]:
        return self._detection._sections(plane)
