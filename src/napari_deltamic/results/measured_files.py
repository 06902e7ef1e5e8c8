"""Writes what was measured: tables, meshes with their numbers, labels."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ..common.triple import Triple
from ..common.writing import make_folder, write_atomically, written_together
from ..geometry import Mesh, save_mesh
from ..images.stacks import write_image
from ..measure import Measurements, Table
from ..scene import Grid
from .measured_names import MEASURED as MEASURED
from .mesh_exchange import cells_apart, labels_grid, labels_of, wall_attributes


def write_measurements(
    folder: str | os.PathLike[str],
    mesh: Mesh,
    measured: Measurements,
    *,
    grid: Grid | None = None,
    voxel_size: Triple | None = None,
    page: str = "",
    further: Sequence[Table] = (),
    images: Mapping[str, NDArray[Any]] | None = None,
    image_suffix: str = ".ome.tif",
) -> list[Path]:
    """Write what was measured on a mesh; files of the same names are replaced, all or none.

    ``cells.csv``, ``walls.csv`` and ``junctions.csv`` (units in the headers); ``cells.vtk`` and
    ``cells.ply`` (every cell a closed surface) and ``walls.vtk`` and ``walls.ply`` (one mesh, walls
    shared) with the numbers of their tables on each face; ``labels.ome.tif``, if a voxel size is
    known; ``measurements.html``, if there is a page.

    Parameters
    ----------
    folder
        Made if it is not there.
    grid
        Of the image; labels then fill the same volume.
    voxel_size
        um, of the labels; by default that of the image.
    page
        Text of the page, from :func:`~.html_page.html_page`; empty for none.
    further
        Further tables, such as those of another channel.
    images
        By name, on the voxels of the grid: written beside the labels.
    image_suffix
        Of labels and images: .ome.tif or .ome.zarr.

    Returns
    -------
    list of paths, in the order of ``MEASURED``, further tables after the three, images at the end.

    Raises
    ------
    InputError
        If the voxel size is impossible, or the folder or a file cannot be written.
    """
    folder = Path(folder)
    size = voxel_size or (None if grid is None else grid.voxel_size)
    place = None if size is None else labels_grid(mesh, size, grid)
    make_folder(folder)
    apart, of_cells = cells_apart(mesh, measured)
    of_walls = wall_attributes(mesh, measured)
    paths = []
    with written_together(folder / "cells.csv"):
        for table in (*measured.tables, *further):
            paths.append(folder / f"{table.name}.csv")
            write_atomically(paths[-1], table.to_csv().encode())
        for name, one, numbers in (("cells", apart, of_cells), ("walls", mesh, of_walls)):
            for suffix in (".vtk", ".ply"):
                paths.append(folder / f"{name}{suffix}")
                save_mesh(one, paths[-1], numbers)
        if place is not None:
            paths.append(folder / f"labels{image_suffix}")
            write_image(paths[-1], labels_of(mesh, place), place.voxel_size, place.origin)
        if page:
            paths.append(folder / "measurements.html")
            write_atomically(paths[-1], page.encode())
        for name, pixels in (images or {}).items():
            assert grid is not None, "images have a grid"
            paths.append(folder / f"{name}{image_suffix}")
            write_image(paths[-1], pixels, grid.voxel_size, grid.origin)
    return paths
