"""A sphere becomes a cow and a fish, without noise and at 40 photons."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from napari_deltamic import GaussianPSF, Mesh, render
from napari_deltamic.measure import surface_distance

from ..figure import target
from ..fits import BAR_DISTANCE, GRID, LENGTH, SIGMA, begin
from .jobs import Bench, Outcome, Pair, Side, fit_job
from .lines import Case, Line, at_most, compared, faster, not_above, time_of

PHOTONS = 40.0
_SAMPLES = 5000  # of a snapshot; the end is measured on all


def sphere_to(name: str, bench: Bench) -> list[Line]:
    """Error, time and evaluations at the end, and when the error first met the bar."""
    truth = target(bench.data, name, GRID, LENGTH)
    clean = render(truth, GRID, GaussianPSF(SIGMA), 1e-5).float().numpy()
    images = {"no noise": clean}
    if not bench.quick:
        images[f"{PHOTONS:g} photons"] = noisy(clean, PHOTONS, bench.seed)
    lines = []
    for noise, image in images.items():
        what = f"sphere -> {name}, {noise}"
        job = fit_job(what, image, GRID.voxel_size, SIGMA, begin(), snapshots=True)
        pair = bench.both(job, rounds=1 if bench.quick else 3)
        lines += [
            compared(f"{what}, mean surface error", "voxel", pair, error(pair, truth), not_above()),
            time_of(f"{what}, until it ends", pair, faster(4)),
            compared(f"{what}, evaluations", "", pair, "evaluations", at_most(200)),
            compared(
                f"{what}, until the error is {BAR_DISTANCE:g} voxel",
                "s",
                pair,
                partial(_until, pair, truth, BAR_DISTANCE),
            ),
        ]
        old = pair.first("baseline")
        if old is not None and not old.failed:
            reached = surface_distance(old.mesh(), truth, _SAMPLES).mean
            at = partial(_until, pair, truth, reached)
            lines.append(
                compared(f"{what}, until the baseline's last error", "s", pair, at, faster(4))
            )
    return lines


def noisy(clean: np.ndarray, photons: float, seed: int) -> np.ndarray:
    """Poisson noise on an image of so many photons at its peak, and a background of a tenth."""
    light = clean.clip(0).astype(np.float64)
    light = photons * (light / light.max() + 0.1)
    return np.random.default_rng(seed).poisson(light).astype(np.float32)


def error(pair: Pair, truth: Mesh, voxel: float = 1.0):  # type: ignore[no-untyped-def]
    """Mean distance between a side's surface and the true one, voxels: for ``compared``."""

    def of(side: Side) -> float:
        values = [
            surface_distance(o.mesh(), truth).mean / voxel for o in pair.each[side] if not o.failed
        ]
        return float(np.median(values)) if values else math.nan

    return of


def _until(pair: Pair, truth: Mesh, bar: float, side: Side) -> float:
    """Seconds until a snapshot is within a distance of the truth for good; nan if never."""
    times = [_first(o, truth, bar) for o in pair.each[side] if not o.failed]
    return float(np.median(times)) if times else math.nan


def _first(outcome: Outcome, truth: Mesh, bar: float) -> float:
    kept = outcome.values["snapshot_seconds"]
    steps = [(outcome.number("seconds"), "mesh")]
    steps += [(kept[k], f"snapshot{k}") for k in reversed(range(len(kept)))]
    reached = math.nan
    for seconds, name in steps:  # from the end back
        if surface_distance(outcome.mesh(name), truth, _SAMPLES).mean > bar:
            break
        reached = seconds
    return reached


CASES: dict[str, Case] = {
    "sphere-to-cow": partial(sphere_to, "cow"),
    "sphere-to-fish": partial(sphere_to, "fish"),
}
