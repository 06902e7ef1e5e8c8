"""Runs that are ended: what they had reached must be there, whole, and the next run must go on.

Fits are killed (SIGKILL) or interrupted (SIGINT) after iterations, with half a file written, and
before and after files are replaced, in folders that are new or hold older results. After each, the
report must tell of the meshes beside it or be gone, a checkpoint that was there must be there and
be good, and what is half written must go with the next run.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from napari_deltamic import InputError, load_mesh
from napari_deltamic.fitting.model.state import load_checkpoint
from napari_deltamic.images.stacks import read_image
from napari_deltamic.runs.settings import RunSettings

from .killed import PLACES
from .samples import samples

SECONDS = 120.0  # that a run may take
ITERATIONS = 4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Those of this experiment."""
    parser.add_argument("--count", type=int, default=40, help="runs that are ended")


def run(arguments: argparse.Namespace) -> int:
    """End runs and print what became of them."""
    found, troubles = attempt(arguments.count, arguments.seed)
    said = ", ".join(f"{n} {what}" for what, n in sorted(found.items()))
    print(f"kills: {arguments.count} runs: {said}")
    for trouble in troubles:
        print(trouble)
    return int(bool(troubles))


def attempt(count: int, seed: int = 0) -> tuple[Counter[str], list[str]]:
    """How many runs were killed, interrupted or came to their end, and what went wrong."""
    found: Counter[str] = Counter()
    troubles: list[str] = []
    with tempfile.TemporaryDirectory(prefix="robustness-") as name:
        folder = Path(name)
        (folder / "good").mkdir()
        samples(folder / "good")
        for number in range(count):
            random = np.random.default_rng([seed, number])
            place = PLACES[number % len(PLACES)]
            told = "SIGINT" if random.random() < 0.3 else "SIGKILL"
            # A folder is used for eight runs, and then another.
            out = folder / f"out{number // 8}"
            time = int(random.integers(1, ITERATIONS + 1 if place == "iteration" else 14))
            what, trouble = _ended(folder / "good", out, place, time, told)
            found[what] += 1
            troubles += [f"run {number}, {told} at {place} {time}: {t}" for t in trouble]
    return found, troubles


def _ended(good: Path, out: Path, place: str, time: int, told: str) -> tuple[str, list[str]]:
    before = (out / "checkpoint.npz").exists()
    words = _words(good, out, "--overwrite")
    command = [sys.executable, "-m", f"{__package__}.killed", place, str(time), told, *words]
    done = _run(command)
    trouble = _flaws(out, done)
    if before and done.returncode < 0 and not (out / "checkpoint.npz").exists():
        trouble.append("the checkpoint is gone")
    if done.returncode == 130 and not any(
        (out / n).exists() for n in ("checkpoint.npz", "report.json")
    ):
        trouble.append("interrupted, and nothing is left")
    if (out / "checkpoint.npz").exists():
        trouble += _goes_on(out)
    left = [path.name for path in out.glob(".*")] if out.exists() else []
    if (out / "checkpoint.npz").exists() and left:
        trouble.append(f"{left} are still there after the next run")
    if done.returncode == -signal.SIGKILL:
        return "killed", trouble
    return {0: "not reached", 130: "interrupted"}.get(done.returncode, "failed"), trouble


def _words(good: Path, out: Path, *more: str) -> list[str]:
    words = ["fit", str(good / "image.tif"), "--seeds", str(good / "mesh.ply"), "--sigma", "0.36"]
    words += ["0.24", "0.24", "--levels", "2", "1", "--max-iterations", str(ITERATIONS)]
    return [*words, *more, "-o", str(out)]


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        command, capture_output=True, text=True, env=env, timeout=SECONDS, check=False
    )


def _flaws(out: Path, done: subprocess.CompletedProcess[str]) -> list[str]:
    """What is wrong in a folder after a run that was ended."""
    found = []
    if done.returncode not in (0, 130, -signal.SIGKILL):
        found.append(f"it ended with {done.returncode}: {done.stderr[-300:]}")
    if "Traceback" in done.stderr:
        found.append(f"a traceback: {done.stderr[-600:]}")
    try:
        if (out / "report.json").exists():
            report = json.loads((out / "report.json").read_text())
            mesh = load_mesh(out / "mesh.ply")
            if report["mesh"]["vertices"] != len(mesh.vertices):
                found.append("the report tells of another mesh")
            if read_image(out / "rendered.tif")[0].shape != tuple(report["grid"]["shape"]):
                found.append("the report tells of another image")
        if (out / "checkpoint.npz").exists():
            load_checkpoint(out / "checkpoint.npz")
            RunSettings.from_toml(out / "run.toml")
    except (InputError, OSError, ValueError, KeyError) as error:
        found.append(f"what is there is damaged: {error}")
    return found


def _goes_on(out: Path) -> list[str]:
    words = ["fit", "--settings", str(out / "run.toml"), "--resume", str(out / "checkpoint.npz")]
    words += ["--max-iterations", str(ITERATIONS + 2), "--overwrite", "-o", str(out)]
    done = _run([sys.executable, "-m", "napari_deltamic", *words])
    if done.returncode:
        return [f"it does not go on: {done.stderr[-300:]}"]
    return _flaws(out, done)
