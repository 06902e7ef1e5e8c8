"""A first width of the PSF, from where the spectrum of an image sinks into its noise."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

import numpy as np

from ..runs.scene_settings import SIGMA_IN_VOXELS
from ..runs.settings import SceneSettings
from .estimate import Finding, unknown
from .evidence_rules import SPECTRUM
from .ring_spectrum import most_structured, ring_spectrum
from .spectrum_fit import fitted_spectrum


@dataclass(frozen=True)
class FirstSigma:
    """Standard deviations of the PSF, um, along z and in the plane."""

    z: Finding
    yx: Finding


def first_sigma(
    image: np.ndarray, voxel_size: tuple[float, float, float], insides: bool = True
) -> FirstSigma:
    """Standard deviations of a Gaussian PSF from the spectrum of an image.

    Parameters
    ----------
    image
        (Z, Y, X); NaN where missing.
    voxel_size
        um, Z Y X.
    insides
        Whether insides may shine; else what they show is as blurred as surfaces would have to be.
    """
    pixels = np.asarray(image, dtype=np.float32)
    parts = most_structured(pixels)
    if min(parts[0].shape) < SPECTRUM.fewest:
        nothing = unknown(f"a spectrum needs {SPECTRUM.fewest} voxels along each axis")
        return FirstSigma(nothing, nothing)
    if not any(part.any() for part in parts):
        nothing = unknown("every voxel has the same value")
        return FirstSigma(nothing, nothing)
    found = fitted_spectrum(ring_spectrum(parts, voxel_size), _few_slices(pixels) and insides)
    if not found.shows_structure:
        nothing = unknown("the spectrum shows no structure above the noise")
        return FirstSigma(nothing, nothing)
    size, errors = found.rings.voxel, found.errors()
    z = _width(found.numbers[1], float(errors[1]), size[0], "z")
    yx = _width(found.numbers[2], float(errors[2]), size[1], "y and x")
    if z.known and not yx.known:  # possible for noise: flatness stands in for a width
        z = unknown(yx.reason)
    return FirstSigma(z, yx)


def _few_slices(pixels: np.ndarray) -> bool:
    """Whether insides are thought of: in few slices, and none of them interpolated.

    In many, light out of focus looks like insides: a widefield stack with spherical aberration
    ended 3.7 voxels off. So do slices that are interpolated: 0.14 um was found for 0.25.
    """
    dead = bool(np.isnan(pixels).all(axis=(1, 2)).any())
    return len(pixels) < SPECTRUM.many and not dead


def plausible_sigma(
    image: np.ndarray, voxel_size: tuple[float, float, float]
) -> tuple[float, float, float] | None:
    """Widths (um, Z Y X) of a first PSF for a fit, as wide as the blur of the image.

    None if the spectrum does not tell the width in the plane, or gives widths that no light
    microscope has. If it does not tell that along Z, this is 1.2 voxels, as far as microscopes
    allow; and that in the plane if the image is sharper along Z than in any microscope.
    """
    found, side = first_sigma(image, voxel_size), (voxel_size[0], max(voxel_size[1:]))
    if found.yx.value is None:
        return None
    least, most = SPECTRUM.z_over_yx
    yx = max(found.yx.value, SPECTRUM.narrowest * side[1])
    if found.z.value is None:
        z = min(max(SIGMA_IN_VOXELS * side[0], yx), most * yx)
    else:
        z = max(found.z.value, SPECTRUM.narrowest * side[0])
    if z < least * yx:
        z = yx  # planes parallel to the slices, such as the cover slip, look sharp
    widest = zip((z, yx), side, SPECTRUM.in_voxels, strict=True)
    usable = z <= most * yx and all(width <= high * of for width, of, high in widest)
    return (z, yx, yx) if usable else None


def with_first_psf(scene: SceneSettings, image: np.ndarray) -> tuple[SceneSettings, bool]:
    """The scene with a PSF as wide as the blur of the image, and whether the image told it.

    If it did not, 1.2 voxels; a scene that has a PSF stays as it is. image : (Z, Y, X).
    """
    if scene.sigma is not None or scene.optics is not None:
        return scene, False
    size = scene.voxel_size
    told = plausible_sigma(image, size) if image.ndim == 3 else None
    z, y, x = (float(s) for s in told or (SIGMA_IN_VOXELS * d for d in size))
    return scene.model_copy(update={"sigma": (z, y, x)}), told is not None


def _width(log_width: float, error: float, size: float, axis: str) -> Finding:
    low, high = SPECTRUM.log_widths
    inside = low + SPECTRUM.at_bound < log_width < high - SPECTRUM.at_bound
    if error > SPECTRUM.largest_error or not inside:
        return unknown(f"the spectrum does not determine the width along {axis}")
    sigma = float(np.exp(log_width)) * size
    error = hypot(error, SPECTRUM.shape_error)
    return Finding(sigma, error * sigma, "where the spectrum sinks into the noise")
