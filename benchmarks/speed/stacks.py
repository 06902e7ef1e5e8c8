"""Real stacks and a foam of 32 cells, with nothing set that a user would not set."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from napari_deltamic import Grid
from napari_deltamic.geometry.labels.voxels import voxel_labels
from napari_deltamic.images.stacks import read_image

from .. import vesicles as guv
from ..clusters import embryo, foams, glands
from ..ridge import ridge_distance
from .clusters import judged
from .jobs import Bench, Job, Pair, Side, fit_job
from .lines import Bar, Case, Line, at_most, compared, not_above, not_below, time_of


def embryo_case(bench: Bench) -> list[Line]:
    """Distance to the membranes and time, from labels, with a smooth density."""
    image, others = embryo.stack(bench), embryo.limeseg(bench)
    grid = Grid(image.shape, embryo.VOXEL_SIZE)
    labels = embryo.corrected(image, embryo.cells(image))
    settings = {"density": "smooth"}
    given = image, embryo.VOXEL_SIZE, embryo.SIGMA
    pair = bench.both(fit_job("embryo", *given, labels=labels, settings=settings))
    theirs = embryo.as_labels(others, grid)

    def of_ridge(reduce: Callable[[NDArray], float]) -> Callable[[Side], float]:
        return lambda side: float(reduce(distances[side]))

    def matched(side: Side) -> float:
        mesh = pair.each[side][0].mesh()
        return embryo.matched(voxel_labels(mesh, grid.shape, grid.voxel_size), theirs)

    distances = {
        side: embryo.lateral_distances(each[0].mesh(), image)
        for side, each in pair.each.items()
        if not each[0].failed
    }
    ridge = "embryo, lateral distance to the ridge"
    return [
        *timed("embryo", pair, at_most(33)),
        compared(f"{ridge}, mean", "voxel", pair, of_ridge(np.mean), not_above()),
        compared(f"{ridge}, median", "voxel", pair, of_ridge(np.median), not_above()),
        compared(f"{ridge}, above 2", "", pair, of_ridge(lambda d: (d > 2).mean()), not_above()),
        compared(
            "embryo, LimeSeg's cells matched", f"of {len(others)}", pair, matched, not_below()
        ),
    ]


def vesicles_case(bench: Bench) -> list[Line]:
    """Three vesicles by the command line: time of all of it, distance to the membranes."""
    path = guv.stack(bench)
    image = read_image(path)[0].astype(np.float32)
    words = guv.words(path.absolute(), guv.CENTRES)
    pair = bench.both(Job("vesicles", "command", {}, {"words": words}), 1 if bench.quick else 3)

    def lateral(region: int) -> Callable[[Side], float]:
        def of(side: Side) -> float:
            surface = pair.each[side][0].mesh().region_surface(region)
            return float(ridge_distance(surface, image, guv.VOXEL_SIZE).summary()["lateral_voxels"])

        return of

    def leaks(side: Side) -> float:
        told = pair.each[side][0].values["report"]["warnings"]
        return sum("leaked" in warning for warning in told)

    ridge = "median lateral distance to the ridge"
    return [
        time_of("vesicles, whole command", pair, at_most(8)),
        compared("vesicles, iterations", "", pair, "iterations"),
        *(
            compared(f"vesicle {k}, {ridge}", "voxel", pair, lateral(k), not_above())
            for k in (1, 2, 3)
        ),
        compared("vesicles, leaks reported", "", pair, leaks, not_above()),
    ]


def foam_case(bench: Bench) -> list[Line]:
    """The foam of ``benchmarks.clusters``, from spheres around shifted centres."""
    cells = 8 if bench.quick else 32
    known = foams.scene(cells, bench.seed)
    what = f"foam of {cells}"
    job = fit_job(what, known.image, known.grid.voxel_size, foams.SIGMA, known.start)
    pair = bench.both(job, rounds=1 if bench.quick else 3)
    return [
        *timed(what, pair, at_most(6)),
        compared(
            f"{what}, mean surface error",
            "voxel",
            pair,
            lambda side: judged(pair.each[side][0].mesh(), known.truth).error,
            not_above(),
        ),
        compared(
            f"{what}, wrong contacts",
            "",
            pair,
            lambda side: judged(pair.each[side][0].mesh(), known.truth).contacts.wrong,
            not_above(),
        ),
    ]


def glands_case(bench: Bench) -> list[Line]:
    """Error of the borders of cells, from a watershed's labels."""
    lines = []
    for name in glands.STACKS[:1] if bench.quick else glands.STACKS:
        image, truth = glands.stack(bench, name)
        _, flooded = glands.seeded(image, truth)
        given = image, glands.VOXEL_SIZE, (1.6, 1.6, 1.6)  # um; the PSF that it begins with
        pair = bench.both(fit_job(name, *given, labels=flooded, settings={"density": "smooth"}))

        def boundary(side: Side, pair: Pair = pair, truth: NDArray = truth) -> float:
            mesh = pair.each[side][0].mesh()
            return glands.boundary_error(voxel_labels(mesh, truth.shape, glands.VOXEL_SIZE), truth)

        before = glands.boundary_error(flooded, truth)
        lines += [
            *timed(name, pair, None),
            compared(
                f"{name}, boundary error",
                "um",
                pair,
                boundary,
                not_above(),
                f"watershed {before:.4g}",
            ),
        ]
    return lines


def timed(what: str, pair: Pair, bar: Bar | None) -> list[Line]:
    """Seconds, iterations and evaluations of a fit."""
    return [
        time_of(f"{what}, fit", pair, bar),
        compared(f"{what}, evaluations", "", pair, "evaluations"),
        compared(f"{what}, peak memory", "GB", pair, lambda side: pair.each[side][0].peak_gb),
    ]


CASES: dict[str, Case] = {
    "embryo": embryo_case,
    "vesicles": vesicles_case,
    "foam-32": foam_case,
    "glands": glands_case,
}
