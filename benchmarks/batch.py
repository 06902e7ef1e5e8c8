"""Many fits: two processes against one, kills and a resume, and a worker that dies.

``python -m benchmarks.batch --page docs/batch.md``. 64 simulated cells, each a stack of its own
with labels to start from, are fitted with default settings: by one process of one thread and by
two. 16 of them are fitted once more by a run that is killed (SIGKILL) at random moments and started
again each time, and by one whose worker is killed. The tables of all of them must be equal to the
last byte. The ratio of the times says something only on a machine with two cores that does nothing
else; the load before is printed beside it.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.images.stacks import write_image

from .figure import Row, at_least
from .page import put_between, table

VOXEL, SIGMA, PHOTONS = 0.25, 0.3, 40.0  # um, um, in the brightest voxel
SHAPE = (36, 44, 44)
KILLS, KILLED = 5, 16  # how often, and over how many cells
TABLES = ("summary.csv", "cells.csv")


@dataclass(frozen=True)
class Ended:
    """A run that came to its end, or was killed."""

    code: int
    seconds: float
    said: str


def make_stacks(folder: Path, count: int) -> None:
    """Cells of other half axes, places and bumps, each with its true labels."""
    grid = nd.Grid(SHAPE, (VOXEL,) * 3)
    middle = np.mean(grid.extent, axis=0)
    optics = nd.GaussianPSF((SIGMA,) * 3)
    for k in range(count):
        rng = np.random.default_rng(k)
        ball = sphere((0, 0, 0), 1.0, edge_length=0.08)
        v = ball.vertices_numpy()
        bumps = 1 + 0.1 * np.sin(v @ rng.normal(0, 2, 3) + rng.uniform(0, 6))
        place = middle + rng.uniform(-0.3, 0.3, 3)
        mesh = ball.with_vertices(v * bumps[:, None] * rng.uniform(2.2, 3.2, 3) + place)
        scene = nd.Scene((nd.Surface(mesh),), optics)
        made = nd.simulate(scene, grid, photons=PHOTONS, background=4.0, seed=k)
        assert made.labels is not None
        write_image(folder / f"cell{k:02d}.tif", made.image.astype(np.float32), grid.voxel_size)
        labels = made.labels.astype(np.uint16)
        write_image(folder / f"cell{k:02d}_labels.tif", labels, grid.voxel_size)


class Batch:
    """The command, on one folder of stacks."""

    def __init__(self, stacks: Path) -> None:
        self.stacks = stacks

    def part(self, folder: Path, count: int) -> Batch:
        """The same on the first stacks."""
        folder.mkdir()
        for path in sorted(self.stacks.iterdir())[: 2 * count]:  # images and labels
            (folder / path.name).hardlink_to(path)
        return Batch(folder)

    def start(self, out: Path, workers: int) -> subprocess.Popen[str]:
        """The command under way, in a process group of its own."""
        words = ["batch", self.stacks, "--seeds", "{stem}_labels.tif", "--workers", workers]
        words += ["--sigma", SIGMA, SIGMA, SIGMA, "-o", out]
        return subprocess.Popen(
            [sys.executable, "-m", "napari_deltamic", *map(str, words)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
            start_new_session=True,
        )

    def run(self, out: Path, workers: int) -> Ended:
        """The command, to its end."""
        begin = time.monotonic()
        with self.start(out, workers) as process:
            said = process.communicate()[1]
        return Ended(process.returncode, time.monotonic() - begin, said)

    def killed(self, out: Path, workers: int, after: float) -> bool:
        """The command, killed after some seconds with all its processes; whether it still ran."""
        with self.start(out, workers) as process:
            try:
                process.communicate(timeout=after)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.communicate()
                return True
        return False


def same_tables(one: Path, other: Path) -> bool:
    """Whether two runs ended with the same text."""
    return all((one / n).read_bytes() == (other / n).read_bytes() for n in TABLES)


def workers_of(process: int) -> list[int]:
    """The processes that fit for a run: those below it that have a Dask worker's command line."""
    found = []
    for folder in Path("/proc").iterdir():
        try:
            parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
            line = (folder / "cmdline").read_bytes()
        except (OSError, ValueError, IndexError):
            continue
        if parent == process and b"spawn_main" in line:
            found.append(int(folder.name))
    return found


def worker_killed(batch: Batch, out: Path) -> tuple[Ended, int]:
    """A run one of whose workers is killed after the first fit, and how many were killed."""
    begin, killed = time.monotonic(), 0
    lines = []
    with batch.start(out, 2) as process:
        assert process.stderr is not None
        for line in process.stderr:
            lines.append(line)
            if not killed and line.startswith("1/"):
                for worker in workers_of(process.pid)[-1:]:
                    os.kill(worker, signal.SIGKILL)
                    killed += 1
    return Ended(process.returncode, time.monotonic() - begin, "".join(lines)), killed


def measured(folder: Path, count: int, seed: int) -> list[Row]:
    """All rows."""
    stacks = folder / "stacks"
    stacks.mkdir()
    make_stacks(stacks, count)
    batch = Batch(stacks)
    load = ", ".join(f"{a:.1f}" for a in os.getloadavg())
    one = batch.run(folder / "one", 1)
    two = batch.run(folder / "two", 2)
    note = f"{count} cells: {one.seconds:.0f} s and {two.seconds:.0f} s; load before: {load}"
    return [
        at_least("two processes against one", 1.8, one.seconds / two.seconds, "x", note),
        _yes("two processes: the same tables", same_tables(folder / "one", folder / "two")),
        *broken_off(batch.part(folder / "part", min(count, KILLED)), folder, seed),
    ]


def broken_off(batch: Batch, folder: Path, seed: int) -> list[Row]:
    """The rows of kills."""
    whole = folder / "whole"
    seconds = batch.run(whole, 2).seconds
    # Every start takes a few seconds before it goes on.
    share = np.random.default_rng(seed).uniform(0.1, 0.6, KILLS)
    hit = sum(batch.killed(folder / "killed", 2, seconds * float(s)) for s in share)
    last = batch.run(folder / "killed", 2)
    shares = ", ".join(f"{100 * s:.0f}" for s in share)
    words = f"{hit} of {KILLS} met it at work, after {shares} % of the time of a whole run"
    killed_well = last.code == 0 and hit == KILLS and same_tables(whole, folder / "killed")
    ended, killed = worker_killed(batch, folder / "worker")
    worker_well = ended.code == 0 and killed == 1 and same_tables(whole, folder / "worker")
    return [
        _yes("killed and resumed: the same tables", killed_well, words),
        _yes("a worker killed: finished, the same tables", worker_well, f"{killed} was killed"),
    ]


def _yes(figure: str, passed: bool, note: str = "") -> Row:
    return Row(figure, "yes", float(passed), "", passed, note)


def main(argv: Sequence[str]) -> int:
    """Returns 1 if a figure falls short of what was asked."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.batch", description=__doc__)
    parser.add_argument("--count", type=int, default=64, help="of cells")
    parser.add_argument("--seed", type=int, default=0, help="of the moments of kills")
    parser.add_argument("--page", type=Path, metavar="FILE", help="whose figures are replaced")
    chosen = parser.parse_args(argv)
    with tempfile.TemporaryDirectory(prefix="batch-") as name:
        rows = measured(Path(name), chosen.count, chosen.seed)
    print(table(rows))
    if chosen.page is not None:
        put_between(chosen.page, "batch", table(rows))
    return 1 if any(row.passed is False for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
