"""What an image tells about its slices: whether they fade, and whether they drift.

An image alone cannot tell either from shape: a cell that narrows dims its slices, one that leans
shifts them. So both are hints. Drift is never fitted; stacks must be registered beforehand.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from scipy.ndimage import gaussian_filter

from ..common.normal import SIGMA_PER_MEDIAN_DEVIATION
from ..fitting.model.likelihood import voxel_noise
from .camera import mode
from .estimate import Finding, unknown
from .evidence_rules import SLICES


def fading(image: np.ndarray, spacing: float) -> Finding:
    """Share of the light lost per um along Z, from the brightest part of each slice.

    Parameters
    ----------
    image
        (Z, Y, X); NaN where missing.
    spacing
        Distance between slices, um.
    """
    pixels = np.asarray(image, dtype=np.float32)
    brightness, dark, noise = _slice_brightness(pixels)
    shows = np.isfinite(brightness) & (brightness > dark + 4 * noise)
    if not shows.any():
        return unknown(f"fewer than {SLICES.fewest} slices hold structures")
    # Slices that only graze the structures, or hold none, say nothing about the light.
    shows[shows] = brightness[shows] - dark > 0.25 * np.nanmax(brightness - dark)
    if shows.sum() < SLICES.fewest:
        return unknown(f"fewer than {SLICES.fewest} slices hold structures")
    z = np.flatnonzero(shows) * float(spacing)
    y = np.log(brightness[shows] - dark)
    z = z - z.mean()
    slope = float((z * y).sum() / (z**2).sum())
    left = y - y.mean() - slope * z
    # Neighbouring slices scatter alike: half of them count.
    error = sqrt(2 * float((left**2).sum()) / (len(z) - 2) / float((z**2).sum()))
    return Finding(-slope, error, "brightest parts of the slices, one after the other")


def _slice_brightness(pixels: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Mean of the brightest voxels of each slice, lightly smoothed; the dark level; the noise."""
    known = np.isfinite(pixels)
    if not known.any():
        return np.full(len(pixels), np.nan), 0.0, 0.0
    dark = mode(pixels[known])
    smooth = gaussian_filter(np.where(known, pixels, dark), (0, SLICES.smoothed, SLICES.smoothed))
    count = max(8, int(SLICES.bright * pixels[0].size))
    flat = np.sort(np.where(known, smooth, -np.inf).reshape(len(pixels), -1), axis=1)[:, -count:]
    with np.errstate(invalid="ignore"):
        means = np.where(np.isfinite(flat).all(1), flat.mean(1), np.nan)
    return means, dark, voxel_noise(np.where(known, pixels, dark), known) / (2 * sqrt(np.pi))


def drift(image: np.ndarray, voxel_size: tuple[float, float, float]) -> tuple[Finding, Finding]:
    """How slices are shifted against their neighbours.

    Returns
    -------
    lean
        Steady shift, um in the plane per um along Z, of a stage or of a leaning shape.
    jitter
        Root mean square shift of single slices against both neighbours, um, which no smooth shape
        explains.

    Parameters
    ----------
    image
        (Z, Y, X); NaN where missing.
    voxel_size
        um, Z Y X.
    """
    pixels = np.asarray(image, dtype=np.float32)
    brightness, dark, noise = _slice_brightness(pixels)
    shows = np.isfinite(brightness) & (brightness > dark + 4 * noise)
    runs = np.flatnonzero(shows)
    if len(runs) < SLICES.fewest or min(pixels.shape[1:]) < 16:
        nothing = unknown(f"fewer than {SLICES.fewest} slices hold structures")
        return nothing, nothing
    first, last = int(runs[0]), int(runs[-1]) + 1
    slices = np.where(np.isfinite(pixels[first:last]), pixels[first:last], dark) - dark
    spectra = np.fft.rfft2(slices * _taper(slices.shape[1:]))
    next_one = _shifts(spectra[:-1], spectra[1:], slices.shape[1:])
    over_next = _shifts(spectra[:-2], spectra[2:], slices.shape[1:])
    size = np.asarray(voxel_size[1:])
    # Two steps should add up to the shift over both; the difference gives the error.
    open_by = (next_one[:-1] + next_one[1:] - over_next) * size
    error = float(np.sqrt(np.mean(open_by**2) / 3 + (SLICES.least_error * size.mean()) ** 2))
    steps = next_one * size
    rate = np.median(steps, axis=0) / voxel_size[0]
    off = np.median(np.abs(steps - np.median(steps, axis=0)), axis=0)
    spread = SIGMA_PER_MEDIAN_DEVIATION * off
    lean = Finding(
        float(np.hypot(*rate)),
        float(np.hypot(*spread)) / voxel_size[0] / sqrt(len(steps)),
        "shifts of neighbouring slices; a leaning shape does the same",
    )
    # A slice out of place by e adds e to the step before it and -e to the one after.
    outstanding = (steps[:-1] - steps[1:]) / 2
    seen = float(np.mean(outstanding**2)) * 2  # both directions of the plane
    excess = seen * 2 / 3 - error**2 * 2
    if excess <= (2 * error**2) / sqrt(len(outstanding)) * 3:
        return lean, unknown("no slice stands out by more than the error of the comparison")
    return lean, Finding(sqrt(excess), error, "slices that stand out from both neighbours")


def _taper(shape: tuple[int, ...]) -> np.ndarray:
    return np.hanning(shape[0] + 2)[1:-1, None] * np.hanning(shape[1] + 2)[None, 1:-1]


def _shifts(one: np.ndarray, other: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(N, 2) shift of each slice against its partner along Y and X, voxels.

    The peak of the cross-correlation, with sub-voxel accuracy from a parabola; half whitened so
    that neither noise nor slow changes of brightness dominate.
    """
    product = np.conj(one) * other
    correlation = np.fft.irfft2(product / np.sqrt(np.abs(product) + 1e-12), s=shape)
    # The field is smooth over a voxel, as the images are.
    fy = np.fft.fftfreq(shape[0])[:, None]
    fx = np.fft.rfftfreq(shape[1])[None]
    low = np.exp(-2 * (np.pi * 1.0) ** 2 * (fy**2 + fx**2))
    correlation = np.fft.irfft2(np.fft.rfft2(correlation) * low, s=shape)
    r = SLICES.largest_shift
    near = np.roll(correlation, (r, r), axis=(1, 2))[:, : 2 * r + 1, : 2 * r + 1]
    found = np.zeros((len(one), 2))
    for k, field in enumerate(near):
        y, x = np.unravel_index(int(field[1:-1, 1:-1].argmax()), (2 * r - 1, 2 * r - 1))
        y, x = y + 1, x + 1
        for axis, three in enumerate((field[y - 1 : y + 2, x], field[y, x - 1 : x + 2])):
            bend = three[0] - 2 * three[1] + three[2]
            part = 0.5 * (three[0] - three[2]) / bend if bend < 0 else 0.0
            found[k, axis] = (y, x)[axis] - r + part
    return found
