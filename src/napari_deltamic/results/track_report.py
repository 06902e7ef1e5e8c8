"""Writes the results of tracking: a mesh a frame, tracks, lineage, settings, report."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import warnings
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from ..common.reading import json_values, read_text, reading
from ..common.version import version_of
from ..common.writing import make_folder, write_atomically
from ..errors import InputError, RepairWarning
from ..geometry import Mesh, load_mesh, save_mesh
from ..measure.tracks import TRACK_COLUMNS, measure_tracks
from ..runs.track_run import TrackRun
from ..scene import Grid
from ..tracking import FrameResult, lineage, surface_4d
from ..tracking.track_rules import RULES
from .report import PACKAGES, plain_values
from .rules_of_a_fit import rules_of_a_fit

MESH_KINDS = (".ply", ".vtk")  # the first is exact, with regions; the second plays in viewers
FILES = ("tracks.csv", "surface.npz", "run.toml", "report.json")
_MESH = re.compile(r"mesh_t\d+\.(ply|vtk)")


def mesh_name(frame: int, kind: str = ".ply") -> str:
    """Return the name of the mesh file of a frame."""
    return f"mesh_t{frame:03d}{kind}"


def write_frame(folder: str | os.PathLike[str], result: FrameResult) -> list[Path]:
    """Write the mesh of a frame in each of ``MESH_KINDS``; nothing for one that was left out."""
    if result.mesh is None:
        return []
    paths = [Path(folder) / mesh_name(result.frame, kind) for kind in MESH_KINDS]
    for path in paths:
        save_mesh(result.mesh, path)
    return paths


def forget_others(folder: str | os.PathLike[str], results: Sequence[FrameResult]) -> None:
    """Remove an earlier run's surface and its meshes of frames that have no mesh now."""
    own = {mesh_name(r.frame, kind) for r in results if r.mesh is not None for kind in MESH_KINDS}
    for path in Path(folder).glob("mesh_t*"):
        if _MESH.fullmatch(path.name) and path.name not in own:
            path.unlink(missing_ok=True)
    (Path(folder) / FILES[1]).unlink(missing_ok=True)


def write_tracks(
    folder: str | os.PathLike[str],
    results: Sequence[FrameResult],
    grid: Grid,
    settings: TrackRun,
    seconds: float,
    *,
    warnings: Sequence[str] = (),
    surface: bool = True,
) -> list[Path]:
    """Write what belongs to all frames; the meshes are written by :func:`write_frame`.

    ``tracks.csv`` (one row for each cell in each frame), ``surface.npz`` (one 4D surface: vertices
    T Z Y X, faces, cells; T counts frames, the rest is um), ``run.toml`` (re-runs identically) and
    ``report.json`` (frames, lineage, events), from which :func:`read_results` goes on.

    Parameters
    ----------
    seconds : how long tracking took.
    surface : False leaves ``surface.npz`` out, for example while frames are still to come.

    Raises
    ------
    InputError
        If the folder or a file cannot be written.
    """
    folder = Path(folder)
    make_folder(folder)
    tracks, npz, toml, report = (folder / name for name in FILES)
    write_atomically(tracks, tracks_csv(results).encode())
    paths = [tracks]
    if surface and any(r.mesh is not None for r in results):
        vertices, faces, cells = surface_4d(results)
        buffer = io.BytesIO()
        np.savez_compressed(buffer, vertices=vertices, faces=faces, cells=cells)
        write_atomically(npz, buffer.getvalue())
        paths.append(npz)
    write_atomically(toml, settings.to_toml().encode())
    facts = plain_values(_facts(results, grid, settings, seconds, warnings))
    write_atomically(report, (json.dumps(facts, indent=2, allow_nan=False) + "\n").encode())
    return [*paths, toml, report]


def tracks_csv(results: Sequence[FrameResult]) -> str:
    """Return the table of ``measure_tracks`` as text; unknown numbers are empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, TRACK_COLUMNS, lineterminator="\n")
    writer.writeheader()
    for row in measure_tracks(results):
        writer.writerow({k: "" if v != v else v for k, v in row.items()})
    return text.getvalue()


def holds_tracks(folder: str | os.PathLike[str]) -> bool:
    """Whether ``track`` wrote its results to a folder."""
    return all((Path(folder) / name).is_file() for name in ("tracks.csv", "report.json"))


def read_results(folder: str | os.PathLike[str]) -> list[FrameResult]:
    """Read the frames that a run has written, to go on from.

    Raises
    ------
    InputError
        If there is no report of tracking, or a mesh of it is missing or damaged.
    """
    folder = Path(folder)
    path = folder / FILES[-1]
    with reading("tracks", path):
        values = json_values(read_text(path))
    try:
        frames = _FRAMES.validate_python(values["frames"])
        used = [bool(facts["used"]) for facts in values["frames"]]
    except (LookupError, TypeError, ValueError):
        raise InputError(f"{path} is not a report of tracking") from None
    return [
        replace(r, mesh=_mesh(folder, r.frame)) if there else r
        for r, there in zip(frames, used, strict=True)
    ]


_FRAMES: TypeAdapter[list[FrameResult]] = TypeAdapter(list[FrameResult])


def _mesh(folder: Path, frame: int) -> Mesh:
    with warnings.catch_warnings():
        # The meshes of a fit may have flaws, which are not news.
        warnings.simplefilter("ignore", RepairWarning)
        return load_mesh(folder / mesh_name(frame))


def _frames(results: Sequence[FrameResult]) -> list[dict[str, Any]]:
    """Return the frames as the report holds them; used : whether a frame was not left out."""
    plain = _FRAMES.dump_python(list(results), by_alias=True, warnings=False)
    return [
        {**facts, "seconds": round(r.seconds, 3), "used": r.mesh is not None, "cells": r.cells}
        for facts, r in zip(plain, results, strict=True)
    ]


def _facts(
    results: Sequence[FrameResult],
    grid: Grid,
    settings: TrackRun,
    seconds: float,
    remarks: Sequence[str],
) -> dict[str, Any]:
    return {
        "version": version_of("napari-deltamic"),
        "seconds": round(seconds, 3),
        "rules": {**rules_of_a_fit(), "tracking": asdict(RULES)},
        "warnings": list(remarks),
        "frames": _frames(results),
        "lineage": [
            {"cell": c.cell, "parent": c.parent, "first": c.first, "last": c.last, "end": c.end}
            for c in lineage(results)
        ],
        "grid": grid.as_plain(),
        "settings": settings.model_dump(mode="json"),
        "versions": {name: version_of(name) for name in PACKAGES},
    }
