"""Makes a PSF from the numbers on an objective, in one call."""

from __future__ import annotations

from math import pi, sqrt
from typing import get_args

from ..common.choices import IMMERSIONS, Modality, PSFModel
from ..errors import InputError
from .gaussian import GaussianPSF
from .modalities import _FWHM, AIRY, EXCITATION, PINHOLE, SHEET, ConfocalPSF, LightSheetPSF
from .objective import (
    INDEX,
    LAYERS,
    NA,
    WAVELENGTH,
    GibsonLanniPSF,
    ObjectivePSF,
    ScalarPSF,
    VectorialPSF,
    check_aperture,
)
from .otf_table import TablePSF
from .parameters import Spec, check_unit
from .pupil import PupilPSF


def microscope(
    modality: Modality = "widefield",
    *,
    na: float,
    wavelength: float,
    immersion: str | float = "oil",
    excitation: float | None = None,
    pinhole: float = 1.0,
    sheet: float | None = None,
    sample_index: float | None = None,
    depth: float = 0.0,
    zernike: dict[int, float] | None = None,
    spherical: float = 0.0,
    model: PSFModel = "vectorial",
    fitted: tuple[str, ...] | None = None,
) -> GaussianPSF | TablePSF:
    """Make the PSF of a microscope.

    Parameters
    ----------
    modality
        ``"widefield"``, ``"confocal"``, ``"spinning disk"`` or ``"light sheet"``.
    na
        Numerical aperture of the detection objective.
    wavelength
        Of the emitted light in vacuum, um.
    immersion
        ``"air"``, ``"water"``, ``"silicone"``, ``"glycerol"``, ``"oil"``, or a refractive index.
    excitation
        Wavelength of the excitation, um, for a confocal or a spinning disk; by default 0.93
        times that of the emission.
    pinhole
        Diameter in Airy units.
    sheet
        Full width at half maximum of the light sheet, um.
    sample_index
        Refractive index of the sample; by default that of the immersion.
    depth
        Depth of the structure below the coverslip, um.
    zernike
        Phase (rad) by Noll index, for the model ``"pupil"``.
    spherical
        Spherical aberration, rad (root mean square over the pupil), for the model ``"scalar"``.
    model
        ``"vectorial"`` (the most exact), ``"scalar"``, ``"gibson-lanni"`` (scalar, with the layers
        of the sample), ``"pupil"`` (scalar, with Zernike phases), or ``"gaussian"``, the
        approximation of B. Zhang et al., "Gaussian approximations of fluorescence microscope point-
        spread function models", Appl. Opt. 46, 2007, of the same microscope.
    fitted
        Names of the parameters to fit; by default those of the model.

    Raises
    ------
    InputError
        If a number is in another unit or impossible (NA above the index, no sheet, pinhole 0).
    """
    _check_choice("modality", modality, get_args(Modality))
    _check_choice("model", model, get_args(PSFModel))
    index = _index(immersion)
    sample = index if sample_index is None else sample_index
    _check(NA, na)
    _check(WAVELENGTH, wavelength)
    _check(LAYERS[0], sample)
    _check(LAYERS[1], depth)
    check_aperture(na, index)
    lit = modality in ("confocal", "spinning disk")
    if lit:
        excitation = 0.93 * wavelength if excitation is None else excitation
        _check(EXCITATION, excitation)
        if not pinhole > 0:
            raise InputError(f"the pinhole must be larger than 0 Airy units, not {pinhole:g}")
        _check(PINHOLE, pinhole)
    if modality == "light sheet":
        if sheet is None:
            raise InputError("a light sheet microscope needs the thickness of its sheet (um)")
        _check(SHEET, sheet)
    if zernike and model != "pupil":
        raise InputError(f"Zernike phases belong to the model 'pupil', not to '{model}'")
    if spherical and model != "scalar":
        raise InputError(f"spherical aberration belongs to the model 'scalar', not to '{model}'")
    if model == "gaussian":
        sigma = gaussian_widths(modality, na, wavelength, index, excitation, pinhole, sheet)
        return GaussianPSF(sigma)
    layers = sample, depth
    aberrations = zernike, spherical
    detection = _objective(model, na, wavelength, index, layers, aberrations, fitted, modality)
    free = ("na",) if fitted is None else fitted
    if lit:
        if not isinstance(detection, ObjectivePSF):
            raise InputError(f"a {modality} PSF cannot have Zernike phases; choose another model")
        assert excitation is not None
        return ConfocalPSF(
            detection, excitation, pinhole, disk=modality == "spinning disk", fitted=free
        )
    if modality == "light sheet":
        assert sheet is not None
        return LightSheetPSF(detection, sheet, fitted=fitted or detection.fitted)
    return detection


