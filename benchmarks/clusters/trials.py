"""What trying other neighbours at the end costs, and what it mends: foams with and without."""

from __future__ import annotations

import time
from statistics import median

import numpy as np

from napari_deltamic import GaussianPSF, fit
from napari_deltamic.geometry.contacts import wall_areas
from napari_deltamic.measure import surface_distance

from ..figure import Figure, Options, Row
from .foams import SETTINGS, SIGMA, scene

CELLS, SEEDS = (16, 32), range(6)


def trials(options: Options) -> list[Row]:
    """Wrong contacts, surface error and time of the processor over all foams, both ways."""
    seeds = SEEDS[:1] if options.quick else SEEDS
    known = [scene(cells, seed) for cells in CELLS for seed in seeds]
    contacts = sum(len(wall_areas(one.truth)) for one in known)
    rows, seconds = [], {}
    for tried in (True, False):
        settings = SETTINGS.model_copy(update={"trials": tried})
        taken, wrong, off = [], 0, []
        for one in known:
            begun = time.process_time()
            *_, last = fit(one.image, one.grid, one.start, GaussianPSF(SIGMA), settings=settings)
            taken.append(time.process_time() - begun)
            wrong += len(wall_areas(last.mesh).keys() ^ wall_areas(one.truth).keys())
            off.append(surface_distance(last.mesh, one.truth).mean)
        seconds[tried] = np.array(taken)
        name = f"{len(known)} foams, trials" if tried else f"{len(known)} foams, no trials"
        rows += [
            Row(f"{name}: contacts wrong", "", wrong, f"of {contacts}", None),
            Row(f"{name}: mean surface error", "", float(np.mean(off)), "voxel", None),
            Row(f"{name}: time of the processor", "", sum(taken), "s", None),
        ]
    ratio = median(seconds[False] / seconds[True])
    return [*rows, Row("time without trials over that with, median", "", ratio, "", None)]


FIGURES: dict[str, Figure] = {"trials": trials}
