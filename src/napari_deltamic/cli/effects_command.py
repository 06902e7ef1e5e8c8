"""``napari-deltamic effects``: which effects an image calls for, why, and what they cost."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..common.writing import write_atomically
from ..errors import failure
from ..evidence import Recommendation, recommend_for
from ..evidence.camera import Camera
from ..evidence.candidates import chosen_candidates
from ..evidence.estimate import Finding
from ..evidence.first_sigma import first_sigma
from ..evidence.slices import drift, fading
from ..fitting.job import FitInput
from ..results.report import plain_values
from ..scene.effects import Effects
from .inputs import gather
from .messages import Notes
from .recommending import as_plain, as_table


def run(arguments: argparse.Namespace, notes: Notes) -> int:
    """Read, fit and judge; prints a table, or JSON."""
    only = None
    if arguments.candidates is not None:
        only = [n.strip().replace("-", "_") for n in arguments.candidates.split(",") if n.strip()]
    chosen_candidates(only, Effects())  # refuses what is unknown before any work
    try:
        job = gather(arguments, notes)
        notes.release()
        found = recommend_for(job, candidates=only, progress=notes.add)
        hints = _hints(job)
    except (MemoryError, RuntimeError) as error:
        raise failure(error) from error
    facts = plain_values({**as_plain(found), "image": {k: asdict(f) for k, f in hints.items()}})
    text = json.dumps(facts, indent=2, allow_nan=False) + "\n"
    if arguments.json == "-":
        sys.stdout.write(text)
        return 0
    if arguments.json:
        write_atomically(Path(arguments.json), text.encode())
    for line in [as_table(found), *found.remarks, "", *_image_lines(found.camera, hints)]:
        print(line)
    _say_how(found)
    return 0


def _hints(job: FitInput) -> dict[str, Finding]:
    """What the image alone tells, except about the camera."""
    size = job.grid.voxel_size
    image = np.asarray(job.image)
    width = first_sigma(image, size)
    lean, jitter = drift(image, size)
    return {
        "sigma_z": width.z,
        "sigma_yx": width.yx,
        "fading_per_um": fading(image, size[0]),
        "lean": lean,
        "jitter": jitter,
    }


def _image_lines(camera: Camera, hints: dict[str, Finding]) -> list[str]:
    """What the image alone tells, one line each."""
    named = (
        ("gain", "per photon", camera.gain),
        ("read noise", "", camera.read_noise),
        ("offset", "", camera.offset),
        ("saturation", "", camera.saturation),
        ("first sigma along z", "um", hints["sigma_z"]),
        ("first sigma in the plane", "um", hints["sigma_yx"]),
        ("fading along z", "per um", hints["fading_per_um"]),
        ("lean of the slices", "um per um", hints["lean"]),
        ("slices out of place", "um", hints["jitter"]),
    )
    return [f"{name}: {_shown(finding, unit)}" for name, unit, finding in named]


def _shown(finding: Finding, unit: str) -> str:
    if finding.value is None:
        return f"not told ({finding.reason})"
    error = f" +- {finding.error:.2g}" if finding.error else ""
    return f"{finding.value:.4g}{error} {unit}".rstrip() + f" ({finding.reason})"


def _say_how(found: Recommendation) -> None:
    if found.recommended:
        names = ",".join(found.effects.names)
        print(f"to take them: napari-deltamic fit ... --effects {names}", file=sys.stderr)
