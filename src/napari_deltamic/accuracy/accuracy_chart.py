"""What accuracy costs, as tables and charts for the command line, the widget and the docs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from ..common.table import aligned
from ..common.words import duration, scientific
from .log_chart import Chart, Note, Series, time_text
from .shape_error import ShapeError, enough
from .tradeoff import Way

_WAYS = ("way", "image", "with gradient", "memory", "image error", "gradient error", "")
_SHAPES = (
    *("choice", "predicted", "surface error", "", "spread", "edges", "image accuracy"),
    *("iterations", "time of a fit", ""),
)


def ways_table(ways: Sequence[Way]) -> str:
    """A table with a line per way: time of an image, with gradient, memory, errors."""
    return aligned([_WAYS, *(_way_cells(way) for way in ways)], left=(0, len(_WAYS) - 1))


def _way_cells(way: Way) -> tuple[str, ...]:
    marks = [
        text
        for text, on in (
            ("in use", way.in_use),
            ("reference", way.reference),
            ("front", way.on_front),
            (way.note, bool(way.note)),
        )
        if on
    ]
    return (
        f"{way.name}, asked {short(way.accuracy)}" if way.accuracy else way.name,
        _or_dash(way.forward, duration),
        _or_dash(way.gradient, duration),
        _or_dash(way.memory, lambda b: f"{b / 1e6:.0f} MB"),
        "-" if way.error is None or way.reference else f"{way.error:.1e}",
        "-" if way.gradient_error is None or way.reference else f"{way.gradient_error:.1e}",
        ", ".join(marks),
    )


def shape_table(found: Sequence[ShapeError], voxel: float) -> str:
    """A table with a line per choice: predicted and measured surface error, and what it takes."""
    stop = enough(found)
    rows = [
        (
            e.choice,
            f"{1e3 * e.dialled.predicted:.3g} nm",
            f"{1e3 * e.mean:.3g} nm",
            f"{e.mean / voxel:.3f} voxel",
            f"{1e3 * e.spread:.2g} nm",
            f"{e.dialled.edge:.2g} um",
            short(e.dialled.accuracy),
            f"{e.iterations:.0f}",
            duration(e.seconds),
            "enough" if e.choice == stop else "",
        )
        for e in found
    ]
    return aligned([_SHAPES, *rows], left=(0, len(_SHAPES) - 1))


def shape_answer(found: Sequence[ShapeError]) -> str:
    """A sentence that names the choice that is enough."""
    draws = len(found[0].errors)
    given = f"given this noise ({draws} draw{'s' if draws > 1 else ''})"
    return f"{enough(found)} is the fastest choice within 5 % of the least error, {given}."


def ways_chart(ways: Sequence[Way], title: str) -> Chart:
    """Error of the image against time with the gradient: all measured ways and their front."""
    shown = [w for w in ways if w.measured and not w.reference and w.error]
    groups = {
        "closed form, float64": (0, "square"),
        "closed form, float32": (4, "square"),
        "particle-mesh, one rule, float64": (1, "triangle"),
        "particle-mesh, one rule, float32": (6, "triangle"),
        "as planned for an accuracy": (2, "circle"),
    }
    series = []
    front = sorted((w for w in shown if w.on_front), key=lambda w: w.gradient or 0)
    if len(front) > 1:
        series.append(_series("none faster and better", front, 5, None, line=True))
    for name, (colour, marker) in groups.items():
        own = [w for w in shown if _group(w) == name]
        if own:
            series.append(_series(name, own, colour, marker))
    used = [w for w in shown if w.in_use]
    notes = [
        Note(float(w.gradient or 0), float(w.error or 0), f"in use: {short(w.accuracy or 0)}")
        for w in used
    ]
    return Chart(
        title,
        "time of an image with its gradient",
        "relative error of the image",
        series,
        notes,
        x_text=time_text,
    )


def _group(way: Way) -> str:
    if way.accuracy:
        return "as planned for an accuracy"
    rule = ", one rule" if way.method == "particle-mesh" else ""
    return f"{way.method}{rule}, {way.precision}"


def _series(name: str, ways: Sequence[Way], colour: int, marker: Any, line: bool = False) -> Series:
    x, y = [float(w.gradient or 0) for w in ways], [float(w.error or 0) for w in ways]
    return Series(name, x, y, colour, marker, line=line)


def shape_chart(found: Sequence[ShapeError], title: str) -> Chart:
    """Error of the fitted surface against the time of a fit, measured and predicted."""
    x = [e.seconds for e in found]
    y = [1e3 * e.mean for e in found]
    spread = [(1e3 * min(e.errors), 1e3 * max(e.errors)) for e in found]
    notes = [Note(e.seconds, 1e3 * e.mean, e.choice) for e in found]
    predicted = [1e3 * e.dialled.predicted for e in found]
    series = [
        Series(
            "measured: mean, and range of the draws", x, y, 0, "circle", line=True, spread=spread
        ),
        Series("predicted", x, predicted, 1, "triangle"),
    ]
    return Chart(
        title,
        "time of a fit",
        "mean distance to the true surface, nm",
        series,
        notes,
        x_text=time_text,
    )


def way_facts(way: Way) -> dict[str, Any]:
    """A way as plain values, for JSON."""
    facts = asdict(way)
    facts["name"] = way.name
    return facts


def shape_facts(found: Sequence[ShapeError], voxel: float) -> dict[str, Any]:
    """Errors of the surface as plain values, for JSON."""
    return {
        "enough": enough(found),
        "answer": shape_answer(found),
        "choices": [
            {
                "choice": e.choice,
                "predicted_nm": 1e3 * e.dialled.predicted,
                "edge_um": e.dialled.edge,
                "accuracy": e.dialled.accuracy,
                "tolerance": e.dialled.tolerance,
                "mean_nm": 1e3 * e.mean,
                "mean_voxels": e.mean / voxel,
                "spread_nm": 1e3 * e.spread,
                "errors_nm": [1e3 * one for one in e.errors],
                "iterations": e.iterations,
                "seconds": e.seconds,
            }
            for e in found
        ],
    }


def short(accuracy: float) -> str:
    """An accuracy as text: 1e-3 rather than 0.001 or 1e-03; 0 is marked as exact."""
    return "0 (exact)" if accuracy == 0 else scientific(accuracy)


def _or_dash(value: Any, text: Any) -> str:
    return "-" if value is None else str(text(value))
