"""The reference page of all settings; run as a module, it is written to a file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from napari_deltamic.common.description import Described, described
from napari_deltamic.runs.fit_settings import FitSettings
from napari_deltamic.runs.optics_settings import MeasuredOptics, MicroscopeOptics
from napari_deltamic.runs.scene_settings import RunFields, SceneFields
from napari_deltamic.runs.track_settings import TrackSettings

# Heading, table of run.toml, settings object.
SECTIONS: tuple[tuple[str, str, type[Any]], ...] = (
    ("The run", "at the top", RunFields),
    ("The image", "`[scene]`", SceneFields),
    ("The PSF from the objective", '`scene.optics`, with `kind = "microscope"`', MicroscopeOptics),
    ("The PSF from a bead", '`scene.optics`, with `kind = "measured"`', MeasuredOptics),
    ("The fit", "`[fit]`", FitSettings),
    ("Tracking", "`[track]`, of `napari-deltamic track`", TrackSettings),
)
_HEAD = """# Settings

Made by `python -m benchmarks.settings_page docs/settings.md` from the descriptions of the
settings; do not edit it by hand. The help of the command line and the tooltips of the window show
the same text.

*Live* settings can be changed while a fit runs; it uses them from its next step on. Settings *for
experts* are folded away in the window, or only in `run.toml` and on the command line. The first
column is the name in `run.toml`.
"""


def reference_page() -> str:
    """The page, in Markdown."""
    return "\n".join([_HEAD, *(_section(*section) for section in SECTIONS)])


def _section(heading: str, where: str, model: type[Any]) -> str:
    lines = [
        f"## {heading}\n",
        f"In `run.toml`: {where}.\n",
        "| setting | in the window | flag | values | default | what it does |",
        "|---|---|---|---|---|---|",
        *(_row(found) for found in described(model).values()),
    ]
    return "\n".join([*lines, ""])


def _row(found: Described) -> str:
    marks = [word for word, on in (("live", found.live), ("for experts", found.advanced)) if on]
    flag = f"`{found.flag}`" if found.flag else ""
    if found.kind == "switch":
        flag += f", `--no-{found.flag[2:]}`"
    tip = found.sentence + (f" *{', '.join(marks).capitalize()}.*" if marks else "")
    cells = (f"`{found.name}`", found.label, flag, _values(found), _default(found), tip)
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"


def _values(found: Described) -> str:
    if found.kind == "choice":
        return ", ".join(found.choices)
    words = {
        "switch": "yes or no",
        "whole": "a whole number",
        "number": "a number",
        "triple": "three numbers, Z Y X",
        "numbers": "numbers",
        "text": "a number or a name" if found.choices else "text",
        "part": "a table",
    }[found.kind]
    return f"{words}, {found.bounds}" if found.bounds else words


def _default(found: Described) -> str:
    if found.required:
        return "must be given"
    if found.default is None:
        return "none" if found.kind == "part" else found.automatic
    if found.kind == "switch":
        return "yes" if found.default else "no"
    return " ".join(map(str, found.default)) if found.kind == "triple" else str(found.default)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(reference_page(), encoding="utf-8")
