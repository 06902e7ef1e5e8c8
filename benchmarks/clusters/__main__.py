"""Writes the figures and pictures of ``docs/clusters.md``: ``python -m benchmarks.clusters``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ..__main__ import measure
from ..figure import Figure, Options, Row, default_data_folder
from ..page import put_between, table
from . import embryo, foams, glands, known, random_motion, tracking, trials

PAGE = Path(__file__).resolve().parents[2] / "docs" / "clusters.md"
FIGURES: dict[str, Figure] = {
    name: figure
    for module in (known, foams, trials, embryo, glands, tracking, random_motion)
    for name, figure in module.FIGURES.items()
}


def main(argv: Sequence[str]) -> int:
    """Returns 1 if a figure falls short of what was asked."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.clusters", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=tuple(FIGURES), default=tuple(FIGURES))
    parser.add_argument("--quick", action="store_true", help="smaller problems")
    parser.add_argument("--data", type=Path, default=default_data_folder())
    parser.add_argument("--write", action="store_true", help="put table and pictures into docs/")
    given = parser.parse_args(argv)
    pictures = PAGE.parent / "images" if given.write else None
    options = Options(quick=given.quick, data=given.data, pictures=pictures)
    rows: list[Row] = []
    for name in given.only:
        print(f"{name} ...", file=sys.stderr, flush=True)
        rows += measure(FIGURES[name], name, options)
    text = table(rows)
    print(text)
    if given.write:
        put_between(PAGE, "figures", text)
    return int(any(row.passed is False for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
