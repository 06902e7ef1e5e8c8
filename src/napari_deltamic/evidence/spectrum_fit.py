"""The spectrum of cells seen through a Gaussian PSF, fitted to that of an image.

The power of thin surfaces falls as one over the wavenumber squared (Porod's law for sheets), that
of what they enclose once more as fast. At a surface the two are a quarter of a wave apart, so their
powers add. In each direction both are inversely proportional to the Gaussian curvature where the
surface faces that way: cells that are all flat or long have more of it along their short axis. The
PSF makes it fall further as a Gaussian, down to the power of the noise, which is the same
everywhere. All of these are found by the likelihood of the periodogram (P. Whittle, 1953).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from scipy.optimize import minimize

from .evidence_rules import SPECTRUM
from .ring_spectrum import RingSpectrum

# (6,) of the prior on the numbers of a fit: see the rules.
_PRECISION = (
    np.array(
        [SPECTRUM.log_share, np.inf, np.inf, np.inf, SPECTRUM.log_flatness, SPECTRUM.log_share]
    )
    ** -2.0
)
# Logarithms of the powers of surfaces and of insides where a search starts: nearly one of them
# alone. Chosen; from both at once, the search missed the surfaces of a flat cell.
_ALONE = ((0.0, -4.0), (-4.0, 0.0))


@dataclass(frozen=True, eq=False)
class SpectrumFit:
    """Cells, PSF and noise whose spectrum is nearest to that of an image.

    Attributes
    ----------
    rings
        The spectrum of the image.
    numbers
        (6,) logarithms: of the power of surfaces, of the widths along Z and in the plane (voxels),
        of the power of the noise, of the length of cells along Z over that across, and of the power
        of insides.
    """

    rings: RingSpectrum
    numbers: np.ndarray

    @property
    def shows_structure(self) -> bool:
        """Whether there is light above the noise."""
        surfaces, insides = _unblurred(self.rings, self.numbers)
        blur = np.exp(-((self.rings.voxel.min() * SPECTRUM.sharp) ** 2))
        light = float((surfaces + insides).max() * blur)
        return light > SPECTRUM.above_noise * float(np.exp(self.numbers[3]))

    def errors(self) -> np.ndarray:
        """(6,) standard deviations of the numbers, from the Fisher information of the spectrum."""
        h, base, columns = SPECTRUM.step, self._expected(self.numbers), []
        for i in range(len(self.numbers)):
            step = np.zeros(len(self.numbers))
            step[i] = h
            up, down = self._expected(self.numbers + step), self._expected(self.numbers - step)
            columns.append((up - down) / (2 * h) / base)
        j = np.stack(columns, 1)
        known = (j * self.rings.weight[:, None]).T @ j + np.diag(_PRECISION)
        known += 1e-12 * np.eye(len(known))
        return np.sqrt(np.maximum(np.diag(np.linalg.pinv(known)), 0))

    def _expected(self, numbers: np.ndarray) -> np.ndarray:
        found: np.ndarray = sum(_light(self.rings, numbers)) + np.exp(numbers[3])
        return found


def fitted_spectrum(rings: RingSpectrum, with_insides: bool = True) -> SpectrumFit:
    """The nearest spectrum of surfaces, and insides, from several widths to start from."""
    low = rings.squared < np.quantile(rings.squared, SPECTRUM.low_waves)
    light = float(np.log(np.median((rings.power * rings.squared)[low]) + 1e-30))
    noise = float(np.log(np.quantile(rings.power, SPECTRUM.noise_floor) + 1e-30))
    (darker, brighter), (quieter, louder) = SPECTRUM.light, SPECTRUM.noise
    shines, widths = (light + darker, light + brighter), SPECTRUM.log_widths
    inside = shines if with_insides else (light + darker, light + darker)
    bounds = [shines, widths, widths, (noise + quieter, noise + louder), SPECTRUM.log_flat, inside]
    loss = partial(_loss, rings, np.array([light, 0, 0, noise, 0.0, light]))
    tried = (
        minimize(
            loss,
            [light + surfaces, w, w, noise, 0.0, light + insides],
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
        )
        for w, (surfaces, insides) in product(np.log(SPECTRUM.starts), _ALONE[: 1 + with_insides])
    )
    best = min(tried, key=lambda r: float(r.fun))
    return SpectrumFit(rings, np.asarray(best.x))


def _loss(rings: RingSpectrum, start: np.ndarray, p: np.ndarray) -> tuple[float, np.ndarray]:
    """The negative log-likelihood at such numbers, and its derivatives."""
    (surfaces, insides), noise = _light(rings, p), np.exp(p[3])
    light = surfaces + insides
    m, pull = light + noise, _PRECISION * (p - start)
    value = float((rings.weight * (np.log(m) + rings.power / m)).sum() + pull @ (p - start) / 2)
    by_model = rings.weight * (1 - rings.power / m) / m
    by_light = by_model * light
    widths = np.exp(2 * p[1:3]) * rings.voxel**2
    long = np.exp(2 * p[4]) * rings.kz**2
    by = [
        by_model @ surfaces,
        -2 * widths[0] * (by_light @ rings.kz**2),
        -2 * widths[1] * (by_light @ rings.k**2),
        noise * by_model.sum(),
        by_light @ (2 - 4 * long / (rings.k**2 + long)),
        by_model @ insides,
    ]
    return value, np.array(by) + pull


def _light(rings: RingSpectrum, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) power of surfaces and of insides, seen through the PSF."""
    width_z, width_yx = np.exp(p[1:3]) * rings.voxel
    blur = np.exp(-((width_z * rings.kz) ** 2) - (width_yx * rings.k) ** 2)
    surfaces, insides = _unblurred(rings, p)
    return surfaces * blur, insides * blur


def _unblurred(rings: RingSpectrum, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) power of surfaces and of insides of ellipsoids, exp(p[4]) times as long along Z.

    1 / (k^2 K), K the Gaussian curvature where the normal is along the wave vector: for spheres
    1 / k^2. Both have numbers of one size, as the power of insides falls by another k^2 from one of
    the long waves on.
    """
    long, squared = np.exp(2 * p[4]), rings.squared
    shells = long * squared / (rings.k**2 + long * rings.kz**2) ** 2
    fall = np.quantile(squared, SPECTRUM.low_waves) / squared
    return np.exp(p[0]) * shells, np.exp(p[5]) * fall * shells
