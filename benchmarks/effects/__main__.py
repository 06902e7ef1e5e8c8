"""Writes the figures of ``docs/effects.md``: ``python -m benchmarks.effects``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from ..__main__ import measure
from ..figure import Options, Row, default_data_folder
from ..page import put_between, table
from . import choice, optics, shape
from .pictures import effects_picture
from .real import real_table

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "effects.md"


def main(argv: Sequence[str]) -> int:
    """Returns 1 if a figure falls short of what was asked."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.effects", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=("shape", "choice", "real", "optics"))
    parser.add_argument("--quick", action="store_true", help="smaller problems")
    parser.add_argument("--scenes", type=int, default=200, metavar="N", help="of the choice")
    parser.add_argument(
        "--results", type=Path, default=ROOT / "build" / "effects_choice.jsonl", metavar="FILE"
    )
    parser.add_argument("--data", type=Path, default=default_data_folder())
    parser.add_argument("--write", action="store_true", help="put the tables into docs/effects.md")
    given = parser.parse_args(argv)
    options = Options(quick=given.quick, data=given.data)
    failed = False

    def rows_of(rows: list[Row]) -> str:
        nonlocal failed
        failed |= any(row.passed is False for row in rows)
        return table(rows)

    parts: dict[str, Callable[[], str]] = {
        "shape": lambda: shape.shape_table(given.quick),
        "choice": lambda: _choice(given.scenes, given.results, rows_of),
        "real": lambda: real_table(given.data),
        "optics": lambda: rows_of(
            [row for name, f in optics.FIGURES.items() for row in measure(f, name, options)]
        ),
    }
    for name in given.only or parts:
        print(f"{name} ...", file=sys.stderr, flush=True)
        text = parts[name]()
        print(f"{text}\n", flush=True)
        if given.write:
            put_between(PAGE, name, text)
        if given.write and name == "shape":
            effects_picture(PAGE.parent / "images" / "effects.png")
    return int(failed)


def _choice(scenes: int, results: Path, rows_of: Callable[[list[Row]], str]) -> str:
    """The figures of the simulated scenes, and each effect for itself."""
    measured = choice.run(scenes, results, processes=2)
    each = choice.by_effect(measured)
    lines = ["| " + " | ".join(each[0]) + " |", "|" + "---|" * len(each[0])]
    lines += ["| " + " | ".join(str(v) for v in one.values()) + " |" for one in each]
    return rows_of(choice.rows(measured)) + "\n\n" + "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
