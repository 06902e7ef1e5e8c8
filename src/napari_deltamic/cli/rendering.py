"""``napari-deltamic render``: the image of a mesh under a PSF."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..geometry import load_mesh
from ..images import EXTENSIONS, write_image
from ..inference.checks import check_mesh
from ..scene import Grid, render
from .messages import Notes, failure
from .optics_arguments import add_grid_and_optics, optics_from_arguments


def add_parser(commands: Any) -> None:
    """Add the command to the parser of all."""
    parser = commands.add_parser(
        "render",
        help="the image of a mesh under a PSF",
        description="Render the image that a microscope would show of the surface of a mesh.",
    )
    add = parser.add_argument
    add("mesh", metavar="MESH", help=".ply, .obj, .off, .stl, .rec or .vtk; x, y, z in um")
    add_grid_and_optics(parser)
    add(
        "--accuracy",
        type=float,
        default=1e-3,
        metavar="A",
        help="relative L2 error of the image; 0 is the closed form (default: %(default)s)",
    )
    add(
        "--pixel-integration",
        action="store_true",
        help="a voxel integrates over its size, rather than sampling at its centre",
    )
    add("--overwrite", action="store_true", help="replace the image if it is there")
    add("-o", "--output", required=True, metavar="IMAGE", help=".tif or .npy")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace, notes: Notes) -> int:
    """Render and write; prints the path."""
    output = Path(arguments.output)
    _check_output(output, arguments.overwrite)
    grid = Grid(tuple(arguments.shape), tuple(arguments.voxel_size))
    optics = optics_from_arguments(arguments)
    if not 0 <= arguments.accuracy < 1:
        raise InputError(f"accuracy must be at least 0 and below 1, not {arguments.accuracy:g}")
    mesh = load_mesh(arguments.mesh)
    check_mesh(mesh, grid)
    notes.release()
    try:
        effects = ("pixel_integration",) if arguments.pixel_integration else ()
        image = render(mesh, grid, optics, arguments.accuracy, effects=effects)
        write_image(output, image.numpy(), grid.voxel_size)
    except (MemoryError, RuntimeError) as error:
        raise failure(error, grid.shape) from error
    print(output)
    return 0


def _check_output(path: Path, overwrite: bool) -> None:
    """Refuse before any work what could not be written after it."""
    if path.suffix.lower() not in EXTENSIONS:
        raise InputError(f"{path}: unknown image extension '{path.suffix}'; use .tif")
    if path.is_dir():
        raise InputError(f"{path} is a folder; name an image")
    if path.exists() and not overwrite:
        raise InputError(f"{path} is there already; --overwrite replaces it")
    if not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise InputError(f"{path.parent}: no folder that can be written to")
