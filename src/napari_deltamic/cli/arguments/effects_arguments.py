"""The arguments of ``effects``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ...errors import InputError
from .argument_checks import check_file_to_write, check_files
from .fit_arguments import add_fit_options, check_fit_options


def add_parser(commands: Any) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "effects",
        help="which effects an image calls for",
        description="Fit an image without further effects and say which it calls for: the "
        "evidence, how far off the surface is without each, and what it costs. Changes nothing.",
    )
    add = parser.add_argument
    add("image", nargs="?", metavar="IMAGE", help=".tif, .npy or .zarr; not needed with --settings")
    add_fit_options(parser)
    add("--candidates", metavar="E", help="consider only these effects, separated by commas")
    add("--json", metavar="FILE", help="write everything found as JSON; - for stdout")
    parser.set_defaults(module="effects_command", check=_check)


def _check(arguments: argparse.Namespace) -> None:
    if arguments.effects == "auto":
        raise InputError("--effects names those that are in the scene already; leave out 'auto'")
    if arguments.json and arguments.json != "-":
        check_file_to_write(Path(arguments.json))
    check_files(arguments, "image")
    check_fit_options(arguments, "effects")
