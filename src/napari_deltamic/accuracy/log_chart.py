"""Charts with two logarithmic axes, drawn with Pillow: no plotting library is needed for them."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import ceil, floor, isfinite, log10
from typing import Any, Literal

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..common.words import scientific
from ..errors import InputError

Marker = Literal["circle", "square", "triangle", "diamond", "cross"]
# Told apart also by the colour-blind, and by the markers in print.
PALETTE = (
    (0, 114, 178),
    (213, 94, 0),
    (0, 158, 115),
    (204, 121, 167),
    (86, 180, 233),
    (120, 120, 120),
    (230, 159, 0),
)
_INK, _GRID, _FAINT, _PAPER = (30, 30, 30), (205, 205, 205), (232, 232, 232), (255, 255, 255)
_FINE = 3  # lines are drawn this many times larger and reduced
_LEFT, _TOP, _RIGHT, _BOTTOM = 92, 44, 24, 62  # px around the axes
_ROW = 22  # px of a line of the legend
_RADIUS = 5.5  # px of a marker


def _power(value: float) -> str:
    """Plain where that is as short."""
    return f"{value:g}" if 0.01 <= value < 1e4 else scientific(value, 1)


@dataclass(frozen=True)
class Series:
    """Points that belong together.

    Attributes
    ----------
    name
        For the legend; empty: none.
    x, y
        All positive.
    colour
        Number in ``PALETTE``.
    line
        Whether the points are joined.
    hollow
        One for each point, or for all: drawn as an outline (not measured, but reckoned).
    spread
        Lowest and highest y of each point: a bar.
    """

    name: str
    x: Sequence[float]
    y: Sequence[float]
    colour: int = 0
    marker: Marker | None = "circle"
    line: bool = False
    hollow: Sequence[bool] | bool = False
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
    y_text: Callable[[float], str] = field(default=_power)
    size: tuple[int, int] = (1000, 620)

    def image(self) -> Image.Image:
        """Draw it.

        Raises
        ------
        InputError
            If there is no point, or one that is not positive.
        """
        return _Drawing(self).image()

    def png(self) -> bytes:
        """The picture as the content of a PNG file."""
        buffer = io.BytesIO()
        self.image().save(buffer, "PNG", optimize=True)
        return buffer.getvalue()


def time_text(seconds: float) -> str:
    """A time on an axis: 10 ms, 1 s, 2 min."""
    for limit, unit, size in ((1e-3, "us", 1e-6), (1, "ms", 1e-3), (120, "s", 1.0)):
        if seconds < limit * 0.999:
            return f"{seconds / size:.3g} {unit}"
    if seconds < 7200:
        return f"{seconds / 60:.3g} min"
    return f"{seconds / 3600:.3g} h" if seconds < 172_800 else f"{seconds / 86_400:.3g} d"


class LogAxis:
    """From values to px along one axis."""

    def __init__(self, values: Sequence[float], first: float, last: float) -> None:
        if not values or not all(isfinite(v) and v > 0 for v in values):
            raise InputError("a chart with logarithmic axes needs points that are all positive")
        low, high = log10(min(values)), log10(max(values))
        room = max(0.06 * (high - low), 0.12)
        self.low, self.high = low - room, high + room
        self._first, self._last = first, last

    def __call__(self, value: float) -> float:
        share = (log10(value) - self.low) / (self.high - self.low)
        return self._first + share * (self._last - self._first)

    def ticks(self) -> tuple[list[float], list[float]]:
        """Values with a label, and others with a line only."""
        decades = range(floor(self.low), ceil(self.high) + 1)
        span = self.high - self.low
        steps = range(1, 10) if span < 0.6 else (1, 2, 5) if span < 2.2 else (1,)
        every = max(1, round(span / 8))
        main = [
            s * 10.0**d
            for d in decades
            for s in steps
            if d % every == 0 and self._holds(s * 10.0**d)
        ]
        minor = [
            s * 10.0**d
            for d in decades
            for s in range(2, 10)
            if span < 4.5 and self._holds(s * 10.0**d)
        ]
        return main, [m for m in minor if m not in main]

    def _holds(self, value: float) -> bool:
        return self.low <= log10(value) <= self.high


class _Drawing:
    def __init__(self, chart: Chart) -> None:
        self.chart = chart
        names = [s.name for s in chart.series if s.name]
        self.font, self.title_font = _font(14), _font(17)
        legend = max((self.font.getlength(n) for n in names), default=0)
        self.legend_width = int(legend) + 44 if names else 0
        width, height = chart.size
        if len(names) * _ROW + _TOP + _BOTTOM > height:
            height = len(names) * _ROW + _TOP + _BOTTOM
        self.size = width, height
        self.box = (_LEFT, _TOP, width - _RIGHT - self.legend_width, height - _BOTTOM)
        xs = [x for s in chart.series for x in s.x] + [n.x for n in chart.notes]
        ys = [y for s in chart.series for y in (*s.y, *(v for pair in s.spread for v in pair))]
        self.x = LogAxis(xs, self.box[0], self.box[2])
        self.y = LogAxis([*ys, *(n.y for n in chart.notes)], self.box[3], self.box[1])

    def image(self) -> Image.Image:
        large = Image.new("RGB", (self.size[0] * _FINE, self.size[1] * _FINE), _PAPER)
        self.lines = ImageDraw.Draw(large)
        self._grid()
        for series in self.chart.series:
            self._series(series)
        for note in self.chart.notes:
            self._ring(self.x(note.x), self.y(note.y), 2.1 * _RADIUS, _INK, 2)
        self._legend_markers()
        picture = large.resize(self.size, Image.Resampling.BOX)
        self.text = ImageDraw.Draw(picture)
        self._labels(picture)
        return picture

    # ------------------------------------------------------------------------------ shapes

    def _stroke(self, points: Sequence[tuple[float, float]], colour: Any, width: float) -> None:
        scaled = [(x * _FINE, y * _FINE) for x, y in points]
        self.lines.line(scaled, fill=colour, width=round(width * _FINE), joint="curve")

    def _ring(self, x: float, y: float, radius: float, colour: Any, width: float) -> None:
        box = [_FINE * v for v in (x - radius, y - radius, x + radius, y + radius)]
        self.lines.ellipse(box, outline=colour, width=round(width * _FINE))

    def _marker(self, x: float, y: float, marker: Marker, colour: Any, hollow: bool) -> None:
        r = _RADIUS
        if marker == "cross":
            self._stroke([(x - r, y - r), (x + r, y + r)], colour, 2)
            self._stroke([(x - r, y + r), (x + r, y - r)], colour, 2)
            return
        sides = {"circle": 32, "square": 4, "triangle": 3, "diamond": 4}[marker]
        turn = np.pi / 4 if marker == "square" else 0.0
        angle = np.arange(sides) * 2 * np.pi / sides + turn
        size = r * {"circle": 1.0, "square": 1.2, "triangle": 1.3, "diamond": 1.3}[marker]
        corners = [(_FINE * (x + size * np.sin(a)), _FINE * (y - size * np.cos(a))) for a in angle]
        fill = _PAPER if hollow else colour
        self.lines.polygon(corners, fill=fill, outline=colour, width=2 * _FINE)

    def _grid(self) -> None:
        left, top, right, bottom = self.box
        for axis, across in ((self.x, True), (self.y, False)):
            main, minor = axis.ticks()
            for values, colour in ((minor, _FAINT), (main, _GRID)):
                for value in values:
                    at = axis(value)
                    ends = [(at, top), (at, bottom)] if across else [(left, at), (right, at)]
                    self._stroke(ends, colour, 1)
        frame = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)]
        self._stroke(frame, _INK, 1)

    def _series(self, series: Series) -> None:
        colour = PALETTE[series.colour % len(PALETTE)]
        places = [(self.x(x), self.y(y)) for x, y in zip(series.x, series.y, strict=True)]
        if series.line and len(places) > 1:
            self._stroke(places, colour, 2)
        for (at, _), (low, high) in zip(places, series.spread, strict=False):
            self._stroke([(at, self.y(low)), (at, self.y(high))], colour, 2)
        hollow = series.hollow
        each = [hollow] * len(places) if isinstance(hollow, bool) else list(hollow)
        if series.marker is not None:
            for (x, y), outline in zip(places, each, strict=True):
                self._marker(x, y, series.marker, colour, bool(outline))

    # ------------------------------------------------------------------------------- words

    def _named(self) -> list[tuple[Series, float]]:
        named = [s for s in self.chart.series if s.name]
        return [(s, self.box[1] + _ROW * (i + 0.5)) for i, s in enumerate(named)]

    def _legend_markers(self) -> None:
        for series, y in self._named():
            x = self.box[2] + 24
            colour = PALETTE[series.colour % len(PALETTE)]
            if series.line:
                self._stroke([(x - 11, y), (x + 11, y)], colour, 2)
            if series.marker is not None:
                self._marker(x, y, series.marker, colour, series.hollow is True)

    def _labels(self, picture: Image.Image) -> None:
        chart, (left, top, right, bottom) = self.chart, self.box
        self._words((left, top / 2), chart.title, "lm", self.title_font)
        for value in self.x.ticks()[0]:
            self._words((self.x(value), bottom + 8), chart.x_text(value), "mt")
        for value in self.y.ticks()[0]:
            self._words((left - 8, self.y(value)), chart.y_text(value), "rm")
        self._words(((left + right) / 2, self.size[1] - 14), chart.x_label, "mb")
        self._sideways(picture, chart.y_label)
        for series, y in self._named():
            self._words((right + 42, y), series.name, "lm")
        for note in chart.notes:
            x, y = self.x(note.x), self.y(note.y)
            ahead = x + 16 + self.font.getlength(note.text) < right
            place = (x + 16, y - 14) if ahead else (x - 16, y - 14)
            self._words(place, note.text, "lm" if ahead else "rm", halo=True)

    def _words(
        self,
        place: tuple[float, float],
        text: str,
        anchor: str,
        font: Any = None,
        halo: bool = False,
    ) -> None:
        options: dict[str, Any] = {"stroke_width": 3, "stroke_fill": _PAPER} if halo else {}
        self.text.text(place, text, fill=_INK, font=font or self.font, anchor=anchor, **options)

    def _sideways(self, picture: Image.Image, text: str) -> None:
        width = int(self.font.getlength(text)) + 4
        strip = Image.new("RGB", (width, 22), _PAPER)
        ImageDraw.Draw(strip).text((2, 11), text, fill=_INK, font=self.font, anchor="lm")
        turned = strip.rotate(90, expand=True)
        middle = (self.box[1] + self.box[3] - turned.height) // 2
        picture.paste(turned, (4, max(middle, 0)))


def _font(size: int) -> Any:
    return ImageFont.load_default(size)
