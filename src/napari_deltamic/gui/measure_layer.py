"""Measurements of a Surface layer, from napari's menu: tables in a folder, cells as labels."""

# No annotations as strings here: magicgui makes the fields of them.
from pathlib import Path
from typing import Annotated, Any, Optional

from magicgui import magic_factory
from napari.layers import Image, Surface
from napari.qt.threading import FunctionWorker, create_worker
from napari.types import LayerDataTuple

from ..common.writing import own_folder
from ..errors import InputError
from ..measure import Known, measure
from ..results.measured_files import write_measurements
from ..results.mesh_exchange import labels_of
from .seeding.seed_kinds import mesh_of_surface
from .viewing.cell_layers import labels_options
from .viewing.frame import Frame, shape_of

_WORLD = Frame((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), ("um",) * 3)


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
        options = labels_options(measured.cells.rows, frame, f"{name}: cells")
        return [(labels_of(mesh, grid), options, "labels")]

    return create_worker(work, _start_thread=True)


measure_widget = magic_factory(measure_surface, call_button="Measure")
