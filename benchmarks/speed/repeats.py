"""The same fit on one thread, on two and again; and from a start moved by 1e-6 voxel."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from napari_deltamic import Mesh
from napari_deltamic.geometry import mesh_from_labels
from napari_deltamic.geometry.contacts import contacts
from napari_deltamic.measure import surface_distance

from ..clusters import embryo, foams
from ..figure import MissingData
from .jobs import Bench, Job, Outcome, Pair, Side, fit_job
from .lines import Case, Line, at_least, at_most, compared

MOVED, WITHIN = 1e-6, 0.02  # voxels


def jobs(bench: Bench) -> Iterable[tuple[Job, Mesh, float]]:
    """Fits of clusters, their starts, and the side of a voxel (um)."""
    for cells in (8,) if bench.quick else (8, 32):
        known = foams.scene(cells, bench.seed)
        job = fit_job(
            f"foam of {cells}", known.image, known.grid.voxel_size, foams.SIGMA, known.start
        )
        yield job, known.start, 1.0
    if bench.quick:
        return
    try:
        image = embryo.stack(bench)
    except MissingData:
        return
    labels = embryo.corrected(image, embryo.cells(image))
    start = mesh_from_labels(labels, embryo.VOXEL_SIZE)
    settings = {"density": "smooth"}
    given = image, embryo.VOXEL_SIZE, embryo.SIGMA, start
    yield fit_job("embryo", *given, near=True, settings=settings), start, 1.0


def same_bits(bench: Bench) -> list[Line]:
    """Whether the final meshes are the same to the last bit."""
    lines = []
    for job, _, voxel in jobs(bench):
        first = bench.both(job, threads=1)
        others = {
            "1 and 2 threads": bench.both(_named(job, "2 threads"), threads=2),
            "twice": bench.both(_named(job, "2 threads again"), threads=2),
        }
        one = {"1 and 2 threads": first, "twice": others["1 and 2 threads"]}
        for what, pair in others.items():
            lines += _beside(f"{job.name}, {what}", one[what], pair, voxel, bits=True)
    return lines


def moved_start(bench: Bench) -> list[Line]:
    """Whether contacts and surfaces stay."""
    lines = []
    rng = np.random.default_rng(bench.seed)
    for job, start, voxel in jobs(bench):
        places = start.vertices_numpy()
        way = rng.normal(size=places.shape)
        way *= MOVED * voxel / np.linalg.norm(way, axis=1, keepdims=True)
        arrays = {**job.arrays, "start_vertices": places + way}
        moved = Job(f"{job.name}, start moved", job.task, arrays, job.values)
        what = f"{job.name}, start moved by {MOVED:g} voxel"
        lines += _beside(what, bench.both(job), bench.both(moved), voxel, bits=False)
    return lines


def _named(job: Job, name: str) -> Job:
    return Job(f"{job.name}, {name}", job.task, job.arrays, job.values)


def _beside(what: str, one: Pair, other: Pair, voxel: float, bits: bool) -> list[Line]:
    def two(side: Side) -> tuple[Outcome, Outcome]:
        return one.each[side][0], other.each[side][0]

    def same(side: Side) -> float:
        a, b = (outcome.arrays for outcome in two(side))
        parts = ("mesh_vertices", "mesh_faces", "mesh_regions")
        return float(all(np.array_equal(a[part], b[part]) for part in parts))

    def apart(side: Side, which: str) -> float:
        a, b = (outcome.mesh() for outcome in two(side))
        return float(getattr(surface_distance(a, b), which)) / voxel

    def changed(side: Side) -> float:
        a, b = (contacts(outcome.mesh()) for outcome in two(side))
        return len(a ^ b)

    # The first of the two may have failed alone.
    each = {s: other.each[s] if not one.each[s][0].failed else one.each[s] for s in one.each}
    pair = Pair(each)
    asked = None if bits else at_most(WITHIN)
    lines = [
        compared(f"{what}, contacts that differ", "", pair, changed, at_most(0)),
        compared(f"{what}, mean distance", "voxel", pair, lambda s: apart(s, "mean")),
        compared(f"{what}, largest distance", "voxel", pair, lambda s: apart(s, "max"), asked),
    ]
    if bits:
        lines.insert(0, compared(f"{what}, same bits", "1: yes", pair, same, at_least(1)))
    return lines


CASES: dict[str, Case] = {"same-bits": same_bits, "moved-start": moved_start}
