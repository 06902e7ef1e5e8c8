"""A foam of a thousand cells in 256 x 512 x 512 voxels, of the present tree alone."""

from __future__ import annotations

import time
import warnings

import numpy as np

from napari_deltamic import GaussianPSF, Grid, render
from napari_deltamic.geometry import mesh_from_labels
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.labels.voxels import voxel_labels

from .clusters import judged
from .jobs import Bench, fit_job
from .lines import Case, Line, at_least, at_most, compared, line
from .scenes import evenly, misplaced

SHAPE, CELLS = (256, 512, 512), 1000
MARGIN, TRUE_EDGE, SIGMA = 12.0, 3.0, 1.5  # voxels
PHOTONS, GROUND = 40.0, 2.0


def thousand(bench: Bench) -> list[Line]:
    """Time, memory, error and contacts, from labels whose borders are off by a voxel."""
    cells = min(bench.cells, 64) if bench.quick else bench.cells
    rng = np.random.default_rng([bench.seed, cells])
    share = (cells / CELLS) ** (1 / 3)
    grid = Grid(tuple(2 * round(n * share / 2) for n in SHAPE), (1.0,) * 3)  # type: ignore[arg-type]
    half = (np.array(grid.shape) - 1) / 2 - MARGIN
    # Spheres of a cell's share of the ellipsoid would leave gaps: a tenth more makes them touch.
    radius = 1.1 * float((half.prod() / cells) ** (1 / 3))
    centers = np.mean(grid.extent, axis=0) + evenly(cells, half - 0.8 * radius, rng)
    truth = foam(centers, radius * rng.uniform(0.95, 1.05, cells), TRUE_EDGE)
    light = render(truth, grid, GaussianPSF(SIGMA), 1e-3).detach().numpy().clip(0)
    image = rng.poisson(GROUND + PHOTONS * light / light.max()).astype(np.float32)
    del light
    labels = misplaced(voxel_labels(truth, grid.shape, grid.voxel_size), rng)
    began = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of labels repaired
        start = mesh_from_labels(labels, grid.voxel_size)
    seconds = time.perf_counter() - began
    what = f"foam of {cells}, {' x '.join(map(str, grid.shape))}"
    job = fit_job(what, image, grid.voxel_size, SIGMA, start, near=True)
    pair = bench.both(job, only="present")
    known = pair.first("present")
    if known is None or known.failed:
        return [compared(f"{what}, fit", "min", pair, "seconds", at_most(30))]
    begun, found = judged(start, truth), judged(known.mesh(), truth)
    faces = f"{len(start.faces)} faces at the start, {len(known.mesh().faces)} at the end"
    right = f"{found.contacts.lost} lost, {found.contacts.made_up} made up"
    before = begun.contacts
    return [
        line(f"{what}, fit", "min", None, known.number("seconds") / 60, at_most(30), faces),
        line(f"{what}, peak memory", "GB", None, known.peak_gb, at_most(8)),
        line(
            f"{what}, mean surface error",
            "voxel",
            None,
            found.error,
            at_most(0.15),
            f"{begun.error:.3f} at the start",
        ),
        line(
            f"{what}, F1 of contacts",
            "",
            None,
            found.contacts.f1,
            at_least(0.99),
            f"{right}; at the start {before.lost} and {before.made_up}",
        ),
        line(f"{what}, evaluations", "", None, known.number("evaluations")),
        line(f"{what}, start from labels", "s", None, seconds),
    ]


CASES: dict[str, Case] = {"thousand": thousand}
