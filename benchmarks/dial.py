"""The dial on 24 scenes of 1 to 100 cells: predicted error, measured error, time.

``python -m benchmarks.dial --page docs/accuracy.md``. Each scene is rendered by a way of its own
(``defaults.imaging``), and fitted as ``napari-deltamic fit`` does from image, voxel size, labels
and ``--shape-error``: quick, normal, careful, and 1 nm, which is the slowest that can be asked for.
Errors are mean distances to the true surface. Time is that of the processor, from seeds to end.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from napari_deltamic.cli import build_parser
from napari_deltamic.cli.inputs import gather
from napari_deltamic.cli.messages import Notes
from napari_deltamic.fitting.job import start
from napari_deltamic.measure import surface_distance

from .defaults.scenes import Recipe, Scene, rng_of, scene_of
from .figure import Row, at_least, at_most
from .page import put_between, table
from .tree import commit

COUNTS = (1, 1, 1, 1, 1, 1, 1, 1, 2, 2, 2, 3, 4, 4, 6, 8, 8, 12, 16, 16, 24, 32, 64, 100)
SLOWEST = "1nm"
CHOICES = ("quick", "normal", "careful", SLOWEST)
MANY = 32  # cells from which on the slowest is not waited for
WITHIN, OF_SLOWEST, QUICK = 1.25, 1.15, 0.1
NANOMETRES = 1000  # in a um
Found = dict[str, dict[str, float]]


@dataclass(frozen=True)
class Measured:
    """A scene: its cells and, for each choice, nanometres and seconds."""

    name: str
    cells: int
    found: Found


def scene(number: int, code: str) -> Scene:
    """One of the 24; odd ones follow the commit."""
    rng, count = rng_of("dial", number, code), COUNTS[number]
    radius = rng.uniform(5, 8) if count > 1 else rng.uniform(6, 16)
    recipe = Recipe(
        photons=float(np.exp(rng.uniform(np.log(15), np.log(300)))),
        psf=(rng.uniform(1, 1.8), rng.uniform(0.9, 1.4)),
        seeds="labels",
        roughness=rng.uniform(0.03, 0.15) if count == 1 else 0.05,
    )
    if count == 1:
        side = int(2.6 * radius + 14)
        aspect = rng.uniform(1, 3) if number % 3 == 2 else 1.0
        shape = (int(2.6 * radius / aspect + 12), side, side)
        given = {"cells": ((0, 0, 0, radius),), "shape": shape, "aspect": aspect}
        return scene_of(f"{number}: 1 cell", replace(recipe, **given), rng)
    # Places that repel each other evenly, so that cells are of about one size.
    reach = 0.86 * radius * count ** (1 / 3)
    cloud = rng.uniform(-1, 1, (6000, 3))
    cloud = cloud[(cloud**2).sum(1) < 1] * max(reach - 0.6 * radius, 0.6 * radius)
    places = cloud[:count]
    for _ in range(20):
        nearest = ((cloud[:, None] - places) ** 2).sum(2).argmin(1)
        places = np.array([cloud[nearest == k].mean(0) for k in range(count)])
    cells = tuple((*p.tolist(), radius * rng.uniform(0.93, 1.07)) for p in places)
    side = int(2 * max(reach, 1.6 * radius) + 14)
    recipe = replace(
        recipe,
        cells=cells,
        seeded=tuple(range(1, count + 1)),
        together=True,
        shape=(side, side, side),
    )
    return scene_of(f"{number}: {count} cells", recipe, rng)


def measured(number: int, code: str, folder: Path) -> Measured:
    """One scene at every choice."""
    known, cells = scene(number, code), COUNTS[number]
    image, labels = folder / f"{number}.tif", folder / f"{number}_labels.tif"
    tifffile.imwrite(image, known.image)
    tifffile.imwrite(labels, known.labels.astype(np.uint16))
    size = [str(side) for side in known.voxel_size]
    found: Found = {}
    for choice in CHOICES if cells < MANY else CHOICES[:-1]:
        words = ["fit", str(image), "--voxel-size", *size, "--seeds", str(labels)]
        words += ["--shape-error", choice, "-o", "none"]
        notes, began = Notes(), time.process_time()
        with notes.catching_warnings():
            job = gather(build_parser().parse_args(words), notes)
            *_, state = start(job)
        seconds = time.process_time() - began
        error = surface_distance(state.mesh, known.truth, samples=6000).mean
        found[choice] = {
            "predicted": NANOMETRES * float(job.predicted or np.nan),
            "measured": NANOMETRES * error,
            "seconds": seconds,
        }
    return Measured(known.name, cells, found)


def line(one: Measured) -> str:
    """A scene as a line of markdown."""
    cells = []
    for choice in CHOICES:
        told = one.found.get(choice)
        words = "{predicted:.1f}, {measured:.1f}, {seconds:.1f}"
        cells.append("-" if told is None else words.format(**told))
    return f"| {one.name} | " + " | ".join(cells) + " |"


def rows_of(scenes: Sequence[Measured]) -> list[Row]:
    """What was asked."""
    rows, count = [], len(scenes)
    for choice in CHOICES[:-1]:
        each = [s.found[choice] for s in scenes]
        ratio = np.array([e["predicted"] / e["measured"] for e in each])
        within = int(((ratio < WITHIN) & (ratio > 1 / WITHIN)).sum())
        note = f"predicted over measured {np.median(ratio):.2f} in the median, {ratio.min():.2f} "
        note += f"to {ratio.max():.2f}"
        wanted = round(20 / 24 * count)
        figure = f"{choice}: error predicted within {WITHIN:g} times"
        rows.append(at_least(figure, wanted, within, f"of {count}", note))
    both = [s.found for s in scenes if SLOWEST in s.found]
    off = [f["careful"]["measured"] / f[SLOWEST]["measured"] for f in both]
    note = f"median {np.median(off):.2f}, {len(both)} scenes"
    rows.append(at_most("careful over the slowest, error, worst", OF_SLOWEST, max(off), "", note))
    time_of = [s.found["quick"]["seconds"] / s.found["careful"]["seconds"] for s in scenes]
    note = f"median {np.median(time_of):.2f}, least {min(time_of):.2f}"
    rows.append(at_most("quick over careful, time, worst", QUICK, max(time_of), "", note))
    return rows


def main(argv: Sequence[str]) -> int:
    """Returns 1 if a figure falls short of what was asked."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.dial", description=__doc__)
    parser.add_argument("--only", nargs="+", type=int, metavar="NUMBER", help="of scenes, from 0")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--page", type=Path, metavar="FILE", help="whose figures are replaced")
    chosen = parser.parse_args(argv)
    code, scenes = commit(), []
    with tempfile.TemporaryDirectory() as name:
        for number in chosen.only or range(len(COUNTS)):
            scenes.append(measured(number, code, Path(name)))
            print(line(scenes[-1]), flush=True)
            if chosen.json:
                facts: list[Any] = [{"name": s.name, "found": s.found} for s in scenes]
                chosen.json.write_text(json.dumps(facts, indent=1) + "\n")
    head = "| scene: nm predicted, nm measured, s | " + " | ".join(CHOICES) + " |\n|---|"
    every = head + "---:|" * len(CHOICES) + "\n" + "\n".join(map(line, scenes))
    rows = rows_of(scenes)
    print(table(rows))
    if chosen.page is not None:
        put_between(chosen.page, "dial", f"{table(rows)}\n\n{every}")
    return 1 if any(row.passed is False for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
