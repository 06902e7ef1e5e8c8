"""What an image tells about its camera: gain, read noise, offset, saturation.

The variance of a camera's voxel is ``gain * (mean - offset) + read_noise^2`` (the photon transfer
curve of J. Janesick). One image suffices: a filter that suppresses band-limited structures leaves
the noise, its squares are averaged over voxels of similar brightness, and the slope of the line
through these averages is the gain. The line alone cannot tell uniform light from an offset. The
third cumulant of the dark voxels can, since photon noise is skewed and read noise is not.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.ndimage import correlate1d, minimum_filter, uniform_filter

from ..common.normal import SIGMA_PER_MEDIAN_DEVIATION
from ..fitting.model.saturation import saturation
from .estimate import Finding, unknown
from .evidence_rules import CAMERA

_SECOND = np.array([1.0, -2.0, 1.0]) / sqrt(6)  # along each axis, so that what is left of smooth
_SQUARES = _SECOND**2  # parts is of sixth order; means with these weights are those of what is left
# Number of voxels per independent square: by definition the sum of squared autocorrelations of the
# filter, 1, -2/3 and 1/6 along each axis.
_SHARED = (1 + 2 * (4 / 9 + 1 / 36)) ** 3
_WHITE = -2 / 3  # of neighbours in filtered white noise, whose autocorrelation this is


@dataclass(frozen=True)
class NoiseLine:
    """Variance of a voxel = ``slope * mean + intercept``, in the units of the image.

    The weights of a fit need nothing else; if the values are camera counts, the slope is the gain.
    """

    slope: float
    intercept: float
    slope_error: float
    lowest: float

    def variance(self, mean: np.ndarray) -> np.ndarray:
        """Variance of voxels with these means; never below that of the darkest ones seen."""
        floor = max(self.slope * self.lowest + self.intercept, 1e-12)
        return np.maximum(self.slope * mean + self.intercept, floor)


@dataclass(frozen=True)
class Camera:
    """What an image tells about its camera, in the units of the image.

    Attributes
    ----------
    gain
        Counts per photon (times the excess noise of a camera that multiplies).
    read_noise
        Standard deviation, counts.
    offset
        Counts without light.
    saturation
        The value at which bright voxels were cut.
    line
        Variance against mean, if they are related as in a camera's image; also for rescaled images,
        whose values are not counts, and for dim ones, which do not tell the gain.
    """

    gain: Finding
    read_noise: Finding
    offset: Finding
    saturation: Finding
    line: NoiseLine | None


def camera_from_image(image: np.ndarray, known: np.ndarray | None = None) -> Camera:
    """Gain, read noise, offset and saturation of one stack.

    Parameters
    ----------
    image
        (Z, Y, X) as the file holds it; what is not finite is left out.
    known
        (Z, Y, X) bool: voxels to use; all by default.
    """
    pixels = np.asarray(image)
    finite = np.isfinite(pixels)
    if known is not None:
        finite &= known
    reason = _unusable(pixels, finite)
    if reason:
        nothing = unknown(reason)
        return Camera(nothing, nothing, nothing, nothing, None)
    high, low = _ends(pixels[finite])
    usable = finite
    if high.value is not None:
        usable = usable & (pixels < high.value)
    if low is not None:
        usable = usable & (pixels > low)
    values = np.where(finite, pixels, 0).astype(np.float32)
    middle = _middle(values.shape)
    values, usable = values[middle], usable[middle]
    line, why = _line(values, usable)
    if line is None:
        gain = unknown(why)
        return Camera(gain, gain, _level(values, finite[middle], low), high, None)
    if _rescaled(pixels, finite):
        gain = unknown(
            "the values run from 0 to 1: they were rescaled, so they are not photon counts"
        )
        return Camera(gain, gain, unknown(gain.reason), unknown(gain.reason), line)
    if line.slope_error > CAMERA.largest_error * line.slope:
        gain = unknown("the image is too dim to tell how its noise grows with brightness")
        return Camera(gain, gain, _level(values, finite[middle], low), high, line)
    gain = Finding(line.slope, line.slope_error, "slope of the variance against the mean")
    if low is not None:
        nothing = unknown(f"dark voxels were cut at {low:g}")
        return Camera(gain, nothing, nothing, high, line)
    read, offset = _dark(values, usable, line)
    return Camera(gain, read, offset, high, line)


def failed_slices(pixels: np.ndarray) -> tuple[int, ...]:
    """Indices of slices with a single value, which the camera missed or registration filled."""
    flat = pixels.reshape(len(pixels), -1)
    return tuple(int(k) for k in np.flatnonzero(flat.min(1) == flat.max(1)))


def _unusable(pixels: np.ndarray, finite: np.ndarray) -> str:
    if pixels.ndim != 3 or min(pixels.shape) < 5 or finite.sum() < 4096:
        return "the stack is too small: a few thousand voxels, 5 along each axis, are needed"
    values = pixels[finite]
    if values.min() == values.max():
        return "every voxel has the same value"
    if len(np.unique(values[:: max(1, values.size // 100_000)])) < 5:
        return "the image has too few grey levels: a mask or labels?"
    return ""


def _middle(shape: tuple[int, ...]) -> tuple[slice, ...]:
    """Slices of the middle of a stack, no larger than needs to be looked at."""
    share = min(1.0, (CAMERA.looked_at / float(np.prod(shape))) ** 0.5)
    kept = [shape[0], *(max(5, int(n * share)) for n in shape[1:])]
    return tuple(slice((n - k) // 2, (n - k) // 2 + k) for n, k in zip(shape, kept, strict=True))


def _ends(values: np.ndarray) -> tuple[Finding, float | None]:
    """Values at which bright and dark voxels were cut: these are suspiciously frequent."""
    levels, counts = np.unique(values, return_counts=True)
    full, top = saturation(values), int(counts[-1])
    high = unknown("no values pile up at the maximum")
    if full is not None:
        high = Finding(full, 0.0, f"{top} voxels have exactly the largest value")
    # Few photons per voxel also pile up at zero, but then each next value is rarer in proportion.
    first, second, third = (float(c) for c in counts[:3])
    many = first > CAMERA.cut_share * values.size and first > CAMERA.over_next * second
    cut = many and first / second > CAMERA.falls * second / third
    return high, float(levels[0]) if cut else None


def _filtered(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Noise that second differences along each axis leave, and the mean of the voxels used."""
    noise, mean = values, values
    for axis in range(3):
        noise = correlate1d(noise, _SECOND.astype(np.float32), axis)
        mean = correlate1d(mean, _SQUARES.astype(np.float32), axis)
    return noise, mean


