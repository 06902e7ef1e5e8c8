"""Measurements of a Surface layer, from napari's menu: tables in a folder, cells as labels."""

# No annotations as strings here: magicgui makes the fields of them.
from pathlib import Path
from typing import Annotated, Any, Optional

import numpy as np
from magicgui import magic_factory
from napari.layers import Image, Surface
from napari.qt.threading import FunctionWorker, create_worker
from napari.types import LayerDataTuple

from ..common.writing import own_folder
from ..errors import InputError
from ..geometry import Mesh
from ..measure import Known, Measurements, measure
from ..results.exchange import labels_of
from ..results.measured_files import write_measurements
from ..scene import Grid
from .seeding.seed_kinds import mesh_of_surface
from .viewing.frame import OWN, Frame, shape_of

_WORLD = Frame((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), ("um",) * 3)
AXES = ("z", "y", "x")


def measure_surface(
    surface: Surface,
    image: Optional[Image] = None,  # noqa: UP045  (magicgui reads it)
    folder: Annotated[Path, {"mode": "d"}] = Path(),
) -> FunctionWorker[list[LayerDataTuple]]:
    """Measure the cells, walls and junctions of a Surface layer.

    Parameters
    ----------
    surface
        Meshes of a fit, or of a mesh file.
    image
        That they were fitted to: tells which cells its border cuts; cells then become a Labels
        layer on its voxels, with the measurements as features.
    folder
        For tables, meshes and labels; a new one, or one without measurements.
    """
    if surface is None:
        raise InputError("there is no Surface layer to measure")
    written = folder if folder != Path() else None
    if image is None and written is None:
        raise InputError("choose a folder for the tables, or an image for a layer with them")
    frame = _WORLD if image is None else Frame.of(image)
    grid = None if image is None else frame.grid(shape_of(image))
    mesh, name = mesh_of_surface(surface, frame), surface.name
    if written is not None and (written / "cells.csv").exists():
        raise InputError(f"{written} holds measurements already: choose another folder")

    def work() -> list[Any]:
        measured = measure(mesh, Known(grid=grid))
        if written is not None:
            with own_folder(written):
                write_measurements(written, mesh, measured, grid=grid)
        if grid is None:
            return []
        return [_labels_layer(mesh, measured, grid, frame, f"{name}: cells")]

    return create_worker(work, _start_thread=True)


measure_widget = magic_factory(measure_surface, call_button="Measure")


def _labels_layer(mesh: Mesh, measured: Measurements, grid: Grid, frame: Frame, name: str) -> Any:
    options = {
        **frame.image_options(),
        "axis_labels": AXES,
        "name": name,
        "opacity": 0.4,
        "features": features_of(measured),
        "metadata": {OWN: {"fit": True}},
    }
    return labels_of(mesh, grid), options, "labels"


def features_of(measured: Measurements) -> dict[str, Any]:
    """The table of cells as features of a Labels layer, a row for each label."""
    table = measured.cells
    found: dict[str, Any] = {"index": np.array(table.values("region"), np.int64)}
    for column in table.columns[1:]:
        values = table.values(column.name)
        words = any(isinstance(v, str) for v in values)
        if any(v is not None for v in values):
            empty = "" if words else np.nan
            found[column.name] = np.array([empty if v is None else v for v in values])
    return found
