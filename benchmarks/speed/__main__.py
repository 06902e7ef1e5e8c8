"""Both builds, case by case, in one table: ``python -m benchmarks.speed --help``.

``--baseline PYTHON`` names any interpreter in which an older build of napari_deltamic is installed;
without it the present tree is measured alone. Sizes and seeds of simulated scenes follow from the
commit that is measured, so that no figure is of scenes that the code was written on.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..figure import MissingData, default_data_folder
from ..page import put_between
from ..tree import commit
from . import (
    clusters,
    growing,
    images,
    nudges,
    others,
    psf,
    repeats,
    robustness,
    scatter,
    stacks,
    thousand,
)
from .jobs import SIDES, Bench
from .lines import Case, Line, table

ROOT = Path(__file__).resolve().parents[2]
CASES: dict[str, Case] = {
    name: case
    for module in (
        images,
        growing,
        robustness,
        clusters,
        stacks,
        thousand,
        repeats,
        scatter,
        nudges,
        psf,
        others,
    )
    for name, case in module.CASES.items()
}


def measured(name: str, bench: Bench) -> list[Line]:
    """The lines of a case; one that says why where it cannot be measured."""
    try:
        return CASES[name](bench)
    except MissingData as missing:
        return [Line(name, "", math.nan, math.nan, note=str(missing))]
    except Exception as error:  # the other cases are measured all the same
        traceback.print_exc()
        note = f"{type(error).__name__}: {error}"
        return [Line(name, "", math.nan, math.nan, passed=False, note=note)]


def main(argv: Sequence[str]) -> int:
    """Returns 1 if a figure falls short of what was asked."""
    chosen = _parsed(argv)
    head = commit()
    seed = int(head[:8] or "0", 16) if chosen.seed is None else chosen.seed
    kept: dict[str, Any] = json.loads(chosen.json.read_text()) if chosen.json.is_file() else {}
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(
            quick=chosen.quick,
            data=chosen.data,
            baseline=chosen.baseline,
            threads=chosen.threads,
            seed=seed,
            cells=chosen.cells,
            reuse=chosen.reuse,
            sides=tuple(chosen.sides),
            folder=Path(folder),
        )
        for name in chosen.only:
            print(f"{name} ...", file=sys.stderr, flush=True)
            began = time.perf_counter()
            lines = measured(name, bench)
            kept[name] = {
                "commit": head,
                "seed": seed,
                "quick": chosen.quick,
                "threads": chosen.threads,
                "load": [round(load, 1) for load in os.getloadavg()],
                "date": time.strftime("%Y-%m-%d %H:%M"),
                "seconds": round(time.perf_counter() - began, 1),
                "lines": [_plain(each) for each in lines],
            }
            print(table(lines), flush=True)
            chosen.json.parent.mkdir(parents=True, exist_ok=True)
            chosen.json.write_text(json.dumps(kept, indent=1) + "\n")
    if chosen.page:
        put_between(chosen.page, "speed", page(kept))
    now = [each for name in chosen.only for each in kept[name]["lines"]]
    return int(any(each["passed"] is False for each in now))


def page(kept: dict[str, Any]) -> str:
    """All that was ever measured into a results file, with the runs that it is of."""
    runs: dict[tuple[Any, ...], list[str]] = {}
    for name in CASES:
        if name in kept:
            run = kept[name]
            key = (run["commit"] or "unknown", run["seed"], run["quick"], run["threads"])
            runs.setdefault(key, []).append(name)
    told = [
        f"- commit `{head}`, seed {seed}, {threads} threads{', quick' if quick else ''}: "
        f"{', '.join(names)}"
        for (head, seed, quick, threads), names in runs.items()
    ]
    lines = [_line(each) for names in runs.values() for n in names for each in kept[n]["lines"]]
    return "\n".join([*told, "", table(lines)])


def _parsed(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.speed",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--baseline", type=Path, metavar="PYTHON", help="with an older build installed")
    add("--only", nargs="+", choices=tuple(CASES), default=tuple(CASES), metavar="NAME")
    add("--list", action="store_true", help="print the names of the cases and end")
    add("--quick", action="store_true", help="fewer and smaller problems")
    add("--threads", type=int, default=2, help="of each fit (default: 2)")
    add("--seed", type=int, help="of simulated scenes (default: from the commit)")
    add("--cells", type=int, default=1000, help="of the largest foam (default: 1000)")
    add("--sides", nargs="+", choices=SIDES, default=SIDES, help="to be measured")
    add(
        "--reuse",
        type=Path,
        metavar="FOLDER",
        help="keep the baseline's outcomes there and do not measure them again: for development, "
        "together with --seed; times of different runs are no ratio",
    )
    add("--data", type=Path, default=default_data_folder(), help="meshes and images")
    add("--json", type=Path, default=ROOT / "build" / "speed.json", help="results, case by case")
    add("--page", type=Path, metavar="FILE", help="whose table of all results is replaced")
    chosen = parser.parse_args(argv)
    if chosen.list:
        parser.exit(message="\n".join(CASES) + "\n")
    if chosen.baseline is not None:
        chosen.baseline = chosen.baseline.absolute()  # not resolved: a venv's Python is a link
        if not chosen.baseline.is_file():
            parser.error(f"no interpreter at {chosen.baseline}")
    return chosen


def _plain(each: Line) -> dict[str, Any]:
    return {k: None if v != v else v for k, v in asdict(each).items()}  # JSON has no nan


def _line(values: dict[str, Any]) -> Line:
    numbers = {k: math.nan if values[k] is None else values[k] for k in ("baseline", "present")}
    return Line(**{**values, **numbers})


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
