"""How exact the dial's choices are: surfaces fitted at several of them, against a known one."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from statistics import mean, stdev

import numpy as np

from ..errors import InputError
from ..fitting import FitState, fit
from ..fitting.model.default_accuracy import image_noise
from ..fitting.shape_dial import Dialled, Situation, dialled, with_edges
from ..geometry.connected import pieces
from ..geometry.mesh import Mesh
from ..measure.surface_distance import surface_distance
from ..optics import Optics
from ..runs.fit_settings import SHAPE_CHOICES
from ..runs.settings import NEAR_LEVELS, FitSettings
from ..scene import Grid, render
from .tradeoff import check_visible

CHOICES = SHAPE_CHOICES
DRAWS = 3  # of noise: few, since each is a fit, but two would hardly show a spread
DARK = 0.1  # background of a simulated image, relative to its peak; chosen by eye
ENOUGH = 1.05  # times the least error: :func:`enough` explains what that means
_SAMPLES = 6000  # points at which surfaces are compared: their mean is exact to about 1 %
_FEWEST, _MOST = 0.1, 1e6  # photons at the peak: no camera has less or could hold more
_EXACT = 1e-6  # accuracy of a simulated image, so that only noise makes an error
_BRIGHTEST = 99.9  # percentile taken as the peak: a single voxel would depend on where it lies
_SHRUNK = 0.1  # share of its size by which a start is smaller; chosen by eye


@dataclass(frozen=True)
class ShapeError:
    """The error of surfaces fitted at one choice of the dial.

    Attributes
    ----------
    choice
        quick, normal, careful, or a length such as 20nm.
    dialled
        What the choice stands for, and its predicted error.
    errors
        Mean distance of the fitted surface to the true one, um, for each noise draw.
    iterations, seconds
        Iterations and time of one fit, means over the draws.
    """

    choice: str
    dialled: Dialled
    errors: tuple[float, ...]
    iterations: float
    seconds: float

    @property
    def mean(self) -> float:
        """Mean error over the draws, um."""
        return mean(self.errors)

    @property
    def spread(self) -> float:
        """Standard deviation of the error over the draws, um; 0 for a single draw."""
        return stdev(self.errors) if len(self.errors) > 1 else 0.0


def simulated(truth: Mesh, grid: Grid, optics: Optics, photons: float, seed: int) -> np.ndarray:
    """An image, (Z, Y, X) float32, of the surface with so many photons at its peak.

    It has a background of a tenth of the peak and Poisson noise; with infinitely many photons it
    has no noise, and a peak of 1.
    """
    expected = _expected(truth, grid, optics)
    if not np.isfinite(photons):
        return expected.astype(np.float32)
    return np.random.default_rng(seed).poisson(photons * expected).astype(np.float32)


def photons_for(noise: float, truth: Mesh, grid: Grid, optics: Optics) -> float:
    """Photons at the peak that give a simulated image this noise ratio; infinity for no noise."""
    if noise <= 0:
        return float("inf")
    expected = _expected(truth, grid, optics)

    def noisier(photons: float) -> bool:
        image = np.random.default_rng(0).poisson(photons * expected)
        return image_noise(image) > noise

    # From many photons down: with very few, single counts dominate and the noise ratio falls again.
    high = _MOST
    while high > _FEWEST and not noisier(high / 2):
        high /= 2
    low = high / 2
    for _ in range(8):
        middle = (low * high) ** 0.5
        low, high = (middle, high) if noisier(middle) else (low, middle)
    return float((low * high) ** 0.5)


def shape_errors(
    truth: Mesh,
    grid: Grid,
    optics: Optics,
    photons: float,
    *,
    start: Mesh | None = None,
    settings: FitSettings | None = None,
    choices: Sequence[str] = CHOICES,
    draws: int = DRAWS,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[ShapeError]:
    """Fit simulated images of a surface at several choices of the dial.

    Every choice gets the same noise draws.

    Parameters
    ----------
    truth
        The surface that the images show.
    photons
        Photons at the peak of an image.
    start
        Where the fits start; by default the truth, with each piece shrunk by a tenth.
    settings
        Settings of the fits; by default those for seeds near the membranes.
    progress
        Called with how many fits are done, and how many there are.
    """
    if draws < 1:
        raise InputError("at least one noise draw is needed")
    start = start or shrunk(truth)
    settings = settings or FitSettings(levels=NEAR_LEVELS)
    images = [simulated(truth, grid, optics, photons, seed) for seed in range(draws)]
    done = 0
    now = Situation.of(start, grid, optics.sigma_um, image_noise(images[0]))
    for choice in choices:
        wanted = dialled(choice, now)
        begun = with_edges(start, wanted.edge)
        names = "accuracy", "flatness", "tolerance", "trials"
        given = settings.model_copy(update={name: getattr(wanted, name) for name in names})
        errors, iterations, seconds = [], [], []
        for image in images:
            began = time.perf_counter()
            last: FitState | None = None
            for state in fit(image, grid, begun, optics, settings=given):
                last = state
            assert last is not None, "a fit yields at least one state"
            seconds.append(time.perf_counter() - began)
            iterations.append(last.iteration)
            errors.append(surface_distance(last.mesh, truth, _SAMPLES).mean)
            done += 1
            if progress is not None:
                progress(done, draws * len(choices))
        yield ShapeError(choice, wanted, tuple(errors), mean(iterations), mean(seconds))


def enough(found: Sequence[ShapeError]) -> str:
    """The fastest choice whose error exceeds the least one by no more than a twentieth.

    Independent errors add in squares, so a choice that adds a twentieth contributes an error of a
    third of everything else.
    """
    if not found:
        raise InputError("no choice of the dial was measured")
    best = min(e.mean for e in found)
    good = [e for e in found if e.mean <= ENOUGH * best]
    return min(good, key=lambda e: e.seconds).choice


def shrunk(mesh: Mesh) -> Mesh:
    """The mesh with each connected piece shrunk by a tenth about its middle."""
    v, piece = mesh.vertices_numpy().copy(), pieces(mesh)
    for k in range(int(piece.max()) + 1):
        own = piece == k
        middle = v[own].mean(0)
        v[own] = middle + (1 - _SHRUNK) * (v[own] - middle)
    return mesh.with_vertices(v)


def _expected(truth: Mesh, grid: Grid, optics: Optics) -> np.ndarray:
    """The noise-free image: background and a signal whose peak is 1."""
    clean = render(truth, grid, optics, _EXACT).numpy().astype(np.float64).clip(0)
    check_visible(float(clean.sum()), truth)
    peak = float(np.percentile(clean, _BRIGHTEST)) or float(clean.max())
    return DARK + clean / peak
