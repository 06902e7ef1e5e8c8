"""Tables of measurements: columns that say what they hold, rows without NaN."""

from __future__ import annotations

import csv
import inspect
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

Value = int | float | str | None
Row = Mapping[str, Value]

_DIGITS = ".9g"  # more than any of the numbers is worth; the same text on every machine

# Endings of names; where several fit, the first one counts.
_UNITS = {
    "_per_um3": "1/um^3",
    "_per_um2": "1/um^2",
    "_per_um": "1/um",
    "_um3": "um^3",
    "_um2": "um^2",
    "_um": "um",
    "_deg": "degrees",
}


@dataclass(frozen=True)
class Column:
    """One column of a table.

    name : ends with the unit.
    meaning : what it is and how it is computed, in one line.
    """

    name: str
    meaning: str

    @property
    def unit(self) -> str:
        """The unit that the ending of the name gives; "" for pure numbers, names and words."""
        return next((unit for end, unit in _UNITS.items() if self.name.endswith(end)), "")


def columns(text: str) -> tuple[Column, ...]:
    """Columns from lines such as ``area_um2: of the wall``; indented lines continue the last."""
    blocks = re.split(r"\n(?! )", inspect.cleandoc(text))
    parts = (block.partition(": ") for block in blocks)
    return tuple(Column(name, " ".join(meaning.split())) for name, _, meaning in parts)


@dataclass(frozen=True)
class Table:
    """Rows of numbers and words; None where there is no number, and then the note says why.

    name : what the rows are: cells, walls or junctions.
    columns : in the order in which they are written.
    rows : one mapping from column name to value each; no NaN.
    """

    name: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]

    def to_csv(self) -> str:
        """The table as CSV: a header, empty cells for None; equal rows give equal text."""
        return csv_text([c.name for c in self.columns], self.rows)

    def values(self, name: str) -> list[Value]:
        """One column, row by row."""
        return [row[name] for row in self.rows]


def table_of(name: str, columns: Sequence[Column], rows: Iterable[Row]) -> Table:
    """A table with these columns from rows that may lack some; None for what is not finite."""
    names = [column.name for column in columns]
    kept = tuple({key: _known(row.get(key)) for key in names} for row in rows)
    return Table(name, tuple(columns), kept)


def csv_text(names: Sequence[str], rows: Iterable[Mapping[str, Value]]) -> str:
    """Rows as CSV, with a header; empty cells for what is None or not finite."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        writer.writerow([_shown(row[name]) for name in names])
    return text.getvalue()


def notes(*reasons: str) -> str:
    """Reasons joined into one note, each once."""
    return "; ".join(dict.fromkeys(reason for reason in reasons if reason))


def _known(value: Value) -> Value:
    return None if isinstance(value, float) and not isfinite(value) else value


def _shown(value: Value) -> str:
    value = _known(value)
    if value is None:
        return ""
    if isinstance(value, float):
        return format(value + 0.0, _DIGITS)  # no minus before a zero
    return str(value)


def aligned(rows: Sequence[Sequence[str]], left: Sequence[int] = (0,)) -> str:
    """Rows as lines of text in columns; those in ``left`` are flush left, others flush right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [
            cell.ljust(w) if i in left else cell.rjust(w)
            for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)
