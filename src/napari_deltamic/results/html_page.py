"""A page about one measured result: pictures, histograms, tables, settings, versions, citation.

One file without scripts or links to other files. Histograms are drawn as SVG here: bars need no
plotting library, and the page then looks the same wherever it is made.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Mapping
from html import escape
from typing import Any

import numpy as np

from ..common.version import version_of
from ..common.words import readable
from ..measure import Measurements, Table
from .measured_source import Measurable
from .picture import picture_png
from .report import PACKAGES

# The columns that the page shows; the CSV files hold the rest.
_SHOWN = {
    "cells": (
        "region", "volume_um3", "volume_se_um3", "area_um2", "sphericity", "n_contacts",
        "mean_curvature_per_um", "pressure_per_um", "cut_by_border", "explained", "note",
    ),
    "walls": (
        "region_a", "region_b", "area_um2", "mean_curvature_per_um", "tension", "tension_se",
        "note",
    ),
    "junctions": (
        "region_a", "region_b", "region_c", "length_um", "angle_a_deg", "angle_b_deg",
        "angle_c_deg", "note",
    ),
}  # fmt: skip
_HISTOGRAMS = (
    ("cells", ("volume_um3",), "volume, µm³"),
    ("cells", ("sphericity",), "sphericity"),
    ("cells", ("n_contacts",), "contacts of a cell"),
    ("walls", ("area_um2",), "area of a wall, µm²"),
    ("walls", ("mean_curvature_per_um",), "mean curvature of a wall, 1/µm"),
    ("walls", ("tension",), "relative tension"),
    ("junctions", ("angle_a_deg", "angle_b_deg", "angle_c_deg"), "angles at junctions, degrees"),
)
_MOST_ROWS = 200
_EQUAL = 1e-6  # relative: values that differ by less are drawn as one
_WIDTH, _HEIGHT, _BARS = 260, 110, 24  # px, and how many bars at most
_PAPER = (
    "S. Ichbiah, A. Sinha, F. Delbary, H. Turlier: Inverse 3D Microscopy Rendering for Cell Shape "
    "Inference with Active Mesh. IEEE/CVF International Conference on Computer Vision (ICCV), 2025."
)
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 70em; margin: 2em auto; padding: 0 1em;
  color: #1b1b1b; background: #fff }
img { max-width: 100% } table { border-collapse: collapse; font-size: 13px }
th, td { padding: .15em .6em; text-align: right; border-bottom: 1px solid #ddd }
td.word, th.word { text-align: left } .rows { overflow-x: auto }
figure { display: inline-block; margin: 0 1em 1em 0 } figcaption { font-size: 13px }
rect { fill: #3776ab } text { font: 11px system-ui, sans-serif; fill: #444 }
pre { overflow-x: auto; font-size: 12px } @media print { details { display: none } }
"""


def html_page(source: Measurable, measured: Measurements) -> str:
    """Return the page as text; the same source gives the same text."""
    title = f"Measurements of {source.name}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        _verdict(source, measured),
        _picture(source),
        "<h2>Histograms</h2>",
        *_histograms(measured),
        *(_table(table) for table in measured.tables),
        _settings(source.facts),
        _versions(),
        "<h2>How to cite</h2>",
        f"<p>napari-deltamic {escape(version_of('napari-deltamic'))}, and the method: "
        f"{escape(_PAPER)}</p>",
    ]
    body = "\n".join(part for part in parts if part)
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n{body}\n"
        "</body>\n</html>\n"
    )


def _verdict(source: Measurable, measured: Measurements) -> str:
    """Say what was found, how the fit ended, and its caveats."""
    cells, walls, junctions = (len(table.rows) for table in measured.tables)
    lines = [f"{cells} cells, {walls} walls, {junctions} junctions"]
    facts = source.facts
    verdict = facts.get("verdict")
    if isinstance(verdict, Mapping) and "grade" in verdict:
        reasons = "; ".join(map(str, verdict.get("reasons") or ()))
        lines.append(f"shapes: {verdict['grade']}" + (f": {reasons}" if reasons else ""))
    if "converged" in facts:
        ended = "has converged" if facts["converged"] else "has not converged"
        lines.append(f"the fit {ended} ({facts.get('iterations', '?')} iterations)")
    explained = _mean(row["explained"] for row in measured.cells.rows)
    if explained is not None:
        lines.append(
            f"it explains {100 * explained:.0f} % of what varies around a cell, on average"
        )
    noted = sum(bool(row["note"]) for row in measured.cells.rows)
    if noted:
        lines.append(f"{noted} of the cells have a note")
    lines += [*map(str, facts.get("warnings") or ()), *source.remarks]
    return "<ul>\n" + "\n".join(f"<li>{escape(line)}</li>" for line in lines) + "\n</ul>"


