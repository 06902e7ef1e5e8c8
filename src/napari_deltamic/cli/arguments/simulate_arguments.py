"""The arguments of ``simulate``."""

from __future__ import annotations

import argparse
from typing import Any, get_args

from ...common.choices import Bits, CellKind
from ...errors import InputError
from ...geometry.formats import MESH_FILES_LISTED
from ..optics_arguments import add_grid_and_optics, optics_values
from .argument_checks import check_files

_MOST = 100_000  # images of one set


def add_parser(commands: Any) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "simulate",
        help="make noisy images whose cells are known, for tests, teaching and training",
        description="Simulate an image of a mesh, or of random cells. Writes image.tif, "
        "noise_free.tif, mesh.ply, mesh.rec, labels.tif, parameters.json, and run.toml, which fits "
        "the image. The same options give the same bytes.",
    )
    add = parser.add_argument
    add("mesh", nargs="?", metavar="MESH", help=f"{MESH_FILES_LISTED}; um")
    add("--cells", type=int, metavar="N", help="make N random cells instead of using a mesh")
    add("--kind", choices=get_args(CellKind), help="kind of random cells (default: foam)")
    add_grid_and_optics(parser)
    add(
        "--interior",
        type=float,
        default=0.0,
        metavar="I",
        help="light inside cells: fluorophores per um^3, for one per um^2 of membrane (default: 0)",
    )
    add(
        "--effects",
        default="none",
        metavar="E",
        help="effects with their numbers, such as "
        "attenuation=0.02,halo=0.1,camera:gain=2:offset=100",
    )
    add("--photons", type=float, metavar="P", help="photons in the brightest voxel (default: 100)")
    add(
        "--photons-per-um2",
        type=float,
        metavar="P",
        help="photons per um^2 of membrane, instead of those in the brightest voxel",
    )
    add("--background", type=float, metavar="B", help="photons (default: a tenth of the brightest)")
    add(
        "--bits",
        type=int,
        choices=get_args(Bits),
        default=16,
        help="bits of an intensity; 32 is float32 (default: %(default)s)",
    )
    add("--seed", type=int, default=0, metavar="S", help="random seed (default: 0)")
    add("--count", type=int, default=1, metavar="N", help="number of images, seeds S, S+1, ...")
    add("--overwrite", action="store_true", help="replace the results in DIR")
    add(
        "-o",
        "--output",
        required=True,
        metavar="DIR",
        help="folder for the results; with --count, a folder in it for each image",
    )
    parser.set_defaults(module="simulate_command", check=_check)


def _check(arguments: argparse.Namespace) -> None:
    if not 1 <= arguments.count <= _MOST:
        raise InputError(f"--count must be 1 to {_MOST}, not {arguments.count}")
    if (arguments.mesh is None) == (arguments.cells is None):
        raise InputError("simulate needs MESH or --cells N" + ", not both" * bool(arguments.mesh))
    if arguments.mesh is not None and arguments.kind is not None:
        raise InputError("--kind goes with --cells, not with a mesh")
    check_files(arguments, "mesh")
    optics_values(arguments)
