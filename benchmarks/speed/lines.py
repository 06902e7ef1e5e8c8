"""Lines of the table: a figure on both sides, and what was asked of the present one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .jobs import SIDES, Bench, Pair, Side

HEADINGS = ("figure", "asked", "baseline", "present", "ratio", "passed", "note")


@dataclass(frozen=True)
class Bar:
    """What is asked, in words, and whether (baseline, present) meet it."""

    text: str
    met: Callable[[float, float], bool]
    needs_baseline: bool


def at_most(limit: float) -> Bar:
    """The present figure up to a limit."""
    return Bar(f"<= {limit:g}", lambda _, present: present <= limit, False)


def at_least(limit: float) -> Bar:
    """The present figure from a limit up."""
    return Bar(f">= {limit:g}", lambda _, present: present >= limit, False)


def not_above(slack: float = 0.0) -> Bar:
    """The present figure up to the baseline's."""
    text = "not above" if slack == 0 else f"not above + {slack:g}"
    return Bar(text, lambda baseline, present: present <= baseline + slack, True)


def not_below() -> Bar:
    """The present figure from the baseline's up."""
    return Bar("not below", lambda baseline, present: present >= baseline, True)


def faster(factor: float) -> Bar:
    """The baseline's time over the present one."""
    return Bar(f"1/{factor:g}", lambda baseline, present: present * factor <= baseline, True)


@dataclass(frozen=True)
class Line:
    """A figure; nan where a side was not measured or failed.

    passed : None where nothing was asked, or what it is compared with is missing.
    """

    figure: str
    unit: str
    baseline: float
    present: float
    asked: str = ""
    passed: bool | None = None
    note: str = ""

    @property
    def ratio(self) -> float:
        """Baseline over present: above 1 where the present is less."""
        return self.baseline / self.present if self.present else math.nan


def line(
    figure: str,
    unit: str,
    baseline: float | None,
    present: float | None,
    bar: Bar | None = None,
    note: str = "",
) -> Line:
    """A line judged by its bar; a present side that failed does not pass."""
    one, other = (math.nan if x is None else float(x) for x in (baseline, present))
    passed = None
    if bar is not None and present is not None and not (bar.needs_baseline and math.isnan(one)):
        passed = bool(bar.met(one, other))
    return Line(figure, unit, one, other, bar.text if bar else "", passed, note)


def compared(
    figure: str,
    unit: str,
    pair: Pair,
    value: str | Callable[[Side], float],
    bar: Bar | None = None,
    note: str = "",
) -> Line:
    """A line of a pair of outcomes: the median of a value over the rounds, or a function's."""
    found = [_value(pair, side, value) if side in pair.each else None for side in SIDES]
    failures = [f"{side}: {each[0].failed}" for side, each in pair.each.items() if each[0].failed]
    return line(figure, unit, *found, bar, "; ".join([*filter(None, [note]), *failures]))


def time_of(figure: str, pair: Pair, bar: Bar | None = None) -> Line:
    """Seconds by the clock on the wall; of all cores in the note, which a busy machine blurs less.

    Of a fit, both are those of its iterations; of other tasks the cores' are of all of it.
    """
    cpu = {side: pair.median(side, "cpu") for side in pair.each}
    note = "CPU " + " and ".join(f"{seconds:.4g} s" for seconds in cpu.values())
    return compared(figure, "s", pair, "seconds", bar, note)


def _value(pair: Pair, side: Side, value: str | Callable[[Side], float]) -> float:
    if isinstance(value, str):
        return pair.median(side, value)
    return math.nan if pair.each[side][0].failed else value(side)


class Tally:
    """Values of several jobs, by name and side."""

    def __init__(self) -> None:
        self._values: dict[tuple[str, Side], list[float]] = {}

    def add(self, name: str, pair: Pair, value: str | Callable[[Side], float]) -> None:
        """Those of another job; nan where it failed."""
        for side in pair.each:
            self._values.setdefault((name, side), []).append(_value(pair, side, value))

    def last(self, figure: str, unit: str, name: str) -> Line:
        """A line of what was added last."""
        return self.line(figure, unit, name, lambda values: values[-1])

    def line(
        self,
        figure: str,
        unit: str,
        name: str,
        reduce: Callable[[list[float]], float],
        bar: Bar | None = None,
        note: str = "",
    ) -> Line:
        """A line of all of them."""
        every = [self._values.get((name, side)) for side in SIDES]
        return line(figure, unit, *(v and reduce(v) for v in every), bar, note)  # type: ignore[misc]


Case = Callable[[Bench], list[Line]]


def table(lines: Sequence[Line]) -> str:
    """Markdown."""
    rows = [HEADINGS, *(_cells(each) for each in lines)]
    text = ["| " + " | ".join(c.replace("|", "\\|") for c in row) + " |" for row in rows]
    return "\n".join([text[0], "|---|---|---:|---:|---:|---|---|", *text[1:]])


def _cells(each: Line) -> tuple[str, ...]:
    unit = f", {each.unit}" if each.unit else ""
    passed = {True: "yes", False: "NO", None: ""}[each.passed]
    numbers = (_number(each.baseline), _number(each.present), _number(each.ratio, 3))
    return (each.figure + unit, each.asked, *numbers, passed, each.note)


def _number(value: float, digits: int = 4) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}g}"
