"""Charts with two logarithmic axes, drawn by matplotlib."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import isfinite, log10
from typing import TYPE_CHECKING, Any, Literal

from ..common.words import scientific
from ..errors import InputError

if TYPE_CHECKING:  # matplotlib takes half a second to load: only where something is drawn
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Marker = Literal["circle", "square", "triangle", "diamond"]
_MARKERS = {"circle": "o", "square": "s", "triangle": "^", "diamond": "D"}
# Okabe and Ito's colours, which the colour-blind can tell apart; in print the markers differ.
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#787878", "#e69f00")
_INCHES, _DPI = (10.0, 6.2), 100
_FINE_TICKS = 2.2  # decades: with fewer, powers of ten alone would leave an axis nearly bare


def _power(value: float) -> str:
    """A value as text: plain where that is short, else in scientific notation."""
    return f"{value:g}" if 0.01 <= value < 1e4 else scientific(value, 1)


@dataclass(frozen=True)
class Series:
    """Points that belong together.

    Attributes
    ----------
    name
        Name in the legend; "" for none.
    x, y
        Coordinates, all positive.
    colour
        Index into ``PALETTE``.
    line
        Whether the points are joined.
    spread
        Lowest and highest y of each point, drawn as a bar.
    """

    name: str
    x: Sequence[float]
    y: Sequence[float]
    colour: int = 0
    marker: Marker | None = "circle"
    line: bool = False
    spread: Sequence[tuple[float, float]] = ()


@dataclass(frozen=True)
class Note:
    """A point that is ringed and named."""

    x: float
    y: float
    text: str


@dataclass(frozen=True)
class Chart:
    """What to draw; axes are logarithmic."""

    title: str
    x_label: str
    y_label: str
    series: Sequence[Series]
    notes: Sequence[Note] = ()
    x_text: Callable[[float], str] = field(default=lambda v: f"{v:g}")

    def figure(self) -> Figure:
        """Draw it.

        Raises
        ------
        InputError
            If there is no point, or one that is not positive.
        """
        from matplotlib.figure import Figure

        xs = [x for s in self.series for x in s.x]
        ys = [y for s in self.series for y in (*s.y, *(v for pair in s.spread for v in pair))]
        figure = Figure(_INCHES, dpi=_DPI, layout="constrained")
        axes = figure.subplots()
        axes.set_title(self.title, loc="left")
        axes.set(xscale="log", yscale="log", xlabel=self.x_label, ylabel=self.y_label)
        for axis, values, text in ((axes.xaxis, xs, self.x_text), (axes.yaxis, ys, _power)):
            _ticks(axis, values, text)
        axes.grid(which="major", color="0.8")
        axes.grid(which="minor", color="0.92")
        axes.set_axisbelow(True)
        for series in self.series:
            _draw(axes, series)
        for note in self.notes:
            _ring(axes, note, xs)
        if any(s.name for s in self.series):
            figure.legend(loc="outside right upper", frameon=False)
        return figure

    def png(self) -> bytes:
        """The picture as the content of a PNG file."""
        buffer = io.BytesIO()
        self.figure().savefig(buffer, format="png")
        return buffer.getvalue()


def time_text(seconds: float) -> str:
    """A time on an axis: 10 ms, 1 s, 2 min."""
    for limit, unit, size in ((1e-3, "us", 1e-6), (1, "ms", 1e-3), (120, "s", 1.0)):
        if seconds < limit * 0.999:
            return f"{seconds / size:.3g} {unit}"
    if seconds < 7200:
        return f"{seconds / 60:.3g} min"
    return f"{seconds / 3600:.3g} h" if seconds < 172_800 else f"{seconds / 86_400:.3g} d"


def _ticks(axis: Any, values: Sequence[float], text: Callable[[float], str]) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    if not values or not all(isfinite(v) and v > 0 for v in values):
        raise InputError("a chart with logarithmic axes needs points that are all positive")
    decades = log10(max(values) / min(values))
    axis.set_major_locator(LogLocator(subs=(1, 2, 5) if decades < _FINE_TICKS else (1,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: text(value)))
    axis.set_minor_formatter(NullFormatter())


def _draw(axes: Axes, series: Series) -> None:
    colour = PALETTE[series.colour % len(PALETTE)]
    marker = _MARKERS[series.marker] if series.marker else ""
    axes.plot(
        series.x, series.y, label=series.name or None, linestyle="-" if series.line else "",
        color=colour, marker=marker, markersize=8, linewidth=2,
    )  # fmt: skip
    if series.spread:
        low, high = zip(*series.spread, strict=True)
        axes.vlines(series.x, low, high, color=colour, linewidth=2)


def _ring(axes: Axes, note: Note, xs: Sequence[float]) -> None:
    axes.plot(note.x, note.y, "o", fillstyle="none", color="0.1", markersize=17, linewidth=2)
    right = log10(note.x) > (log10(min(xs)) + log10(max(xs))) / 2
    axes.annotate(
        note.text,
        (note.x, note.y),
        xytext=(-13 if right else 13, 11),  # points: beside the ring, towards the middle
        textcoords="offset points",
        ha="right" if right else "left",
        va="center",
        bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1},
    )
