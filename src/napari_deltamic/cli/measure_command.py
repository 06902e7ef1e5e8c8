"""``napari-deltamic measure``: tables and files of what is measured on a mesh."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..common.writing import own_folder
from ..errors import failure
from ..measure import measure
from ..results.html_page import html_page
from ..results.measured_files import write_measurements
from ..results.measured_source import Triple, measurable
from .messages import Notes, tell


def run(arguments: argparse.Namespace, notes: Notes) -> int:
    """Read, measure, write; prints the path of each result."""
    folder = Path(arguments.output)
    try:
        source = measurable(
            arguments.source, arguments.image, _triple(arguments.voxel_size), arguments.errors
        )
        for remark in source.remarks:
            notes.add(remark)
        measured = measure(source.mesh, source.known)
        with own_folder(folder):
            notes.release()
            size = _triple(arguments.label_voxel)
            paths = write_measurements(
                folder,
                source.mesh,
                measured,
                grid=source.grid,
                voxel_size=size,
                page=html_page(source, measured),
            )
    except (MemoryError, RuntimeError) as error:
        raise failure(error) from error
    for path in paths:
        tell(path)
    return 0


def _triple(values: list[float] | None) -> Triple | None:
    if values is None:
        return None
    z, y, x = values
    return z, y, x
