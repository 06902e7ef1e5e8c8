"""Tables of what a batch has found so far: one row an image, and the cells of all images."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..common.table import Value, csv_text
from ..common.writing import write_atomically

SUMMARY, CELLS, FAILED = "summary.csv", "cells.csv", "failed.txt"
DONE = "report.json"  # written last among the results of a fit
_COLUMNS = ("name", "image", "status", "cells", "explained", "iterations", "loss", "message")


def is_done(folder: Path) -> bool:
    """Whether all results of a fit are there."""
    return (folder / DONE).is_file() and (folder / "measurements.csv").is_file()


def write_tables(folder: Path, jobs: Sequence[tuple[str, str]]) -> list[Path]:
    """Write ``summary.csv`` and ``cells.csv`` from what lies in the folder.

    They do not say when and in which order fits were made: the same fits give the same text.

    Parameters
    ----------
    folder
        Holds a folder of results for each job.
    jobs
        Name and image of each, in the order of the rows.

    Raises
    ------
    InputError
        If they cannot be written.
    """
    summary: list[dict[str, Value]] = []
    cells: list[dict[str, Value]] = []
    columns = ["name"]
    for name, image in jobs:
        own = folder / name
        rows = _cells(own) if is_done(own) else []
        summary.append({"name": name, "image": image, **_told(own, len(rows))})
        for row in rows:
            columns += [key for key in row if key not in columns]
            cells.append({"name": name, **row})
    filled = [{key: row.get(key) for key in columns} for row in cells]
    paths = [folder / SUMMARY, folder / CELLS]
    for path, names, table in zip(paths, (_COLUMNS, columns), (summary, filled), strict=True):
        write_atomically(path, csv_text(list(names), table).encode())
    return paths


def _told(folder: Path, cells: int) -> dict[str, Value]:
    if not is_done(folder):
        failed = folder / FAILED
        message = failed.read_text(encoding="utf-8").strip() if failed.is_file() else ""
        status = "failed" if message else "not done"
        return {**dict.fromkeys(_COLUMNS[3:]), "status": status, "message": message}
    try:
        report: dict[str, Any] = json.loads((folder / DONE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        report = {}
    residual = report.get("residual") or {}
    losses = report.get("loss") or [None]
    return {
        "status": "converged" if report.get("converged") else "ended",
        "cells": cells,
        "explained": residual.get("explained"),
        "iterations": report.get("iterations"),
        "loss": losses[-1],
        "message": "; ".join(filter(None, [report.get("message"), *report.get("warnings", ())])),
    }


def _cells(folder: Path) -> list[dict[str, str]]:
    with (folder / "measurements.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))
