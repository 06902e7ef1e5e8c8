"""Twenty simulated clusters: error, wrong contacts, time."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import mean

from napari_deltamic import Mesh
from napari_deltamic.geometry.contacts import contact_areas
from napari_deltamic.measure import surface_distance

from ..contacts import SEEN, ContactErrors, contact_errors
from .jobs import Bench, fit_job
from .lines import Case, Line, Tally, faster, not_above
from .scenes import CELLS, cluster

COUNT = 20


def clusters(bench: Bench) -> list[Line]:
    """Three lines for each, and those over all; the bars are on these."""
    count, most = (4, 10) if bench.quick else (COUNT, CELLS[1])
    tally, lines = Tally(), []
    for number in range(count):
        known = cluster(bench.seed, number, most)
        given = known.image, known.grid.voxel_size, known.sigma, known.start
        what = f"cluster {known.name}"
        pair = bench.both(fit_job(what, *given, labels=known.labels))
        found = {
            side: judged(each[0].mesh(), known.truth)
            for side, each in pair.each.items()
            if not each[0].failed
        }
        tally.add("error", pair, lambda side, found=found: found[side].error)
        tally.add("wrong", pair, lambda side, found=found: found[side].contacts.wrong)
        tally.add("seconds", pair, "seconds")
        tally.add("cpu", pair, "cpu")
        tally.add("evaluations", pair, "evaluations")
        lines += [
            tally.last(f"{what}, surface error", "voxel", "error"),
            tally.last(f"{what}, wrong contacts", "", "wrong"),
            tally.last(f"{what}, time", "s", "seconds"),
        ]
    of = f"{count} clusters"
    return [
        *lines,
        tally.line(f"{of}, mean surface error", "voxel", "error", mean, not_above()),
        tally.line(f"{of}, wrong contacts", "", "wrong", sum, not_above()),
        tally.line(f"{of}, mean time", "s", "seconds", mean, faster(5)),
        tally.line(f"{of}, mean CPU time", "s", "cpu", mean),
        tally.line(f"{of}, mean evaluations", "", "evaluations", mean),
    ]


@dataclass(frozen=True)
class Judged:
    """A fit beside the truth: mean surface error (voxels), and its contacts."""

    error: float
    contacts: ContactErrors


def judged(found: Mesh, truth: Mesh, voxel: float = 1.0) -> Judged:
    """The same cells must have the same numbers; voxel: its side, um."""
    right = contact_errors(contact_areas(found), contact_areas(truth), SEEN * voxel**2)
    return Judged(surface_distance(found, truth).mean / voxel, right)


CASES: dict[str, Case] = {"clusters": clusters}
