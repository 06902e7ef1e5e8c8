"""The table of tracked cells: one row for each cell in each frame."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan

import numpy as np

from ..geometry.contacts import neighbours
from ..geometry.judgement import Judgement
from ..tracking import FrameResult, lineage
from .cells import measure_cells

TRACK_COLUMNS = (
    "frame",
    "time_s",
    "cell",
    "parent",
    "volume_um3",
    "area_um2",
    "sphericity",
    "centroid_z_um",
    "centroid_y_um",
    "centroid_x_um",
    "displacement_um",
    "neighbours",
    "grade",
    "shape_error_um",
    "message",
)
TrackRow = dict[str, int | float | str]


def measure_tracks(results: Sequence[FrameResult]) -> list[TrackRow]:
    """Measure each cell in each frame.

    Returns
    -------
    list of dict, by frame and cell, with the keys ``TRACK_COLUMNS``
        parent : the cell that it came from by division; 0 for none
        displacement_um : of the centre since the last good frame; NaN in the first one
        neighbours : the cells with which it shares a wall, separated by spaces
        grade, shape_error_um : good, fair or poor, and what its surface is thought to be off by
        message : what happened to it in this frame, and why its grade is no better; in its last
            frame, why its track ends

        The others are those of ``measure_cells``.
    """
    lives = {life.cell: life for life in lineage(results)}
    last: dict[int, np.ndarray] = {}
    rows: list[TrackRow] = []
    for result in results:
        if result.mesh is None:
            continue
        touched = neighbours(result.mesh)
        told = {e.cell: e.text for e in result.events if e.kind == "alarm"}
        for cell in measure_cells(result.mesh):
            number = int(cell["region"])
            life = lives[number]
            center = np.array([cell[f"centroid_{axis}_um"] for axis in "zyx"])
            others = touched[number]
            judged = result.judged.get(number, Judgement(""))
            words, off = [told.get(number, ""), judged.reasons], judged.shape_error_um
            if life.parent and life.first == result.frame:
                words.append(f"born of cell {life.parent}")
            if life.end and life.last == result.frame:
                words.append(life.end)
            moved = np.linalg.norm(center - last[number]) if number in last else nan
            rows.append(
                {
                    "frame": result.frame,
                    "time_s": result.time,
                    "cell": number,
                    "parent": life.parent,
                    **{key: cell[key] for key in TRACK_COLUMNS[4:10]},
                    "displacement_um": float(moved),
                    "neighbours": " ".join(map(str, others)),
                    "grade": judged.grade,
                    "shape_error_um": nan if off is None else off,
                    "message": "; ".join(filter(None, words)),
                }
            )
            last[number] = center
    return rows
