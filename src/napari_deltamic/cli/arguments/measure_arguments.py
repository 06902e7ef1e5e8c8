"""The arguments of ``measure``."""

from __future__ import annotations

import argparse
from math import isfinite
from pathlib import Path
from typing import Any

from ...common.choices import IMAGE_FILES
from ...errors import InputError
from ...results.measured_names import FURTHER, MEASURED
from ...runs.scene_settings import RunFields
from ..flags import TRIPLE, add_flags
from ..folders import check_folder, check_kept
from .argument_checks import check_channel, check_files

_WRITTEN = (*MEASURED, *FURTHER)


def add_parser(commands: Any) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "measure",
        help="volumes, areas, curvatures, contacts, angles, tensions: tables and files",
        description="Measure the cells, walls and junctions of a mesh. Writes cells.csv, "
        "walls.csv, junctions.csv, cells and walls as .vtk and .ply with these numbers on every "
        "face, labels.ome.tif, and measurements.html, a page about it all. For tracks: tracks.csv "
        "and tracks.geff, for other trackers.",
    )
    add = parser.add_argument
    add(
        "source",
        metavar="MESH_OR_SESSION",
        help="mesh file (um), session (.deltamic), or the folder that fit or track wrote",
    )
    add(
        "--image",
        metavar="FILE",
        help="image that the mesh was fitted to: tells which cells its border cuts",
    )
    text = (
        "channel of that image that the mesh was fitted to: number, from 1, or name (default: as "
        "in the fit)"
    )
    add_flags(parser, RunFields, ("channel",), helps={"channel": text})
    add("--voxel-size", nargs=3, type=float, metavar=TRIPLE, help="um; voxel size of that image")
    add(
        "--label-voxel",
        nargs=3,
        type=float,
        metavar=TRIPLE,
        help="um; voxel size of the label image (default: that of the image; without an image no "
        "labels are written)",
    )
    add(
        "--other-channel",
        metavar="FILE_OR_N",
        help="how much of another channel is on walls, in cells: a file, or a channel of the image",
    )
    add(
        "--other-channel-on",
        choices=("both", "walls", "insides"),
        default="both",
        help="what is labelled in it (default: %(default)s)",
    )
    add(
        "--other-channel-sigma",
        nargs=3,
        type=float,
        metavar=TRIPLE,
        help="um; standard deviations of its PSF, to start with (default: those of the fit)",
    )
    add(
        "--images",
        choices=("tif", "zarr"),
        help="also write the rendered image and the residual; with the labels as OME-TIFF or "
        "OME-Zarr",
    )
    add("--errors", action="store_true", help="also standard errors; only for a session, and slow")
    add("--overwrite", action="store_true", help="replace the results in DIR")
    add("-o", "--output", required=True, metavar="DIR", help="folder for the results")
    parser.set_defaults(module="measure_command", check=_check)


def _check(arguments: argparse.Namespace) -> None:
    check_files(arguments, "source", "image")
    check_channel(arguments)
    if _is_image(arguments.channel):
        raise InputError("--channel is one of the image: give a file to --other-channel")
    if _is_image(arguments.other_channel):
        check_files(arguments, "other_channel")
    for name in ("voxel_size", "label_voxel", "other_channel_sigma"):
        size = getattr(arguments, name)
        if size is not None and not all(isfinite(d) and d > 0 for d in size):
            option = name.replace("_", "-")
            raise InputError(f"--{option} must be three positive numbers (um)")
    folder = Path(arguments.output)
    check_folder(folder, _WRITTEN, overwrite=arguments.overwrite)
    check_kept(folder, _WRITTEN, arguments.source, arguments.image, arguments.other_channel)


def _is_image(text: str | None) -> bool:
    """Whether a text names an image file rather than a channel."""
    return text is not None and Path(text).suffix.lower() in IMAGE_FILES
