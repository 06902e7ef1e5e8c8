"""What the benchmark of defaults found, as tables for a page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..figure import Row, at_most
from ..page import table
from .anything import ANYTHING
from .recipes import WORDS

OFF, NEAR = 0.5, 0.2  # voxels: more must not be called good, less not poor
CUT = ("cut", "cut-deep")  # whose volumes are asked for
Scenes = Sequence[dict[str, Any]]


def figures(rows: Scenes) -> list[Row]:
    """What is asked of all scenes together."""
    found: list[Row] = []
    both = [r for r in rows if r.get("told")]
    if both:
        error = np.array([r["surface"] / r["told"] for r in both])
        seconds = np.array([r["seconds"] / r["told_seconds"] for r in both])
        found += [
            at_most("error over that of a fit given the truth, median", 1.15, np.median(error), ""),
            at_most("the same, 95 % of the scenes", 1.5, np.percentile(error, 95), ""),
            at_most("time over that of a fit given the truth, median", 2, np.median(seconds), ""),
        ]
    good = [r["scene"] for r in rows if r["grade"] == "good" and r["surface"] > OFF]
    poor = [r["scene"] for r in rows if r["grade"] == "poor" and r["surface"] < NEAR]
    of = f"of {len(rows)}"
    found += [
        at_most(f"off by more than {OFF} voxel and good", 0, len(good), of, " ".join(good)),
        at_most(f"within {NEAR} voxel and poor", 3, len(poor), of, " ".join(poor)),
    ]
    for name in ("swallowed", "lost"):
        where = " ".join(r["scene"] for r in rows if r[name])
        what = {"swallowed": "neighbours swallowed", "lost": "cells lost"}[name]
        found.append(at_most(what, 0, sum(r[name] for r in rows), "", where))
    cut = [abs(100 * r["volume"]) for r in rows if r["scene"].rpartition("-")[0] in CUT]
    if cut:
        found.append(at_most("volume of cut cells inside the image, worst", 2, max(cut), "%"))
    within = sum(r["surface"] < NEAR for r in rows)
    grades = {g: sum(r["grade"] == g for r in rows) for g in ("good", "fair", "poor")}
    note = ", ".join(f"{n} {g}" for g, n in grades.items())
    return [*found, Row(f"within {NEAR} voxel", "", within, of, None, note)]


def by_kind(rows: Scenes) -> str:
    """Every kind as a line, its scenes one after another."""
    lines = ["| scene | error, voxel | given the truth | volume | grade |", "|---|---|---|---|---|"]
    kinds = dict.fromkeys(r["scene"].rpartition("-")[0] for r in rows)
    for kind in kinds:
        mine = [r for r in rows if r["scene"].rpartition("-")[0] == kind]
        columns = (
            WORDS[kind],
            "; ".join(f"{r['surface']:.3f}" for r in mine),
            "; ".join(f"{r['told']:.3f}" if r.get("told") else "-" for r in mine),
            "; ".join(f"{100 * r['volume']:+.1f} %" for r in mine),
            "; ".join(r["grade"] for r in mine),
        )
        lines.append("| " + " | ".join(columns) + " |")
    return "\n".join(lines)


def by_processing(rows: Scenes) -> str:
    """Processings down, scenes across: error and grade."""
    parted = [(*r["scene"].rpartition("-")[0].split("~"), r) for r in rows]
    bases = list(dict.fromkeys(base for base, _, _ in parted))
    lines = [
        "| | " + " | ".join(WORDS[base] for base in bases) + " |",
        "|---|" + "---|" * len(bases),
    ]
    for how in dict.fromkeys(how for _, how, _ in parted):
        cells = [
            "; ".join(
                f"{r['surface']:.2f} {r['grade']}" for b, h, r in parted if (b, h) == (base, how)
            )
            for base in bases
        ]
        lines.append(f"| {how} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def by_grade(rows: Scenes) -> str:
    """How far off the surfaces of each grade are."""
    lines = ["| grade | scenes | error, voxel: median | 90 % | most |", "|---|---:|---:|---:|---:|"]
    for grade in dict.fromkeys(("good", "fair", "poor", *(r["grade"] for r in rows))):
        off = [r["surface"] for r in rows if r["grade"] == grade]
        if off:
            shown = " | ".join(f"{q:.2f}" for q in (*np.percentile(off, (50, 90)), max(off)))
            lines.append(f"| {grade} | {len(off)} | {shown} |")
    return "\n".join(lines)


def whole(rows: Scenes, section: str) -> str:
    """What stands between the marks of a section of the page."""
    if section == "processed":
        return by_processing(rows)
    further = by_grade(rows) if section == ANYTHING else by_kind(rows)
    return f"{table(figures(rows))}\n\n{further}"
