"""Tasks that run in a process of their own, in the present interpreter or in the baseline's."""

from __future__ import annotations

import hashlib
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any, Literal

import numpy as np

from napari_deltamic import Mesh

from ..figure import Options

Side = Literal["baseline", "present"]
SIDES: tuple[Side, ...] = ("baseline", "present")
_CHILD = Path(__file__).with_name("child.py")
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMEXPR_NUM_THREADS")


@dataclass(frozen=True)
class Job:
    """What a child does.

    name : unique within the case; the outcome is kept under it.
    task : one of ``child.TASKS``.
    arrays, values : its input; meshes go in by :func:`mesh_arrays`.
    """

    name: str
    task: str
    arrays: Mapping[str, Any]
    values: Mapping[str, Any]


@dataclass(frozen=True)
class Outcome:
    """What a child found: values, arrays, and why it failed if it did."""

    values: dict[str, Any]
    arrays: dict[str, Any]

    @property
    def failed(self) -> str:
        """The error in a line; empty if there was none."""
        return str(self.values.get("failed", ""))

    @property
    def peak_gb(self) -> float:
        """Most memory that the process held, GB; nan where it did not say."""
        return self.values.get("peak_bytes", math.nan) / 1e9

    def mesh(self, name: str = "mesh") -> Mesh:
        """A mesh of the outcome."""
        return Mesh(*(self.arrays[f"{name}_{part}"] for part in ("vertices", "faces", "regions")))

    def number(self, name: str) -> float:
        """A value; nan where the child failed."""
        return float(self.values.get(name, math.nan))


@dataclass(frozen=True)
class Pair:
    """The outcomes of a job on both sides, one for each round; a side may be missing."""

    each: dict[Side, list[Outcome]]

    def first(self, side: Side) -> Outcome | None:
        """The outcome of the first round."""
        return self.each[side][0] if self.each.get(side) else None

    def median(self, side: Side, name: str) -> float:
        """Of a value over the rounds; of lists, over all their entries."""
        found = [o.values[name] for o in self.each.get(side, ()) if not o.failed]
        flat = np.concatenate([np.atleast_1d(f) for f in found]) if found else np.array([np.nan])
        return float(median(flat.tolist()))


@dataclass(frozen=True)
class Bench(Options):
    """How both sides are measured.

    baseline : the interpreter of the older build; None measures the present one alone.
    threads : of each child.
    seed : from which every simulated scene follows.
    cells : of the largest foam.
    reuse : a folder in which outcomes of the baseline are kept and not measured again.
    sides : those to be measured.
    """

    baseline: Path | None = None
    threads: int = 2
    seed: int = 0
    cells: int = 1000
    reuse: Path | None = None
    sides: tuple[Side, ...] = SIDES
    folder: Path = field(default_factory=lambda: Path(tempfile.gettempdir()))

    def both(
        self, job: Job, rounds: int = 1, threads: int | None = None, only: Side | None = None
    ) -> Pair:
        """Run a job on both sides in turn, so that a busy moment of the machine meets both."""
        each: dict[Side, list[Outcome]] = {}
        for _ in range(rounds):
            for side in self.sides:
                if only in (None, side) and self.python(side) is not None:
                    each.setdefault(side, []).append(self.run(job, side, threads))
        return Pair(each)

    def python(self, side: Side) -> Path | None:
        """The interpreter of a side."""
        return self.baseline if side == "baseline" else Path(sys.executable)

    def run(self, job: Job, side: Side, threads: int | None = None) -> Outcome:
        """One run of a job on one side."""
        count = threads or self.threads
        kept = self._kept(job, count) if side == "baseline" and self.reuse else None
        if kept is not None and (kept / "outcome.json").is_file():
            return _read(kept)
        with tempfile.TemporaryDirectory(dir=self.folder) as name:
            folder = Path(name)
            np.savez(folder / "input.npz", **job.arrays)
            (folder / "job.json").write_text(json.dumps({"task": job.task, **job.values}))
            python, began = self.python(side), time.perf_counter()
            assert python is not None, "a side without an interpreter is not measured"
            done = subprocess.run(
                [str(python), "-P", str(_CHILD), name],
                env=_environment(count, folder),
                cwd=folder,
                capture_output=True,
                text=True,
            )
            took = time.perf_counter() - began
            print(f"  {job.name}, {side}: {took:.0f} s in all", file=sys.stderr, flush=True)
            told = (done.stderr.strip().splitlines() or [""])[-1]
            if done.returncode != 0:
                return Outcome({"failed": f"exit {done.returncode}: {told}"}, {})
            outcome = _read(folder)
            if outcome.failed:
                print(f"{job.name}, {side}: {done.stderr.strip()}", file=sys.stderr, flush=True)
            elif kept is not None:
                kept.mkdir(parents=True, exist_ok=True)
                for file in ("outcome.npz", "outcome.json"):
                    shutil.copy(folder / file, kept / file)
            return outcome

    def _kept(self, job: Job, threads: int) -> Path:
        assert self.reuse is not None
        told = json.dumps([job.task, dict(job.values), self.seed, threads], sort_keys=True)
        return self.reuse / job.name / hashlib.sha256(told.encode()).hexdigest()[:12]


def _environment(threads: int, folder: Path) -> dict[str, str]:
    """The own one, with a fixed number of threads, and without what would mix the two builds.

    Costs of this machine that one of them has kept would be among these.
    """
    kept = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}
    return {**kept, **dict.fromkeys(_THREADS, str(threads)), "DELTAMIC_CACHE": str(folder)}


def _read(folder: Path) -> Outcome:
    with np.load(folder / "outcome.npz") as file:
        return Outcome(json.loads((folder / "outcome.json").read_text()), dict(file))


def mesh_arrays(mesh: Mesh, name: str = "start") -> dict[str, Any]:
    """A mesh as arrays of a job."""
    return {
        f"{name}_vertices": mesh.vertices_numpy(),
        f"{name}_faces": mesh.faces,
        f"{name}_regions": mesh.regions,
    }


def fit_job(
    name: str,
    image: Any,
    voxel_size: tuple[float, float, float],
    sigma: Any,
    start: Mesh | None = None,
    *,
    labels: Any = None,
    near: bool | None = None,
    settings: Mapping[str, Any] | None = None,
    arrays: Mapping[str, Any] | None = None,
    **values: Any,
) -> Job:
    """A fit from a mesh, or from labels of which each side makes its own mesh.

    ``near``: whether the start lies near the membranes, as that from labels does.
    """
    begin = {"labels": labels} if start is None else mesh_arrays(start)
    return Job(
        name,
        "fit",
        {"image": image, **begin, **(arrays or {})},
        {
            "voxel_size": list(voxel_size),
            "sigma": [float(s) for s in np.broadcast_to(sigma, 3)],
            "labels": start is None,
            "near": start is None if near is None else near,
            "settings": dict(settings or {}),
            **values,
        },
    )
