"""The arguments of ``track``."""

from __future__ import annotations

import argparse
from typing import Any

from ...errors import InputError
from ...runs.fit_settings import validated
from ...runs.track_settings import TrackSettings
from ..flags import add_flags, values_given
from .fit_arguments import add_options, check_fit_options


def add_parser(commands: Any) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "track",
        help="track cells through a series of images",
        description="Fit every frame of a series from the one before; cells keep their numbers, "
        "divide, and end. Writes mesh_t000.ply and .vtk for each frame, tracks.csv, surface.npz, "
        "run.toml and report.json.",
    )
    add = parser.add_argument
    add(
        "image",
        nargs="?",
        metavar="IMAGE4D",
        help="a .tif or .npy file (T, Z, Y, X), a folder of 3D files, or a pattern in quotes, such "
        "as 'movie/t*.tif'; not needed with --settings",
    )
    add("--frames", metavar="A:B", help="frames A, to which the seeds belong, to B-1")
    add_flags(parser, TrackSettings)
    add("--resume", metavar="DIR", help="go on after the frames that an earlier run wrote to DIR")
    add_options(parser)
    parser.set_defaults(module="track_command", check=_check)


def track_values(arguments: argparse.Namespace) -> dict[str, object]:
    """Settings of tracking given by the arguments; InputError if they are not possible."""
    values: dict[str, object] = values_given(arguments, TrackSettings)
    if arguments.frames is not None:
        first, colon, stop = arguments.frames.partition(":")
        try:
            numbers = [int(word) if word else None for word in (first, stop)]
        except ValueError:
            numbers = []
        if not colon or len(numbers) != 2:
            raise InputError(f"--frames must be A:B, such as 0:10, not '{arguments.frames}'")
        values |= {"first": numbers[0] or 0, "stop": numbers[1]}
    validated(TrackSettings, values)
    return values


def _check(arguments: argparse.Namespace) -> None:
    check_fit_options(arguments, "track")
    track_values(arguments)
