"""Radially symmetric PSFs of an objective: scalar, Gibson-Lanni, vectorial.

The field is an integral over the radius of the pupil, by Gauss-Legendre nodes in the normalised
radius, so that no edge of the pupil is ever cut by a pixel. With s = NA rho the sine of the angle
times the index, and z the position of the focus (growing away from the objective), the phase of a
ray is ``2 pi / wavelength * (path - z sqrt(index^2 - s^2))``.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, sqrt
from typing import Self

import torch
from torch import Tensor

from ..errors import InputError
from .bessel import j0, j1, j2
from .otf_table import FEWER_IN_PUPIL, TAPER, Extent, RadialPSF, gauss_legendre, nodes_for
from .parameters import Spec, plain

_FOCAL_SHIFT = "its main effect is the scale of z, which no image can tell from the shape"
_MICROSCOPE = "it is known from the objective; fit the depth or the coverslip instead"
# A fit may find 4 times as much or as little of these as light can have (RANGE), if more than
# diffraction widens a PSF, and as much again when it goes on and reads its settings anew. Chosen.
NA = Spec("na", "", "numerical aperture", 0.0, "index", (0.005, 1.7))
WAVELENGTHS = (0.01, 40.0)  # um; neither nm nor mm of light
WAVELENGTH = Spec("wavelength", "um", "of the emitted light, in vacuum", 0.0, None, WAVELENGTHS)
INDEX = Spec("index", "", "refractive index of the immersion", None, None, (1.0, 2.0))
APODISATION = Spec("apodisation", "", "amplitude across the pupil falls as exp(-apodisation rho^2)")
SPHERICAL = Spec("spherical", "rad", "spherical aberration, root mean square over the pupil", None,
                 None, (-10.0, 10.0))  # fmt: skip
LAYERS = (
    Spec("sample_index", "", "index of the sample", None, None, (1.0, 2.0), _FOCAL_SHIFT),
    Spec("depth", "um", "of the structure below the coverslip", 0.0, None, (0.0, 1000.0)),
    Spec("coverslip", "um", "thickness of the coverslip", 0.0, None, (0.0, 2000.0)),
    Spec("coverslip_index", "", "its refractive index", None, None, (1.0, 2.0), _MICROSCOPE),
    Spec("design_index", "", "index of the immersion it is made for", None, None, (1.0, 2.0),
         _MICROSCOPE),
    Spec("design_coverslip", "um", "coverslip it is made for", None, None, (0.0, 2000.0),
         _MICROSCOPE),
    Spec("design_coverslip_index", "", "index of that coverslip", None, None, (1.0, 2.0),
         _MICROSCOPE),
    Spec("working_distance", "um", "thickness of the immersion", None, None, (0.0, 1e5),
         _MICROSCOPE),
)  # fmt: skip
_BELOW_SAMPLE_INDEX = 0.999
# Spherical aberration (rad) for which the extent has room at least, if that is fitted. Chosen.
# Measured against a PSF with room for 2.5 rad (confocal, NA 1.22): the OTF differs by 0.05 at 0.8
# rad. Without any aberration, the usual extent alone makes as much of a difference, 0.07.
_ABERRATED = 0.5
_AXIAL_UNITS, _LATERAL_UNITS = 2.5, 5.0  # of resolution: extents that hold most of a PSF


def check_aperture(na: float, index: float) -> None:
    """Raise InputError unless the aperture is below the index of the immersion."""
    if na >= index:
        raise InputError(
            f"NA {na:g} must be below the refractive index of the immersion, {index:g}"
        )


class ObjectivePSF(RadialPSF):
    """Base of scalar and vectorial PSFs of an objective: the pupil and its sampling."""

    def with_extent(self, extent: Extent) -> ObjectivePSF:
        """Return the same PSF, kept within another extent (um along Z and across)."""
        other = self._with_values(self._values)
        with torch.no_grad():
            other._keep_within(extent)
        return other

    def _moving(self, names: Sequence[str]) -> Self:
        other = super()._moving(names)
        if "spherical" not in other.fitted:
            return other
        with torch.no_grad():
            needed = other._default_extent()
            other._keep_within((max(self._flat[0], needed[0]), max(self._flat[1], needed[1])))
        return other

    def with_wavelength(self, wavelength: Tensor) -> ObjectivePSF:
        """Return the same objective at another wavelength (um), on the same nodes."""
        return self._with_values({**self._values, "wavelength": wavelength})

    # ------------------------------------------------------------------------------- the pupil

    def _aperture(self) -> Tensor:
        """Return s at the rim of the pupil."""
        return self._values["na"]

    def _path(self, s: Tensor, weight: Tensor) -> Tensor | None:
        """Return the excess path (um) of rays over those in focus; None if there is none.

        The focus depends on the weight of each ray.
        """
        return None

    def _widest_path(self, s: Tensor, weight: Tensor) -> Tensor | None:
        """Return the largest path that a fit may reach, for which the extent has room."""
        return self._path(s, weight)

    def _fields(self, s: Tensor, amplitude: Tensor) -> list[tuple[float, Tensor, int]]:
        """Return weight of the intensity, pupil amplitude and Bessel order of each field."""
        return [(1.0, amplitude, 0)]

    def _amplitude(self, s: Tensor) -> Tensor:
        """Return the amplitude across the pupil."""
        return torch.ones_like(s)

    def _bandwidth(self) -> tuple[float, float, float]:
        """Return the bandwidth of the intensity, rad/um along Z, Y, X."""
        s, n = float(self._aperture().detach()), self._number("index")
        k = 2 * pi / self._number("wavelength")
        return k * (n - sqrt(n * n - s * s)), 2 * k * s, 2 * k * s

    def _default_extent(self) -> Extent:
        kz, _, kr = self._bandwidth()
        s, n = float(self._aperture().detach()), self._number("index")
        along, across = self._ray_spread()
        z = _AXIAL_UNITS * 2 * pi / kz + along
        return z, max(_LATERAL_UNITS * 2 * pi / kr, z * s / sqrt(n * n - s * s)) + across

    def _ray_spread(self) -> Extent:
        """Return how far aberrated rays land from the focus, along Z and across (um)."""
        rho = torch.linspace(0, 1, 65, dtype=torch.float64)
        s = rho * self._aperture()
        path = self._widest_path(s, rho)
        if path is None:
            return 0.0, 0.0
        cosine = torch.sqrt(self._values["index"] ** 2 - s**2)
        slope = (path[1:] - path[:-1])[:-1]
        along = float((slope / (cosine[1:] - cosine[:-1])[:-1]).abs().max())
        across = float((slope / (s[1:] - s[:-1])[:-1]).abs().max())
        return along, across

    def _place_nodes(self) -> None:
        super()._place_nodes()
        kz, kr = self._resolved
        z, r = (1 + TAPER) * self._flat[0], (1 + TAPER) * self._flat[1]
        # Aberrations need no further nodes: the extent already holds the rays that they spread.
        phase = kr / 2 * r + kz * z
        self._rho, self._rho_weight = gauss_legendre(0.0, 1.0, nodes_for(FEWER_IN_PUPIL * phase))

    def intensity_at(self, z: Tensor, r: Tensor) -> Tensor:
        """Return (Nz, Nr) intensity at focus positions ``z`` and axis distances ``r`` (um)."""
        v = self._values
        k = 2 * pi / v["wavelength"]
        rim = self._aperture()
        s = rim * self._rho
        phase = -z[:, None] * torch.sqrt(v["index"] ** 2 - s**2)
        path = self._path(s, self._rho * self._rho_weight)
        if path is not None:
            phase = phase + path
        phase = k * phase
        amplitude = self._amplitude(s) * s * self._rho_weight * rim
        found: Tensor | None = None
        argument = (k * s)[:, None] * r
        for weight, along, order in self._fields(s, amplitude):
            wave = torch.polar(torch.ones_like(phase), phase) * along
            bessel = (j0, j1, j2)[order](argument)
            field = torch.complex(wave.real @ bessel, wave.imag @ bessel)
            part = weight * (field.real**2 + field.imag**2)
            found = part if found is None else found + part
        assert found is not None
        return found


def without_defocus(
    path: Tensor, s: Tensor, index: Tensor, weight: Tensor
) -> tuple[Tensor, Tensor]:
    """Return a path along the pupil without its mean and defocus, and that defocus (um)."""
    cosine = torch.sqrt(index**2 - s**2)
    weight = weight / weight.sum()
    path, cosine = path - (weight * path).sum(), cosine - (weight * cosine).sum()
    defocus = (weight * path * cosine).sum() / (weight * cosine**2).sum()
    return path - defocus * cosine, defocus


class ScalarPSF(ObjectivePSF):
    """Scalar PSF of an aplanatic objective, with no aberration but the spherical one.

    The amplitude across the pupil is ``cos(angle)^(-1/2) exp(-apodisation rho^2)``: the sine
    condition for light that is emitted equally in all directions (B. M. Hanser et al., J. Microsc.
    216, 2004). The aberration is ``sqrt(5) (6 rho^4 - 6 rho^2 + 1)`` rad (R. J. Noll, J. Opt. Soc.
    Am. 66, 1976) without its shift of the focus, which would move what is measured. For other
    aberrations see :class:`PupilPSF` and :class:`GibsonLanniPSF`.

    Parameters
    ----------
    na, wavelength, index
        Numerical aperture; um, of the emitted light in vacuum; refractive index of the immersion.
        Numbers or tensors: the OTF is differentiable in all of them.
    apodisation
        0 for none.
    spherical
        Spherical aberration, rad (root mean square over the pupil); of either sign, 0 for none.
    fitted
        Names of the parameters that a fit moves.
    extent
        um along Z and across: the PSF is kept this far and falls to zero over as far again; by
        default 2.5 axial and 5 lateral units of resolution, and the whole cone of light.

    Raises
    ------
    InputError
        If the NA is not below the index, or a value is in another unit.
    """

    def __init__(
        self,
        na: float | Tensor,
        wavelength: float | Tensor,
        index: float | Tensor = 1.515,
        apodisation: float | Tensor = 0.0,
        spherical: float | Tensor = 0.0,
        *,
        fitted: Sequence[str] = ("na",),
        extent: Extent | None = None,
    ) -> None:
        check_aperture(plain(na), plain(index))
        values = {"na": na, "wavelength": wavelength, "index": index, "apodisation": apodisation}
        values["spherical"] = spherical
        specs = NA, WAVELENGTH, INDEX, APODISATION, SPHERICAL
        super().__init__(specs, values, fitted, extent)

    def with_wavelength(self, wavelength: Tensor) -> ScalarPSF:
        # Paths in um stay the same, as the glass does.
        v = self._values
        spherical = v["spherical"] * v["wavelength"] / wavelength
        return self._with_values({**v, "wavelength": wavelength, "spherical": spherical})

    def _path(self, s: Tensor, weight: Tensor) -> Tensor | None:
        return self._aberrated(self._values["spherical"], s, weight)

    def _widest_path(self, s: Tensor, weight: Tensor) -> Tensor | None:
        most = self._values["spherical"].detach().abs()
        if "spherical" in self.fitted:
            most = most.clamp_min(_ABERRATED)
        return self._aberrated(most, s, weight)

    def _aberrated(self, phase: Tensor, s: Tensor, weight: Tensor) -> Tensor | None:
        """Return the path (um) of an aberration; phase : rad, root mean square over the pupil."""
        if not (phase.requires_grad or plain(phase)):
            return None
        squared = (s / self._aperture()) ** 2
        shape = 5**0.5 * (6 * squared**2 - 6 * squared + 1)
        shape, _ = without_defocus(shape, s, self._values["index"], weight)
        return phase * self._values["wavelength"] / (2 * pi) * shape

    def _amplitude(self, s: Tensor) -> Tensor:
        v = self._values
        cosine = torch.sqrt(1 - (s / v["index"]) ** 2)
        return cosine**-0.5 * torch.exp(-v["apodisation"] * (s / self._aperture()) ** 2)


class GibsonLanniPSF(ObjectivePSF):
    """Scalar PSF with the aberration of coverslip, immersion and sample.

    S. F. Gibson and F. Lanni, "Experimental test of an analytical model of aberration in an
    oil-immersion objective lens used in three-dimensional light microscopy", J. Opt. Soc. Am. A 8,
    1991. Light passes the sample up to the coverslip, the coverslip and the immersion; differences
    from the design cause the aberration. The part of it that shifts the focus is removed, as it
    would move what is measured.

    Parameters
    ----------
    na, wavelength, index
        Numerical aperture; um, of the emitted light in vacuum; refractive index of the immersion.
        Numbers or tensors: the OTF is differentiable in all parameters.
    sample_index
        Refractive index of the sample; by default that of the immersion. If the NA is larger, light
        beyond the index stays at the coverslip and does not count.
    depth
        Depth of the structure below the coverslip, um.
    coverslip, coverslip_index
        Thickness (um) and refractive index of the coverslip.
    design_index, design_coverslip, design_coverslip_index, working_distance
        What the objective is made for; lengths in um. By default the immersion and the coverslip in
        use.
    fitted
        Names of the parameters that a fit moves.
    extent
        um along Z and across: the PSF is kept this far and falls to zero over as far again.

    Raises
    ------
    InputError
        If the NA is not below the index, a value is in another unit, or a parameter cannot be
        fitted.
    """

    def __init__(
        self,
        na: float | Tensor,
        wavelength: float | Tensor,
        index: float | Tensor = 1.515,
        sample_index: float | Tensor | None = None,
        depth: float | Tensor = 0.0,
        coverslip: float | Tensor = 170.0,
        coverslip_index: float | Tensor = 1.515,
        design_index: float | Tensor | None = None,
        design_coverslip: float | Tensor = 170.0,
        design_coverslip_index: float | Tensor = 1.515,
        working_distance: float | Tensor = 150.0,
        *,
        fitted: Sequence[str] = ("na",),
        extent: Extent | None = None,
    ) -> None:
        check_aperture(plain(na), plain(index))
        values: dict[str, object] = {
            "na": na,
            "wavelength": wavelength,
            "index": index,
            "sample_index": index if sample_index is None else sample_index,
            "depth": depth,
            "coverslip": coverslip,
            "coverslip_index": coverslip_index,
            "design_index": index if design_index is None else design_index,
            "design_coverslip": design_coverslip,
            "design_coverslip_index": design_coverslip_index,
            "working_distance": working_distance,
        }
        super().__init__((NA, WAVELENGTH, INDEX, *LAYERS), values, fitted, extent)

    def _aperture(self) -> Tensor:
        v = self._values
        highest = _BELOW_SAMPLE_INDEX * torch.minimum(
            torch.minimum(v["sample_index"], v["coverslip_index"]),
            torch.minimum(v["design_index"], v["design_coverslip_index"]),
        )
        return v["na"] if plain(v["na"]) < plain(highest) else highest

    def _layers(self, s: Tensor) -> Tensor:
        """Return the path (um) of rays through all layers but the actual immersion."""
        v = self._values

        def through(thickness: str, index: str) -> Tensor:
            return v[thickness] * torch.sqrt(v[index] ** 2 - s**2)

        return (
            through("depth", "sample_index")
            + through("coverslip", "coverslip_index")
            - through("design_coverslip", "design_coverslip_index")
            - through("working_distance", "design_index")
        )

    def _path(self, s: Tensor, weight: Tensor) -> Tensor | None:
        return without_defocus(self._layers(s), s, self._values["index"], weight)[0]


class VectorialPSF(GibsonLanniPSF):
    """Vectorial PSF of freely rotating dipoles, through coverslip, immersion and sample.

    Three integrals I0, I1, I2 (B. Richards and E. Wolf, Proc. R. Soc. A 253, 1959) with the
    transmission of the interfaces and the path of :class:`GibsonLanniPSF` (F. Aguet, "Super-
    resolution fluorescence microscopy based on physical models", EPFL 2009); the intensity is
    ``|I0|^2 + 2 |I1|^2 + |I2|^2``. Parameters as in that class.
    """

    def _amplitude(self, s: Tensor) -> Tensor:
        return (1 - (s / self._values["index"]) ** 2) ** -0.25

    def _fields(self, s: Tensor, amplitude: Tensor) -> list[tuple[float, Tensor, int]]:
        v = self._values
        ni, ng, ns = v["index"], v["coverslip_index"], v["sample_index"]
        ci, cg, cs = (torch.sqrt(1 - (s / n) ** 2) for n in (ni, ng, ns))
        # Fresnel: immersion to coverslip to sample.
        both = 4 * ni * ci * ng * cg
        across = both / ((ni * ci + ng * cg) * (ng * cg + ns * cs))
        within = both / ((ng * ci + ni * cg) * (ns * cg + ng * cs))
        return [
            (1.0, amplitude * (across + within * cs), 0),
            (2.0, amplitude * within * (s / ns), 1),
            (1.0, amplitude * (across - within * cs), 2),
        ]
