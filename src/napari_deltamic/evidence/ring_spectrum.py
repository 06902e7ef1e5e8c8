"""The power spectrum of an image, averaged over rings around the optical axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
from scipy.fft import rfftn
from scipy.ndimage import binary_opening

from ..geometry.distance_transform import distance_transform
from .evidence_rules import SPECTRUM


@dataclass(frozen=True, eq=False)
class RingSpectrum:
    """Mean power of the rings of a spectrum.

    Attributes
    ----------
    kz, k
        (n,) wavenumbers along Z and in the plane, rad/um.
    weight
        (n,) independent draws that each counts as: its modes belong to one shape, so they are not
        as many.
    power
        (n,) mean of the squared transform over the number of voxels.
    voxel
        (2,) um, along Z and in the plane.
    """

    kz: np.ndarray
    k: np.ndarray
    weight: np.ndarray
    power: np.ndarray
    voxel: np.ndarray

    @property
    def squared(self) -> np.ndarray:
        """(n,) squared wavenumbers."""
        found: np.ndarray = self.kz**2 + self.k**2
        return found


def most_structured(pixels: np.ndarray) -> list[np.ndarray]:
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


def ring_spectrum(
    parts: Sequence[np.ndarray], voxel_size: tuple[float, float, float]
) -> RingSpectrum:
    """The mean of the spectra of some parts of an image (P. D. Welch, 1967).

    parts : as :func:`most_structured` gives them. voxel_size : um, Z Y X.
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

    weight = np.minimum(count[filled], SPECTRUM.most_modes)
    return RingSpectrum(
        mean(kz), mean(plane), weight, mean(power), np.array([voxel_size[0], max(voxel_size[1:])])
    )