def _line(values: np.ndarray, usable: np.ndarray) -> tuple[NoiseLine | None, str]:
    """The line through the variances of voxels of similar brightness, or None and the reason."""
    noise, mean = _filtered(values)
    whole = minimum_filter(usable, size=3, mode="constant", cval=0)
    if whole.sum() < 4096:
        return None, "too few voxels are neither missing nor saturated"
    m, r = mean[whole], noise[whole]
    spread = SIGMA_PER_MEDIAN_DEVIATION * float(np.median(np.abs(r)))
    if spread <= CAMERA.noiseless * float(np.abs(m).max()):
        return None, "the image has no noise"
    related = [_neighbours(noise, whole, axis) for axis in range(3)]
    if max(abs(c - _WHITE) for c in related) > CAMERA.coloured:
        return None, (
            "the noise of neighbouring voxels is correlated: the image was filtered, resampled "
            "or deconvolved"
        )
    # Sorted by the surroundings, whose noise is independent of the mean: if sorted by the mean
    # itself, read noise would spread the bins and flatten the line.
    around = (125 * uniform_filter(values, 5) - 27 * uniform_filter(values, 3))[whole] / 98
    n, x, v = _binned(around, m, r)
    if len(n) < 4:
        return None, "the image has too few levels of brightness"
    slope, intercept, error = _weighted_line(x, v, n)
    if not slope > 0 or error > CAMERA.surely_related * slope:
        return None, "the noise does not grow with brightness as that of counted photons does"
    return NoiseLine(slope, intercept, error, float(x[0])), ""


def _neighbours(noise: np.ndarray, whole: np.ndarray, axis: int) -> float:
    """Correlation of the filtered noise of neighbours along an axis, from its signs.

    Signs are alike in dark and bright voxels; their correlation is 2/pi asin(rho).
    """
    first = tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))
    second = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
    both = whole[first] & whole[second]
    product = np.sign(noise[first][both]) * np.sign(noise[second][both])
    return float(np.sin(np.pi / 2 * product.mean())) if product.size else 0.0


