"""What must not get worse: junctions, tracking, evidence, triangles, and random motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from statistics import mean
from types import SimpleNamespace

import numpy as np

from napari_deltamic.geometry.foam import foam
from napari_deltamic.measure import junction_angles, surface_distance

from ..clusters import known, random_motion, tracking
from ..effects import choice
from ..engine import adversarial_triangles
from ..figure import Options, Row
from .jobs import Bench, Job, Outcome, Side, fit_job, mesh_arrays
from .lines import Case, Line, Tally, compared, not_above, not_below, time_of
from .stacks import timed


def double_bubble(bench: Bench) -> list[Line]:
    """Junction angles, without noise and with it."""
    truth, spheres = known.bubble(bench.seed)
    start = foam(spheres[:, :3], spheres[:, 3], 2.0)
    lines = []
    for photons in (math.inf, known.PHOTONS):
        noise = "no noise" if math.isinf(photons) else f"{photons:g} photons"
        what = f"double bubble, {noise}"
        image = known.measured(truth, known.GRID, known.SIGMA, photons, bench.seed)
        pair = bench.both(fit_job(what, image, known.GRID.voxel_size, known.SIGMA, start))

        def angle(side: Side, pair=pair) -> float:  # type: ignore[no-untyped-def]
            found = junction_angles(pair.each[side][0].mesh())
            return max((float(np.abs(j.angles - 120).max()) for j in found), default=math.nan)

        def error(side: Side, pair=pair) -> float:  # type: ignore[no-untyped-def]
            return surface_distance(pair.each[side][0].mesh(), truth).mean

        lines += [
            compared(f"{what}, angles from 120", "degrees", pair, angle, not_above()),
            compared(f"{what}, mean surface error", "voxel", pair, error, not_above()),
            *timed(what, pair, None),
        ]
    return lines


def tracking_case(bench: Bench) -> list[Line]:
    """Cells that grow, exchange neighbours and divide."""
    frames = tracking.movie(tracking.DIVIDES_AT + 2 if bench.quick else tracking.FRAMES, bench.seed)
    start = tracking.start(frames[0], bench.seed + 1)
    arrays = {"images": np.stack([frame.image for frame in frames]), **mesh_arrays(start)}
    sigma = [float(s) for s in tracking.OPTICS.sigma_um]
    values = {"voxel_size": list(tracking.GRID.voxel_size), "sigma": sigma}
    pair = bench.both(Job("tracking", "track", arrays, values))
    courses = {
        side: tracking.judged(frames, _frames(each[0]), each[0].number("seconds"))
        for side, each in pair.each.items()
        if not each[0].failed
    }

    def of(value: Callable[[tracking.Course], float]) -> Callable[[Side], float]:
        return lambda side: float(value(courses[side]))

    def late(course: tracking.Course) -> float:
        found = course.divided_at
        return math.nan if found is None else abs(found - tracking.DIVIDES_AT)

    count = f"of {len(frames)}"
    return [
        compared(
            "tracking, frames all right", count, pair, of(lambda c: sum(c.right)), not_below()
        ),
        compared(
            "tracking, worst error", "voxel", pair, of(lambda c: max(c.distance)), not_above()
        ),
        compared("tracking, wrong contacts", "", pair, of(lambda c: sum(c.wrong)), not_above()),
        compared("tracking, division off by", "frames", pair, of(late), not_above()),
        time_of("tracking, all frames", pair),
    ]


def _frames(outcome: Outcome) -> list[SimpleNamespace]:
    """What ``tracking.judged`` asks of the results of frames."""
    results = []
    for number, told in enumerate(outcome.values["frames"]):
        mesh = outcome.mesh(f"frame{number}") if told["found"] else None
        events = [
            SimpleNamespace(kind=kind, cell=cell, daughters=daughters)
            for kind, cell, daughters in told["events"]
        ]
        results.append(SimpleNamespace(frame=number, mesh=mesh, events=events))
    return results


def evidence(bench: Bench) -> list[Line]:
    """Scenes with effects at random: which are found, which are false alarms, the shape's error."""
    tally = Tally()
    count = 2 if bench.quick else 12
    for number in range(count):
        scene = choice.simulated(bench.seed % 2**20 + number)
        values = {
            "voxel_size": list(scene.grid.voxel_size),
            "sigma": [float(s) for s in scene.optics.sigma_um],
            "settings": {"fit_psf": scene.fit_psf},
            "near": True,
        }
        arrays = {"image": scene.image, **mesh_arrays(scene.start)}
        pair = bench.both(Job(f"evidence {number}", "evidence", arrays, values))
        true = choice.grouped(scene.effects.names)

        def told(side: Side, pair=pair) -> set[str]:  # type: ignore[no-untyped-def]
            return choice.grouped(pair.each[side][0].values["recommended"])

        def error(side: Side, pair=pair, scene=scene) -> float:  # type: ignore[no-untyped-def]
            mesh = pair.each[side][0].mesh()
            return surface_distance(mesh, scene.truth, 5000).mean / min(choice.VOXEL)

        tally.add("missed", pair, lambda side, told=told, true=true: len(true - told(side)))
        tally.add("alarms", pair, lambda side, told=told, true=true: len(told(side) - true))
        tally.add("error", pair, error)
        tally.add("seconds", pair, "seconds")
        tally.add("fit", pair, "fit")
    what = f"evidence, {count} scenes"
    return [
        tally.line(f"{what}, effects missed", "", "missed", sum, not_above(), "weak ones too"),
        tally.line(f"{what}, false alarms", "", "alarms", sum, not_above()),
        tally.line(f"{what}, surface error with those found", "voxel", "error", mean, not_above()),
        tally.line(f"{what}, a recommendation", "s", "seconds", mean),
        tally.line(f"{what}, the fit before", "s", "fit", mean),
    ]


def present_only(figure: Callable[[Options], list[Row]]) -> Case:
    """Rows of another table, of the present tree alone; their bars are those of that table."""

    def case(bench: Bench) -> list[Line]:
        return [
            Line(row.figure, row.unit, math.nan, row.measured, row.asked, row.passed, row.note)
            for row in figure(bench)
        ]

    return case


CASES: dict[str, Case] = {
    "double-bubble": double_bubble,
    "tracking": tracking_case,
    "evidence": evidence,
    "triangles": present_only(adversarial_triangles),
    "random-motion": present_only(random_motion.random_motion),
}
