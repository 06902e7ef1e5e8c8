"""Puts what was measured into a page of the docs, between two marks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from .figure import Row
from .tree import measured_on

HEADINGS = ("figure", "asked", "measured", "unit", "", "note")


def put_between(page: Path, name: str, text: str) -> None:
    """Replace what stands between ``<!-- name:begin -->`` and ``<!-- name:end -->``.

    Below it stands which tree was measured, when and where.
    """
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    before, found, rest = page.read_text(encoding="utf-8").partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise SystemExit(f"{page} has no marks for '{name}'")
    page.write_text(f"{before}{begin}\n{text}\n\n{measured_on()}\n{end}{after}", encoding="utf-8")


def cells(row: Row) -> tuple[str, ...]:
    """A row in words, one for each heading."""
    passed = {True: "yes", False: "NO", None: ""}[row.passed]
    measured = "-" if math.isnan(row.measured) else f"{row.measured:.4g}"
    return row.figure, row.asked, measured, row.unit, passed, row.note


def table(rows: Sequence[Row]) -> str:
    """The rows as a table in Markdown."""
    lines = [" | ".join(h or "passed" for h in HEADINGS), "---|---|---:|---|---|---"]
    lines += [" | ".join(c.replace("|", "\\|") for c in cells(row)) for row in rows]
    return "\n".join(f"| {line} |" if "---" not in line else f"|{line}|" for line in lines)
