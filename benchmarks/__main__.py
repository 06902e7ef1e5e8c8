"""Measures the figures and prints one table: ``python -m benchmarks --help``."""

from __future__ import annotations

import argparse
import importlib
import json
import math
import os
import platform
import shlex
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from napari_deltamic.accuracy.machine_costs import processor

from .figure import Figure, MissingData, Options, Row, default_data_folder
from .page import HEADINGS, cells, put_between, table
from .tree import commit

# Each exposes FIGURES: dict[str, Callable[[Options], list[Row]]].
MODULES = ("engine", "rendering", "fits", "vesicles", "event_loop")
LIBRARIES = ("napari-deltamic", "torch", "numpy", "scipy")


def find_figures() -> dict[str, Figure]:
    """Name -> figure, of every module that is there."""
    figures: dict[str, Figure] = {}
    for name in MODULES:
        if (Path(__file__).parent / f"{name}.py").is_file():
            figures.update(importlib.import_module(f"{__package__}.{name}").FIGURES)
    return figures


def measure(figure: Figure, name: str, options: Options) -> list[Row]:
    """The rows of a figure; one that says why where it cannot be measured."""
    try:
        return figure(options)
    except MissingData as missing:
        return [Row(name, "", math.nan, "", None, str(missing))]


def machine(only: list[str] | None, quick: bool) -> dict[str, str]:
    """Where and how the figures were measured."""
    arguments = (["--only", *only] if only else []) + (["--quick"] if quick else [])
    found: dict[str, str] = {
        "command": shlex.join(["python", "-m", "benchmarks", *arguments]),
        "commit": commit()[:7] or "unknown",
        "date": time.strftime("%Y-%m-%d %H:%M"),
        "processor": processor(),
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "waiting threads": f"OMP_WAIT_POLICY={os.environ.get('OMP_WAIT_POLICY', 'not set')}",
    }
    if hasattr(os, "getloadavg"):
        found["load average at the start"] = ", ".join(f"{a:.2f}" for a in os.getloadavg())
    for library in LIBRARIES:
        try:
            found[library] = version(library)
        except PackageNotFoundError:
            found[library] = "not installed"
    return found


def as_table(rows: list[Row]) -> str:
    """Aligned columns of text."""
    lines_of = [HEADINGS, *(cells(row) for row in rows)]
    widths = [max(len(line[i]) for line in lines_of) for i in range(len(HEADINGS) - 1)]
    lines = []
    for line in lines_of:
        padded = [
            c.rjust(w) if i == 2 else c.ljust(w)
            for i, (c, w) in enumerate(zip(line[:-1], widths, strict=True))
        ]
        lines.append("  ".join([*padded, line[-1]]).rstrip())
    return "\n".join(lines)


def _for_json(row: Row) -> dict[str, Any]:
    entry = asdict(row)
    if math.isnan(row.measured):
        entry["measured"] = None  # JSON has no NaN
    return entry


def main(argv: Sequence[str]) -> int:
    """Returns 1 if a figure falls short of what was asked, 2 on bad usage."""
    figures = find_figures()
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--only", nargs="+", metavar="NAME", help=f"of {', '.join(figures)}")
    parser.add_argument("--quick", action="store_true", help="fewer repeats, smaller problems")
    parser.add_argument(
        "--data", type=Path, default=default_data_folder(), help="meshes and images"
    )
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--page", type=Path, metavar="FILE", help="whose figures are replaced")
    chosen = parser.parse_args(argv)
    names = chosen.only or list(figures)
    unknown = [name for name in names if name not in figures]
    if unknown:
        parser.error(f"no figure named {', '.join(unknown)}; there are {', '.join(figures)}")
    options = Options(chosen.quick, chosen.data)
    where = machine(chosen.only, chosen.quick)
    rows: list[Row] = []
    taken: dict[str, float] = {}
    for name in names:
        print(f"{name} ...", file=sys.stderr, flush=True)
        start = time.perf_counter()
        rows += measure(figures[name], name, options)
        taken[name] = time.perf_counter() - start
    print("\n".join(f"{name}: {value}" for name, value in where.items()))
    print(f"\n{as_table(rows)}")
    if chosen.json:
        entry = {"where": where, "seconds": taken, "rows": [_for_json(row) for row in rows]}
        chosen.json.write_text(json.dumps(entry, indent=1) + "\n")
    if chosen.page:
        put_between(chosen.page, "figures", table(rows))
    return 1 if any(row.passed is False for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