def _binned(
    around: np.ndarray, mean: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Number of voxels, mean and mean square of the noise in bins of the brightness around."""
    low, high = np.quantile(around, CAMERA.levels)
    # Even in the square root of brightness, where photon counts scatter equally.
    edges = low + (high - low) * np.linspace(0, 1, CAMERA.bins + 1) ** 2
    which = np.digitize(around, edges) - 1
    found = []
    for k in range(CAMERA.bins):
        inside = which == k
        n = int(inside.sum())
        if n < CAMERA.fewest:
            continue
        r = noise[inside].astype(np.float64)
        # This clips structure finer than the PSF (hot voxels), but not the tails of the noise.
        limit = 5 * SIGMA_PER_MEDIAN_DEVIATION * np.median(np.abs(r)) + 1e-30
        square = float((np.clip(r, -limit, limit) ** 2).mean())
        found.append((n, float(mean[inside].mean()), square))
    columns = np.array(found).reshape(-1, 3).T
    return columns[0], columns[1], columns[2]


def _weighted_line(x: np.ndarray, v: np.ndarray, n: np.ndarray) -> tuple[float, float, float]:
    """Slope, intercept and error of the slope; variances scatter in proportion to their size."""
    model = np.full_like(v, np.average(v, weights=n))
    for _ in range(8):
        w = n / (2 * _SHARED * model**2)
        middle = np.average(x, weights=w)
        spread = float((w * (x - middle) ** 2).sum())
        slope = float((w * (x - middle) * v).sum()) / max(spread, 1e-300)
        intercept = float(np.average(v, weights=w) - slope * middle)
        least = CAMERA.flattest * np.minimum(v.min(), model.min())
        model = np.maximum(slope * x + intercept, least + 1e-300)
    # Where the line does not hold (structure, other noise of a camera), the scatter shows it.
    excess = max(1.0, float((w * (v - slope * x - intercept) ** 2).sum()) / max(len(x) - 2, 1))
    return slope, intercept, sqrt(excess / max(spread, 1e-300))


def _rescaled(pixels: np.ndarray, finite: np.ndarray) -> bool:
    if not np.issubdtype(pixels.dtype, np.floating):
        return False
    low, high = float(pixels[finite].min()), float(pixels[finite].max())
    return abs(high - 1) < 1e-6 and abs(low) < 0.5  # rounding; counts would begin at whole numbers


# ---------------------------------------------------------------------------------- dark voxels


def _dark_voxels(values: np.ndarray, usable: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) values of dark voxels, and the same minus the mean around each.

    Neighbours decide whether a voxel is dark, so that the noise of those chosen is not cut.
    """
    width = 2 * CAMERA.dark_radius + 1
    n = width**3
    around = (uniform_filter(values, width, mode="nearest") * n - values) / (n - 1)
    whole = minimum_filter(usable, size=width, mode="constant", cval=0)
    if whole.sum() < CAMERA.fewest_dark:
        return np.zeros(0), np.zeros(0)
    level = mode(around[whole])
    below = around[whole & (around < level)]
    scatter = sqrt(float(((below - level) ** 2).mean())) if below.size else 0.0
    dark = whole & (np.abs(around - level) <= 2 * scatter)
    return values[dark].astype(np.float64), (values - around)[dark].astype(np.float64)


def mode(values: np.ndarray) -> float:
    """The half-sample mode: repeatedly the shortest half (D. Bickel, R. Fruhwirth, 2006)."""
    ordered = np.sort(values.ravel())
    if len(ordered) > 200_000:
        ordered = ordered[:: len(ordered) // 200_000]
    while len(ordered) > 50:
        half = (len(ordered) + 1) // 2
        first = int(np.argmin(ordered[half - 1 :] - ordered[: len(ordered) - half + 1]))
        ordered = ordered[first : first + half]
    return float(ordered.mean())


def _dark(values: np.ndarray, usable: np.ndarray, line: NoiseLine) -> tuple[Finding, Finding]:
    """Read noise and offset, from dark parts and corrected for the light in them."""
    dark, d = _dark_voxels(values, usable)
    if len(d) < CAMERA.fewest_dark:
        nothing = unknown("the image has no dark part")
        return nothing, nothing
    d = d - d.mean()
    limit = 8 * d.std()
    d = np.clip(d, -limit, limit)
    level, variance, skew = float(dark.mean()), float((d**2).mean()), float((d**3).mean())
    skew_error = sqrt(6 * variance**3 / len(d))
    photons = max(skew, 0.0) / line.slope**3
    # The skewness of light cannot exceed what its variance allows.
    photons = min(photons, variance / line.slope**2)
    photons_error = sqrt(
        (skew_error / line.slope**3) ** 2 + (3 * photons * line.slope_error / line.slope) ** 2
    )
    read = variance - line.slope**2 * photons
    read_error = line.slope**2 * photons_error
    if read_error > 0.5 * variance:
        why = "light that is everywhere cannot be distinguished from an offset: too few dark voxels"
        return unknown(why), unknown(why)
    sigma = sqrt(max(read, 0.0))
    sigma_error = read_error / (2 * sigma) if read > read_error else sqrt(read_error)
    how = f"variance and skewness of {len(d)} dark voxels"
    error = line.slope * photons_error
    return (
        Finding(sigma, sigma_error, how),
        Finding(level - line.slope * photons, error, how),
    )


def _level(values: np.ndarray, finite: np.ndarray, low: float | None) -> Finding:
    """The level of the dark parts, for images whose noise does not tell how much light is in it."""
    if low is not None:
        return unknown(f"dark voxels were cut at {low:g}")
    dark, _ = _dark_voxels(values, finite)
    if len(dark) < CAMERA.fewest_dark:
        return unknown("the image has no dark part")
    error = float(dark.std() / sqrt(len(dark)))
    return Finding(float(dark.mean()), error, "level of the dark parts, light in them included")
