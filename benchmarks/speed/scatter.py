"""Noise draws of one cow: does its volume scatter as the fit predicts?"""

from __future__ import annotations

import numpy as np

from napari_deltamic import GaussianPSF, render
from napari_deltamic.geometry import sphere

from ..figure import target
from .growing import PHOTONS, noisy
from .jobs import SIDES, Bench, Outcome, fit_job
from .lines import Case, Line, at_most, line
from .psf import GRID, LENGTH, RADIUS

SIGMA, DRAWS = 1.5, 30


def scatter(bench: Bench) -> list[Line]:
    """Standard deviation of the volume over the predicted one, and what both are."""
    truth = target(bench.data, "cow", GRID, LENGTH)
    clean = render(truth, GRID, GaussianPSF(SIGMA), 1e-4).float().numpy()
    begin = sphere(np.mean(GRID.extent, axis=0), RADIUS, subdivisions=4)
    outcomes: dict[str, list[Outcome]] = {side: [] for side in SIDES}
    count = 6 if bench.quick else DRAWS
    for draw in range(count):
        image = noisy(clean, PHOTONS, bench.seed + draw)
        job = fit_job(f"draw {draw}", image, GRID.voxel_size, SIGMA, begin, predict=True)
        pair = bench.both(job)
        for side, each in pair.each.items():
            outcomes[side] += [o for o in each if not o.failed]
    found = [_of(outcomes[side]) for side in SIDES]
    true = truth.region_volume(1)
    what = f"cow at {PHOTONS:g} photons, {count} draws"
    ratios = [None if f is None else f[0] / f[1] for f in found]
    missing = [s for s, f in zip(SIDES, found, strict=True) if f is not None and np.isnan(f[1])]
    note = f"no prediction: {', '.join(missing)}" if missing else ""
    no_bar = "present" in missing  # nothing to judge yet
    return [
        line(
            f"{what}, sd of the volume over the predicted one",
            "",
            *ratios,
            None if no_bar else at_most(1.2),
            note,
        ),
        line(f"{what}, sd of the volume", "%", *(f and 100 * f[0] / true for f in found)),
        line(f"{what}, predicted sd", "%", *(f and 100 * f[1] / true for f in found)),
        line(f"{what}, mean volume off", "%", *(f and 100 * (f[2] / true - 1) for f in found)),
    ]


def _of(outcomes: list[Outcome]) -> tuple[float, float, float] | None:
    """Standard deviation, the predicted one (nan if there is none) and mean of volumes, um^3."""
    if not outcomes:
        return None
    volumes = [o.mesh().region_volume(1) for o in outcomes]
    predicted = [o.values["volume_sd"] for o in outcomes]
    told = np.nan if None in predicted else float(np.sqrt(np.mean(np.square(predicted))))
    return float(np.std(volumes, ddof=1)), told, float(np.mean(volumes))


CASES: dict[str, Case] = {"scatter": scatter}
