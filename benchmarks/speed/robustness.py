"""Starts that are off in size or place, and noise: are all found, and does the start show?"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial
from statistics import mean

import numpy as np

from napari_deltamic import GaussianPSF, render
from napari_deltamic.geometry import sphere
from napari_deltamic.measure import surface_distance

from ..figure import target
from ..starts import GRID, LENGTH, SIGMA, TARGETS, Start, bar, size, starts
from .growing import noisy
from .jobs import Bench, Pair, Side, fit_job
from .lines import Case, Line, Tally, at_least, at_most, faster, not_above

PHOTONS = 40.0
# Of the five starts at equal noise: sizes, and a shift along each direction.
_SCALES, _SHIFTS = (0.4, 1.0, 1.4), ((0.0, 0.15, 0.0), (0.14, 0.14, -0.14))


def robustness(bench: Bench) -> list[Line]:
    """The 44 starts of ``benchmarks.starts``, and five for each target at 40 photons."""
    names = TARGETS[:1] if bench.quick else TARGETS
    every = list(starts(bench.data, names, bench.quick, bench.seed))
    return [
        *_lines("robustness", every, bench),
        *_lines(f"starts at {PHOTONS:g} photons", list(_at_equal_noise(names, bench)), bench),
    ]


def _lines(what: str, begun: list[Start], bench: Bench) -> list[Line]:
    """Fits from all starts: found, mean error, time; and by how much errors differ by start."""
    tally = Tally()
    lost = []
    for number, start in enumerate(begun):
        name = f"{what} {number}, {start.target}, {start.experiment} {start.value:g}"
        pair = bench.both(fit_job(name, start.image, GRID.voxel_size, SIGMA, start.mesh))
        distance = partial(_distance, pair, start)
        found = {side: distance(side) <= bar(start.experiment) for side in pair.each}
        tally.add("found", pair, found.__getitem__)
        tally.add("error", pair, distance)
        tally.add("seconds", pair, "seconds")
        tally.add("cpu", pair, "cpu")
        tally.add("evaluations", pair, "evaluations")
        if start.experiment != "noise":
            tally.add(f"error, {start.target}", pair, distance)
        lost += [f"{name} ({side})" for side, ok in found.items() if not ok]
    count = len(begun)
    note = "lost: " + "; ".join(lost) if lost else ""
    return [
        tally.line(f"{what}, found", f"of {count}", "found", np.nansum, at_least(count), note),
        tally.line(f"{what}, mean error", "voxel", "error", mean, not_above()),
        tally.line(f"{what}, mean time", "s", "seconds", mean, faster(4)),
        tally.line(f"{what}, mean CPU time", "s", "cpu", mean),
        tally.line(f"{what}, mean evaluations", "", "evaluations", mean),
        *(
            tally.line(
                f"{what}, spread over starts at equal noise, {name}",
                "voxel",
                f"error, {name}",
                np.ptp,
                at_most(0.01),
                "largest less least error",
            )
            for name in dict.fromkeys(start.target for start in begun)
        ),
    ]


def _at_equal_noise(names: tuple[str, ...], bench: Bench) -> Iterable[Start]:
    for name in names:
        truth = target(bench.data, name, GRID, LENGTH)
        center, radius = size(truth)
        clean = render(truth, GRID, GaussianPSF(SIGMA), 1e-5).float().numpy()
        image = noisy(clean, PHOTONS, bench.seed)
        for scale in _SCALES:
            mesh = sphere(center, scale * radius, subdivisions=4)
            yield Start("scale", scale, name, truth, mesh, image)
        for shift in _SHIFTS:
            mesh = sphere(center + LENGTH * np.array(shift), 0.8 * radius, subdivisions=4)
            yield Start("shift", max(shift), name, truth, mesh, image)


def _distance(pair: Pair, start: Start, side: Side) -> float:
    outcome = pair.each[side][0]
    if outcome.failed:
        return math.inf
    return surface_distance(outcome.mesh(), start.truth, samples=10000).mean


CASES: dict[str, Case] = {"robustness": robustness}
