"""What trying other neighbours at the end costs, and what it mends: foams with and without."""

from __future__ import annotations

from statistics import median

import numpy as np

from napari_deltamic.geometry.contacts import wall_areas
from napari_deltamic.measure import surface_distance

from ..default_command import fitted
from ..figure import Figure, Options, Row
from .foams import scene

CELLS, SEEDS = (16, 32), range(6)


def trials(options: Options) -> list[Row]:
    """Wrong contacts, surface error and seconds of the fits over all foams, both ways."""
    seeds = SEEDS[:1] if options.quick else SEEDS
    known = [scene(cells, seed) for cells in CELLS for seed in seeds]
    contacts = sum(len(wall_areas(one.truth)) for one in known)
    rows, seconds = [], {}
    for tried in (True, False):
        words = [] if tried else ["--no-trials"]
        taken, wrong, off = [], 0, []
        for one in known:
            outcome = fitted(one.image, one.grid.voxel_size, one.spheres, words)
            taken.append(outcome.report["seconds"])
            wrong += len(wall_areas(outcome.mesh).keys() ^ wall_areas(one.truth).keys())
            off.append(surface_distance(outcome.mesh, one.truth).mean)
        seconds[tried] = np.array(taken)
        name = f"{len(known)} foams, trials" if tried else f"{len(known)} foams, no trials"
        rows += [
            Row(f"{name}: contacts wrong", "", wrong, f"of {contacts}", None),
            Row(f"{name}: mean surface error", "", float(np.mean(off)), "voxel", None),
            Row(f"{name}: seconds of the fits", "", sum(taken), "s", None),
        ]
    ratio = median(seconds[False] / seconds[True])
    return [*rows, Row("time without trials over that with, median", "", ratio, "", None)]


FIGURES: dict[str, Figure] = {"trials": trials}