def _mean(values: Iterable[Any]) -> float | None:
    known = [v for v in values if isinstance(v, float)]
    return float(np.mean(known)) if known else None


def _picture(source: Measurable) -> str:
    """Draw measured slices with contours, and rendered ones if there are any."""
    if source.image is None or source.grid is None:
        return ""
    image = np.asarray(source.image)
    rendered = source.rendered
    if rendered is None:
        rendered = np.full(image.shape, np.nan, np.float32)  # drawn as missing
    png = picture_png(image, rendered, source.mesh, source.grid)
    data = base64.b64encode(png).decode("ascii")
    return f'<p><img alt="slices with contours" src="data:image/png;base64,{data}"></p>'


def _histograms(measured: Measurements) -> list[str]:
    tables = {table.name: table for table in measured.tables}
    found = []
    for name, columns, title in _HISTOGRAMS:
        values = [v for c in columns for v in tables[name].values(c) if isinstance(v, (int, float))]
        if values:
            found.append(_histogram(np.array(values, np.float64), title))
    return found or ["<p>There is nothing to count.</p>"]


def _histogram(values: np.ndarray, title: str) -> str:
    """Draw bars of equal width from the smallest to the largest value, as SVG."""
    low, high = float(values.min()), float(values.max())
    whole = bool((values == np.rint(values)).all()) and high - low < _BARS
    if whole:
        low, high, bars = low - 0.5, high + 0.5, round(high - low) + 1
    else:
        bars = int(np.clip(np.sqrt(len(values)) * 1.5, 4, _BARS))
    if high - low <= _EQUAL * max(abs(low), abs(high)):  # bars would be narrower than rounding
        low, high, bars = low - 0.5, high + 0.5, 1
    counts, _ = np.histogram(values, bars, (low, high))
    step, most = _WIDTH / bars, max(int(counts.max()), 1)
    drawn = [
        f'<rect x="{k * step:.1f}" y="{_HEIGHT * (1 - n / most):.1f}" width="{step - 1:.1f}" '
        f'height="{_HEIGHT * n / most:.1f}"/>'
        for k, n in enumerate(counts.tolist())
    ]
    drawn += [
        f'<text x="0" y="{_HEIGHT + 14}">{values.min():.4g}</text>',
        f'<text x="{_WIDTH}" y="{_HEIGHT + 14}" text-anchor="end">{values.max():.4g}</text>',
    ]
    middle = f"median {np.median(values):.4g}, {len(values)} values, up to {most} in a bar"
    return (
        f'<figure><svg width="{_WIDTH}" height="{_HEIGHT + 18}" role="img">'
        f"<title>{escape(title)}</title>{''.join(drawn)}</svg>"
        f"<figcaption>{escape(title)}<br>{middle}</figcaption></figure>"
    )


def _table(table: Table) -> str:
    """Return the shown columns that hold anything; rows that do not fit are in the CSV file."""
    shown = [c for c in table.columns if c.name in _SHOWN[table.name]]
    shown = [c for c in shown if any(v not in (None, "") for v in table.values(c.name))]
    if not table.rows:
        return f"<h2>{table.name.capitalize()}</h2>\n<p>There are none.</p>"
    head = "".join(f'<th title="{escape(c.meaning)}">{escape(c.name)}</th>' for c in shown)
    rows = "\n".join(
        "<tr>" + "".join(_cell(row[c.name]) for c in shown) + "</tr>"
        for row in table.rows[:_MOST_ROWS]
    )
    left = len(table.rows) - _MOST_ROWS
    more = f"<p>{left} more in {table.name}.csv</p>" if left > 0 else ""
    return (
        f'<h2>{table.name.capitalize()}</h2>\n<div class="rows"><table><thead><tr>{head}</tr>'
        f"</thead><tbody>\n{rows}\n</tbody></table></div>{more}"
    )


def _cell(value: Any) -> str:
    if value is None:
        return "<td></td>"
    if isinstance(value, float):
        return f"<td>{readable(value)}</td>"
    if isinstance(value, str):
        return f'<td class="word">{escape(value)}</td>'
    return f"<td>{value}</td>"


def _settings(facts: Mapping[str, Any]) -> str:
    kept = {k: facts[k] for k in ("settings", "optics", "effects", "seconds") if k in facts}
    if not kept:
        return ""
    text = json.dumps(kept, indent=2, sort_keys=True, default=str)
    return f"<h2>Settings</h2>\n<details><pre>{escape(text)}</pre></details>"


def _versions() -> str:
    words = ", ".join(f"{name} {version_of(name)}" for name in PACKAGES)
    return f"<h2>Versions</h2>\n<p>{escape(words)}</p>"
