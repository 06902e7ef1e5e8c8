"""A first width of the PSF, from where the spectrum of an image sinks into its noise.

The power of thin surfaces falls as one over the wavenumber squared (Porod's law for sheets), and
cells that are all flat or long have more of it along their short axis: in each direction it is
inversely proportional to the Gaussian curvature where the surface faces that way. The PSF makes it
fall further as a Gaussian, down to the power of the noise, which is the same everywhere. All of
these are fitted to the periodogram by its likelihood (P. Whittle, 1953).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, pi

import numpy as np
from scipy.fft import rfftn
from scipy.ndimage import binary_opening
from scipy.optimize import minimize

from ..geometry.distance_transform import distance_transform
from ..runs.scene_settings import SIGMA_IN_VOXELS
from ..runs.settings import SceneSettings
from .estimate import Finding, unknown
from .evidence_rules import SPECTRUM


@dataclass(frozen=True)
class FirstSigma:
    """Standard deviations of the PSF, um, along z and in the plane."""

    z: Finding
    yx: Finding


def first_sigma(image: np.ndarray, voxel_size: tuple[float, float, float]) -> FirstSigma:
    """Standard deviations of a Gaussian PSF from the spectrum of an image.

    Parameters
    ----------
    image
        (Z, Y, X); NaN where missing.
    voxel_size
        um, Z Y X.
    """
    parts = _prepared(np.asarray(image, dtype=np.float32))
    if min(parts[0].shape) < 12:
        nothing = unknown("a spectrum needs 12 voxels along each axis")
        return FirstSigma(nothing, nothing)
    if not any(part.any() for part in parts):
        nothing = unknown("every voxel has the same value")
        return FirstSigma(nothing, nothing)
    kz, k, count, power = _rings(parts, voxel_size)
    return _fitted(kz, k, count, power, voxel_size)


def plausible_sigma(
    image: np.ndarray, voxel_size: tuple[float, float, float]
) -> tuple[float, float, float] | None:
    """Widths (um, Z Y X) of a first PSF for a fit, as wide as the blur of the image.

    None if the spectrum does not tell both widths, or gives ones that no light microscope has. If
    the image is sharper along Z than in any microscope, the width in the plane is used along Z.
    """
    found = first_sigma(image, voxel_size)
    if found.z.value is None or found.yx.value is None:
        return None
    z, yx = found.z.value, found.yx.value
    least, most = SPECTRUM.z_over_yx
    if z < least * yx:
        z = yx  # planes parallel to the slices, such as the cover slip, look sharp
    in_voxels = z / voxel_size[0], yx / max(voxel_size[1:])
    bounds = zip(in_voxels, SPECTRUM.in_voxels, strict=True)
    if not all(low <= width <= high for width, (low, high) in bounds):
        return None
    return (z, yx, yx) if z <= most * yx else None


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


def _prepared(pixels: np.ndarray) -> list[np.ndarray]:
    """The parts of the stack with most structure, minus their mean, fading out at their borders."""
    share = min(1.0, (SPECTRUM.looked_at / pixels.size) ** 0.5)
    kept = [max(1, int(n * share)) for n in pixels.shape[1:]]
    starts = [
        np.linspace(0, n - m, -(-n // m)).astype(int)
        for n, m in zip(pixels.shape[1:], kept, strict=True)
    ]
    parts = [pixels[:, y : y + kept[0], x : x + kept[1]] for y in starts[0] for x in starts[1]]
    parts.sort(key=_structure, reverse=True)
    return [_faded(part) for part in parts[: SPECTRUM.parts]]


def _structure(part: np.ndarray) -> float:
    """Variance of the voxels that are not missing."""
    finite = part[np.isfinite(part)]
    return float(finite.var()) if finite.size else 0.0


def _faded(part: np.ndarray) -> np.ndarray:
    part = _bridged(part)
    finite = np.isfinite(part)
    part = np.where(finite, part - (part[finite].mean() if finite.any() else 0), 0)
    if not finite.all():
        gone = binary_opening(~finite, np.ones((3, 3, 3)))  # single voxels do no harm
        if gone.any() and not gone.all():  # else the edge of what is missing would look sharp
            part = part * np.minimum(distance_transform(~gone) / SPECTRUM.fades, 1)
    for axis, n in enumerate(part.shape):
        window = np.hanning(n + 2)[1:-1] ** 0.5
        part = part * np.expand_dims(window, tuple(a for a in range(3) if a != axis))
    return part


def _bridged(part: np.ndarray) -> np.ndarray:
    """The part with gaps of only a few slices, such as dead ones, interpolated along Z."""
    finite = np.isfinite(part)
    if finite.all():
        return part
    at = np.arange(len(part)).reshape(-1, 1, 1)
    below = np.maximum.accumulate(np.where(finite, at, -1), axis=0)
    above = np.minimum.accumulate(np.where(finite, at, len(part))[::-1], axis=0)[::-1]
    few = ~finite & (below >= 0) & (above < len(part)) & (above - below <= SPECTRUM.dead + 1)
    first, last = (np.clip(k, 0, len(part) - 1) for k in (below, above))
    share = (at - first) / np.maximum(last - first, 1)
    low, high = (np.take_along_axis(part, k, axis=0) for k in (first, last))
    return np.where(few, (1 - share) * low + share * high, part)


def _rings(
    parts: Sequence[np.ndarray], voxel_size: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """|k_z|, |k_yx| (rad/um), number of modes and mean power of each ring of the spectrum.

    The mean of the parts' spectra (P. D. Welch, 1967).
    """
    n, power = parts[0].shape, np.zeros(())
    for part in parts:
        power = power + np.abs(rfftn(part, workers=1)) ** 2 / (part.size * len(parts))
    axes = [2 * pi * np.fft.fftfreq(m, d) for m, d in zip(n[:2], voxel_size[:2], strict=True)]
    axes.append(2 * pi * np.fft.rfftfreq(n[2], voxel_size[2]))
    kz = np.abs(axes[0])[:, None, None] + np.zeros(power.shape)
    plane = np.sqrt(axes[1][:, None] ** 2 + axes[2][None] ** 2)[None] + np.zeros(power.shape)
    long_z = kz < 2 * pi / (SPECTRUM.longest_wave * n[0] * voxel_size[0])
    longest = min(n[1] * voxel_size[1], n[2] * voxel_size[2])
    long_yx = plane < 2 * pi / (SPECTRUM.longest_wave * longest)
    limit = pi / max(voxel_size[1:])
    used = ~(long_z & long_yx) & (plane <= limit)
    # One ring per frequency along z, as there are few.
    row = np.rint(kz / (2 * pi / (n[0] * voxel_size[0]))).astype(int)
    column = np.minimum((plane / limit * SPECTRUM.rings).astype(int), SPECTRUM.rings - 1)
    ring = (row * SPECTRUM.rings + column)[used]
    count = np.bincount(ring)
    filled = count > 0

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(ring, values[used])[filled] / count[filled]

    return mean(kz), mean(plane), count[filled].astype(float), mean(power)


def _fitted(
    kz: np.ndarray,
    k: np.ndarray,
    count: np.ndarray,
    power: np.ndarray,
    voxel_size: tuple[float, float, float],
) -> FirstSigma:
    size = np.array([voxel_size[0], max(voxel_size[1:])])
    squared = kz**2 + k**2
    known = 1 / SPECTRUM.log_flatness**2
    floor = float(np.quantile(power, SPECTRUM.noise_floor)) + 1e-30
    # The modes of one ring belong to one shape, so they are not as many independent draws.
    weight = np.minimum(count, SPECTRUM.most_modes)

    def signal_of(p: np.ndarray) -> np.ndarray:
        width_z, width_yx = np.exp(p[1:3]) * size
        whole: np.ndarray = np.exp(p[0] - (width_z * kz) ** 2 - (width_yx * k) ** 2)
        return whole * _shells(kz, k, p[4])

    def model(p: np.ndarray) -> np.ndarray:
        whole: np.ndarray = signal_of(p) + np.exp(p[3])
        return whole

    def loss(p: np.ndarray) -> tuple[float, np.ndarray]:
        """The negative log-likelihood, and its derivatives."""
        signal, noise = signal_of(p), np.exp(p[3])
        m = signal + noise
        value = float((weight * (np.log(m) + power / m)).sum() + known * p[4] ** 2 / 2)
        by_model = weight * (1 - power / m) / m
        by_signal = by_model * signal
        widths = np.exp(2 * p[1:3]) * size**2
        long = np.exp(2 * p[4]) * kz**2
        by = [
            by_signal.sum(),
            -2 * widths[0] * (by_signal @ kz**2),
            -2 * widths[1] * (by_signal @ k**2),
            noise * by_model.sum(),
            by_signal @ (2 - 4 * long / (k**2 + long)) + known * p[4],
        ]
        return value, np.array(by)

    low = squared < np.quantile(squared, SPECTRUM.low_waves)
    start = float(np.log(np.median(power[low] * squared[low]) + 1e-30))
    noise = float(np.log(floor))
    (darker, brighter), (quieter, louder) = SPECTRUM.light, SPECTRUM.noise
    bounds = [
        (start + darker, start + brighter),
        SPECTRUM.log_widths,
        SPECTRUM.log_widths,
        (noise + quieter, noise + louder),
        SPECTRUM.log_flat,
    ]
    tried = (
        minimize(loss, [start, w, w, noise, 0.0], jac=True, method="L-BFGS-B", bounds=bounds)
        for w in np.log(SPECTRUM.starts)
    )
    best = min(tried, key=lambda r: float(r.fun))
    p = np.asarray(best.x)
    signal = np.exp(p[0] - (size.min() * SPECTRUM.sharp) ** 2) * _shells(kz, k, p[4]).max()
    if not signal > SPECTRUM.above_noise * np.exp(p[3]):
        nothing = unknown("the spectrum shows no structure above the noise")
        return FirstSigma(nothing, nothing)
    errors = _errors(model, p, weight, np.diag([0, 0, 0, 0, known]))
    z = _width(p[1], float(errors[1]), size[0], "z")
    yx = _width(p[2], float(errors[2]), size[1], "y and x")
    if z.known and not yx.known:  # possible for noise: flatness stands in for a width
        z = unknown(yx.reason)
    return FirstSigma(z, yx)


def _shells(kz: np.ndarray, k: np.ndarray, log_flat: float) -> np.ndarray:
    """Power of shells of ellipsoids of revolution, exp(log_flat) times as long along z as across.

    1 / (k^2 K), K the Gaussian curvature where the normal is along the wave vector: for spheres
    1 / k^2.
    """
    squared = np.exp(2 * log_flat)
    power: np.ndarray = squared * (kz**2 + k**2) / (k**2 + squared * kz**2) ** 2
    return power


def _errors(  # type: ignore[no-untyped-def]
    model, p: np.ndarray, weight: np.ndarray, prior: np.ndarray
) -> np.ndarray:
    """Standard deviations of the parameters, from the Fisher information of the periodogram.

    prior : (P, P) information on them from elsewhere.
    """
    h = SPECTRUM.step
    base = model(p)
    columns = []
    for i in range(len(p)):
        step = np.zeros(len(p))
        step[i] = h
        columns.append((model(p + step) - model(p - step)) / (2 * h) / base)
    j = np.stack(columns, 1)
    information = (j * weight[:, None]).T @ j + prior + 1e-12 * np.eye(len(p))
    return np.sqrt(np.maximum(np.diag(np.linalg.pinv(information)), 0))


def _width(log_width: float, error: float, size: float, axis: str) -> Finding:
    low, high = SPECTRUM.log_widths
    inside = low + SPECTRUM.at_bound < log_width < high - SPECTRUM.at_bound
    if error > SPECTRUM.largest_error or not inside:
        return unknown(f"the spectrum does not determine the width along {axis}")
    sigma = float(np.exp(log_width)) * size
    error = hypot(error, SPECTRUM.shape_error)
    return Finding(sigma, error * sigma, "where the spectrum sinks into the noise")
