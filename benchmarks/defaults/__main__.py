"""What the default command makes of many kinds of images: ``python -m benchmarks.defaults``.

Every scene is rendered by a way of its own (`imaging`), written to a file, and fitted by the
command line with image, voxel size and seeds, and again with everything given that is true. Half of
the seeds of the scenes follow from the commit that is measured, so nothing can be tuned to them.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ..page import put_between
from ..page import table as table_of
from ..tree import commit
from .anything import ANYTHING
from .command import Outcome, fitted, renumbered
from .processing import BASES, PROCESSINGS
from .scenes import KINDS, made
from .scoring import Score, score
from .tables import figures, whole

HEAD = (
    f"{'scene':<26}{'error':>7}{'lat':>6}{'ax':>6}{'told':>7}{'volume':>8}{'swal':>5}{'lost':>5}"
    f"{'s':>6}{'told s':>7}  verdict"
)


def grade_of(report: dict[str, Any]) -> str:
    """good, fair, poor; of versions that know no grades, good where they say converged."""
    verdict = report.get("verdict")
    if isinstance(verdict, dict) and "grade" in verdict:
        return str(verdict["grade"])
    if not report:
        return "failed"
    return "good" if report.get("converged") else "poor"


def measured(
    kind: str,
    draw: int,
    commit: str,
    folder: Path,
    both: bool,
    patience: float,
    further: Sequence[str],
) -> Any:
    """One scene, as a row of plain values; further : words of the command."""
    scene = made(kind, draw, commit)
    results: dict[str, tuple[Outcome, Score]] = {}
    for told in (False, True) if both else (False,):
        outcome = fitted(scene, folder / scene.name, told, patience, further)
        mesh = None if outcome.mesh is None else outcome.mesh
        if mesh is not None and not (told and scene.strangers):
            mesh = renumbered(scene, mesh)
        results["told" if told else "default"] = outcome, score(scene, mesh)
    outcome, found = results["default"]
    row: dict[str, Any] = {"scene": scene.name, **asdict(found), "seconds": outcome.seconds}
    row |= {"grade": grade_of(outcome.report), "words": outcome.words}
    row["reasons"] = (outcome.report.get("verdict") or {}).get("reasons", [])
    if both:
        outcome, found = results["told"]
        row |= {"told": found.surface, "told_seconds": outcome.seconds, "told_words": outcome.words}
    return row


def line(row: dict[str, Any]) -> str:
    """A row of the table."""
    told, seconds = row.get("told", np.nan), row.get("told_seconds", np.nan)
    words = "; ".join(row["reasons"]) or row["words"]
    return (
        f"{row['scene']:<26}{row['surface']:7.3f}{row['lateral']:6.2f}{row['axial']:6.2f}{told:7.3f}"
        f"{100 * row['volume']:+7.1f}%{row['swallowed']:5d}{row['lost']:5d}{row['seconds']:6.0f}"
        f"{seconds:7.0f}  {row['grade']}: {words[:90]}"
    )


def main(argv: Sequence[str]) -> int:
    """Measure the scenes chosen; print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.defaults", description=__doc__)
    parser.add_argument("--only", nargs="+", metavar="KIND", help=f"of {', '.join(KINDS)}")
    parser.add_argument("--draws", type=int, default=3, help="scenes of each kind")
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--no-told", action="store_true", help="leave out the fit given the truth")
    parser.add_argument("--shape-error", metavar="E", help="a choice of the dial; default: normal")
    parser.add_argument("--patience", type=float, default=600, help="seconds for one fit")
    parser.add_argument("--folder", type=Path, help="where images and results stay")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--page", type=Path, metavar="FILE", help="whose tables are replaced")
    parser.add_argument(
        "--processed",
        nargs="*",
        metavar="HOW",
        help=f"after each of {', '.join(PROCESSINGS)}, or of those named; of {', '.join(BASES)}",
    )
    parser.add_argument(
        "--anything", type=int, metavar="N", help="N scenes in which all is random, not the kinds"
    )
    chosen = parser.parse_args(argv)
    names = chosen.only or list(KINDS if chosen.processed is None else BASES)
    unknown = [name for name in names if name not in KINDS]
    if unknown:
        parser.error(f"no kind named {', '.join(unknown)}; there are {', '.join(KINDS)}")
    if chosen.processed is not None:
        unknown = [how for how in chosen.processed if how not in PROCESSINGS]
        if unknown:
            parser.error(f"no {', '.join(unknown)}; there are {', '.join(PROCESSINGS)}")
        names = [f"{name}~{how}" for how in chosen.processed or PROCESSINGS for name in names]
    further = ["--shape-error", chosen.shape_error] if chosen.shape_error else []
    asked = [(n, d) for d in range(chosen.first, chosen.first + chosen.draws) for n in names]
    if chosen.anything is not None:  # odd draws follow from the commit
        if chosen.only or chosen.processed is not None:
            parser.error("--anything goes with neither --only nor --processed")
        asked = [(ANYTHING, 2 * k + 1) for k in range(chosen.first, chosen.first + chosen.anything)]
    measured_commit, rows = commit(), []
    print(f"commit {measured_commit}, {time.strftime('%Y-%m-%d %H:%M')}, {os.cpu_count()} cores")
    print(HEAD, flush=True)
    with tempfile.TemporaryDirectory() as temporary:
        folder = chosen.folder or Path(temporary)
        for name, draw in asked:
            given = folder, not chosen.no_told, chosen.patience, further
            rows.append(measured(name, draw, measured_commit, *given))
            print(line(rows[-1]), flush=True)
            if chosen.json:
                facts = {"commit": measured_commit, "rows": rows}
                chosen.json.write_text(json.dumps(facts, indent=1) + "\n")
    found = figures(rows)
    print("\n" + table_of(found))
    if chosen.page:
        section = "defaults" if chosen.processed is None else "processed"
        section = section if chosen.anything is None else ANYTHING
        put_between(chosen.page, section, whole(rows, section))
    return int(any(row.passed is False for row in found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
