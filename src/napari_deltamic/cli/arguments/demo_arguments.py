"""The arguments of ``demo``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..folders import check_folder
from .fit_arguments import PRECIOUS

_OUTPUT = "demo-output"
_WRITTEN = (*PRECIOUS, "image.tif", "seeds.ply", "truth.ply")


def add_parser(commands: Any) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "demo",
        help="fit a cell whose true surface is known, live in napari if there is a display",
        description="Fit a dividing cell whose true surface is known: live in napari, or, without "
        "a display or without napari, into a folder, with how far the result is from the truth.",
    )
    add = parser.add_argument
    add("--headless", action="store_true", help="open no window, write files")
    add("--overwrite", action="store_true", help="replace the results in DIR")
    add(
        "-o",
        "--output",
        default=_OUTPUT,
        metavar="DIR",
        help="where to write them (default: %(default)s, whose results are replaced)",
    )
    parser.set_defaults(module="demo_command", check=_check)


def _check(arguments: argparse.Namespace) -> None:
    overwrite = arguments.overwrite or arguments.output == _OUTPUT
    check_folder(Path(arguments.output), _WRITTEN, overwrite=overwrite)
