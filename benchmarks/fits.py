"""Figures of whole fits: a sphere becomes a cow and a fish; a wrong PSF is put right."""

from __future__ import annotations

import time

import numpy as np

from napari_deltamic import FitState, GaussianPSF, Grid, Mesh, fit, render
from napari_deltamic.geometry import sphere
from napari_deltamic.measure import surface_distance
from napari_deltamic.runs.settings import FitSettings

from .figure import Figure, Options, Row, at_most, target

GRID = Grid((100, 100, 100), (1.0, 1.0, 1.0))
SIGMA = 1.5
BAR_DISTANCE, BAR_SECONDS = 0.05, 15.0


LENGTH = 80.0  # voxels, of the target
RADIUS = 25.0  # voxels, of the sphere in the middle of the grid that is the start


def begin() -> Mesh:
    """The sphere."""
    return sphere(np.mean(GRID.extent, axis=0), RADIUS, subdivisions=5)


def follow(truth: Mesh, sigma: float, settings: FitSettings) -> tuple[FitState, float, float]:
    """Last state, seconds until it converged, and until the surface first met the bar.

    The clock stands still while the distance to the truth is measured.
    """
    image = render(truth, GRID, GaussianPSF(SIGMA), 1e-5).float().numpy()
    seconds, reached = 0.0, float("nan")
    last = None
    began = time.perf_counter()
    for state in fit(image, GRID, begin(), GaussianPSF(sigma), settings=settings):
        seconds += time.perf_counter() - began
        last = state
        near_end = state.level >= state.levels - 1
        look = np.isnan(reached) and near_end and state.iteration % 10 == 0
        if look and surface_distance(state.mesh, truth, samples=5000).mean <= BAR_DISTANCE:
            reached = seconds
        began = time.perf_counter()
    assert last is not None
    return last, seconds, reached


def sphere_to(options: Options, name: str) -> list[Row]:
    """A sphere becomes the target."""
    truth = target(options.data, name, GRID, LENGTH)
    last, seconds, reached = follow(truth, SIGMA, FitSettings())
    found = surface_distance(last.mesh, truth)
    note = f"{last.iteration} iterations; {last.message}; largest distance {found.max:.2f}"
    return [
        at_most(
            f"sphere -> {name}, mean surface distance", BAR_DISTANCE, found.mean, "voxel", note
        ),
        at_most(f"sphere -> {name}, until the distance is met", BAR_SECONDS, reached, "s"),
        Row(f"sphere -> {name}, until it ends by itself", "", seconds, "s", None),
    ]


def wrong_psf(options: Options) -> list[Row]:
    """The same with a PSF that is 50 % off at the start, in either direction."""
    rows = []
    for factor in (1.5,) if options.quick else (1.5, 0.5):
        for name in ("cow",) if options.quick else ("cow", "fish"):
            truth = target(options.data, name, GRID, LENGTH)
            last, seconds, _ = follow(truth, SIGMA * factor, FitSettings(fit_psf=True))
            worst = max(abs(s / SIGMA - 1) for s in last.optics.sigma_um)
            mean = surface_distance(last.mesh, truth).mean
            note = f"surface {mean:.3f} voxel, {seconds:.0f} s"
            rows.append(
                at_most(f"{name}, sigma from {factor:g}x, worst axis", 2.0, 100 * worst, "%", note)
            )
    return rows


FIGURES: dict[str, Figure] = {
    "sphere-to-cow": lambda options: sphere_to(options, "cow"),
    "sphere-to-fish": lambda options: sphere_to(options, "fish"),
    "wrong-psf": wrong_psf,
}
