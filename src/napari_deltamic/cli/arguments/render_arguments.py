"""The arguments of ``render``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ...common.choices import EFFECTS, IMAGE_FILES, RENDERED_ACCURACY, ZARR
from ...errors import InputError
from ...geometry.formats import MESH_FILES_LISTED
from ..optics_arguments import add_grid_and_optics, optics_values
from .argument_checks import check_file_to_write, check_files, check_given_accuracy


def add_parser(commands: Any) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "render",
        help="the image of a mesh under a PSF",
        description="Render the image that a microscope would show of the surface of a mesh.",
    )
    add = parser.add_argument
    add("mesh", metavar="MESH", help=f"{MESH_FILES_LISTED}; x, y, z in um")
    add_grid_and_optics(parser)
    add(
        "--accuracy",
        type=float,
        default=RENDERED_ACCURACY,
        metavar="A",
        help="relative L2 error of the image; 0 is the closed form (default: %(default)s)",
    )
    add(
        "--effects",
        metavar="E",
        help=f"some of {', '.join(EFFECTS)}, separated by commas, with their numbers, such as "
        "halo:fraction=0.1:width=2",
    )
    add("--overwrite", action="store_true", help="replace the image if it is there")
    add("-o", "--output", required=True, metavar="IMAGE", help=".tif, .npy or .zarr")
    parser.set_defaults(module="render_command", check=_check)


def _check(arguments: argparse.Namespace) -> None:
    path = Path(arguments.output)
    if path.suffix.lower() not in IMAGE_FILES:
        raise InputError(f"{path}: unknown image extension '{path.suffix}'; use .tif")
    check_file_to_write(path, folder=path.suffix.lower() == ZARR)
    if path.exists() and not arguments.overwrite:
        raise InputError(f"{path} is there already; --overwrite replaces it")
    check_given_accuracy(arguments)
    check_files(arguments, "mesh")
    optics_values(arguments)