def _objective(
    model: PSFModel,
    na: float,
    wavelength: float,
    index: float,
    layers: tuple[float, float],
    aberrations: tuple[dict[int, float] | None, float],
    fitted: tuple[str, ...] | None,
    modality: Modality,
) -> ObjectivePSF | PupilPSF:
    (sample_index, depth), (zernike, spherical) = layers, aberrations
    # The outermost model gets the names of the parameters to fit.
    own = fitted if modality == "widefield" else None
    free = ("na",) if own is None else own
    matched = depth == 0 or abs(sample_index - index) < 1e-9
    if model in ("scalar", "pupil") and not matched:
        raise InputError(
            f"the model '{model}' has no layers: choose 'gibson-lanni' or 'vectorial' for a "
            "sample of another index"
        )
    if model == "scalar":
        return ScalarPSF(na, wavelength, index, spherical=spherical, fitted=free)
    if model == "pupil":
        return PupilPSF(na, wavelength, index, zernike, fitted=own)
    kind = GibsonLanniPSF if model == "gibson-lanni" else VectorialPSF
    return kind(na, wavelength, index, sample_index, depth, fitted=free)


def gaussian_widths(
    modality: Modality,
    na: float,
    wavelength: float,
    index: float,
    excitation: float | None = None,
    pinhole: float = 1.0,
    sheet: float | None = None,
) -> tuple[float, float, float]:
    """Return sigma (um, Z Y X) of the Gaussian nearest to the PSF of a microscope.

    B. Zhang, J. Zerubia and J.-C. Olivo-Marin, Appl. Opt. 46, 2007: the nonparaxial formulas of the
    widefield PSF; products and pinholes combine Gaussians (a disc of radius a has variance
    ``a^2 / 4`` along each axis).
    """
    z, across = _zhang(na, wavelength, index)
    if modality == "light sheet":
        assert sheet is not None
        z = 1 / sqrt(1 / z**2 + (_FWHM / sheet) ** 2)
    if modality in ("confocal", "spinning disk"):
        assert excitation is not None
        z_lit, lit = _zhang(na, excitation, index)
        hole = (pinhole * AIRY * wavelength / na) ** 2 / 4
        seen = sqrt(across**2 + hole)
        # A pinhole widens the detection along Z by the same factor as across.
        z_seen = z * seen / across
        if modality == "spinning disk":
            z_lit, lit = z_lit * sqrt(lit**2 + hole) / lit, sqrt(lit**2 + hole)
        across = 1 / sqrt(1 / seen**2 + 1 / lit**2)
        z = 1 / sqrt(1 / z_seen**2 + 1 / z_lit**2)
    return z, across, across


def _zhang(na: float, wavelength: float, index: float) -> tuple[float, float]:
    """Return axial and lateral sigma (um) of the nonparaxial widefield PSF."""
    k = 2 * pi * index / wavelength
    c = sqrt(1 - (na / index) ** 2)
    across = sqrt((4 - 7 * c**1.5 + 3 * c**3.5) / (7 * (1 - c**1.5))) ** -1 / k
    top = 5 * sqrt(7) * (1 - c**1.5)
    bottom = sqrt(6) * k * sqrt(4 * c**5 - 25 * c**3.5 + 42 * c**2.5 - 25 * c**1.5 + 4)
    return top / bottom, across


def _index(immersion: str | float) -> float:
    if isinstance(immersion, str):
        if immersion not in IMMERSIONS:
            raise InputError(
                f"unknown immersion '{immersion}': choose from {', '.join(IMMERSIONS)}, or give "
                "its refractive index"
            )
        return IMMERSIONS[immersion]
    _check(INDEX, immersion)
    return float(immersion)


def _check(spec: Spec, value: float) -> None:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{spec.name} takes one number, not {value!r}") from None
    check_unit(spec, number)


def _check_choice(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise InputError(f"unknown {name} '{value}': choose from {', '.join(known)}")
