"""A PSF that is 0.4 to 2 times the true one at the start, fitted with the surface."""

from __future__ import annotations

import numpy as np

from napari_deltamic import GaussianPSF, Grid, Mesh, render
from napari_deltamic.geometry import sphere

from ..figure import target
from .growing import error, noisy
from .jobs import Bench, Job, Pair, Side, fit_job
from .lines import Case, Line, at_most, compared, time_of

GRID = Grid((64, 64, 64), (1.0, 1.0, 1.0))
LENGTH, RADIUS = 44.0, 14.0
SIGMA = (2.4, 1.5, 1.5)
FACTORS = (0.4, 0.63, 1.0, 1.4, 2.0)
WITHIN, SURFACE = 4.0, 0.01  # %, voxel


def psf(bench: Bench) -> list[Line]:
    """Widths found, and the surface beside that of a fit which holds the true PSF."""
    lines = []
    for name in ("cow",) if bench.quick else ("cow", "fish"):
        for photons in (40.0,) if bench.quick else (40.0, 10.0):
            truth = target(bench.data, name, GRID, LENGTH)
            clean = render(truth, GRID, GaussianPSF(SIGMA), 1e-4).float().numpy()
            image = noisy(clean, photons, bench.seed)
            what = f"{name}, {photons:g} photons"
            held = bench.both(_job(f"{what}, PSF held", image, 1.0, False))
            named = f"{what}, true PSF held"
            lines += [
                compared(f"{named}, surface error", "voxel", held, error(held, truth)),
                compared(f"{named}, evaluations", "", held, "evaluations"),
            ]
            for factor in (FACTORS[0], FACTORS[-1]) if bench.quick else FACTORS:
                called = f"{what}, PSF from {factor:g}x"
                lines += _lines(called, bench.both(_job(called, image, factor, True)), held, truth)
    return lines


def _job(name: str, image: np.ndarray, factor: float, fitted: bool) -> Job:
    begin = sphere(np.mean(GRID.extent, axis=0), RADIUS, subdivisions=4)
    sigma = factor * np.array(SIGMA)
    settings = {"fit_psf": fitted}
    return fit_job(name, image, GRID.voxel_size, sigma, begin, settings=settings)


def _lines(what: str, pair: Pair, held: Pair, truth: Mesh) -> list[Line]:
    def width(side: Side) -> float:
        return float(100 * np.abs(np.array(pair.each[side][0].values["sigma"]) / SIGMA - 1).max())

    def beyond(side: Side) -> float:
        return error(pair, truth)(side) - error(held, truth)(side)

    now = held.first("present")
    evaluations = at_most(now.number("evaluations")) if now and not now.failed else None
    return [
        compared(f"{what}, worst width off", "%", pair, width, at_most(WITHIN)),
        compared(f"{what}, surface error", "voxel", pair, error(pair, truth)),
        compared(f"{what}, over that with the true PSF", "voxel", pair, beyond, at_most(SURFACE)),
        compared(f"{what}, evaluations", "", pair, "evaluations", evaluations, "as PSF held"),
        time_of(f"{what}, time", pair),
    ]


CASES: dict[str, Case] = {"psf": psf}
