"""The arguments of ``accuracy``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ...common.choices import IMAGE_FILES
from ...errors import InputError
from ...geometry.formats import MESH_FILES
from ...runs.scene_settings import RunFields, SceneFields
from ..flags import TRIPLE, add_flags
from ..folders import check_folder
from ..optics_arguments import add_optics, optics_values
from .argument_checks import check_channel, check_files, check_given_accuracy

_FILES = ("accuracy.json", "accuracy.png", "shape.png")


def add_parser(commands: Any) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "accuracy",
        help="what accuracy costs in time, on your scene and machine",
        description="Time every way to render a scene and compare it with the exact one. The scene "
        "is a mesh with --shape, --voxel-size and a PSF, or an image with --seeds.",
    )
    add = parser.add_argument
    add("scene", metavar="MESH or IMAGE", help=f"{', '.join(MESH_FILES)}; or .tif, .npy")
    add("--shape", nargs=3, type=int, metavar=TRIPLE, help="voxels (with a mesh)")
    add("--seeds", metavar="FILE", help="mesh, label image, or CSV of points (with an image)")
    add_flags(parser, RunFields, ("channel",))
    add_flags(parser, SceneFields, ("voxel_size", "sigma"))
    add_optics(parser)
    add(
        "--accuracy",
        type=float,
        metavar="A",
        help="accuracy in use (default: 1e-3 for a mesh, from the noise for an image)",
    )
    add(
        "--budget",
        type=float,
        default=10.0,
        metavar="S",
        help="ways that would take longer are listed but not measured (default: %(default)g s)",
    )
    add(
        "--shape-error",
        action="store_true",
        help="also fit simulated images, quick, normal and careful: the error of the surface",
    )
    add(
        "--photons",
        type=float,
        metavar="P",
        help="photons at the peak of the simulated images (with a mesh)",
    )
    add("--draws", type=int, metavar="N", help="noisy images per choice, for --shape-error")
    add("--missing-nan", action="store_true", help="leave out voxels that are NaN or infinite")
    add("--overwrite", action="store_true", help="replace the results in DIR")
    add("-o", "--output", metavar="DIR", help="folder for accuracy.json and the pictures")
    parser.set_defaults(module="accuracy_command", check=_check)


def _check(arguments: argparse.Namespace) -> None:
    if arguments.output:
        check_folder(Path(arguments.output), _FILES, overwrite=arguments.overwrite)
    if not arguments.budget > 0:
        raise InputError(f"budget must be a positive number of seconds, not {arguments.budget:g}")
    if arguments.draws is not None and arguments.draws < 1:
        raise InputError("--draws must be 1 or more")
    check_given_accuracy(arguments)
    kind = Path(arguments.scene).suffix.lower()
    if kind in MESH_FILES:
        _check_mesh(arguments)
    elif kind in IMAGE_FILES:
        _check_image(arguments)
    else:
        known = ", ".join((*MESH_FILES, *IMAGE_FILES))
        raise InputError(f"{arguments.scene}: unknown extension '{kind}'; known are {known}")
    check_files(arguments, "scene", "seeds")
    optics_values(arguments)


def _check_mesh(arguments: argparse.Namespace) -> None:
    for name in ("shape", "voxel_size"):
        if getattr(arguments, name) is None:
            raise InputError(f"a mesh needs --{name.replace('_', '-')} Z Y X")
    if arguments.seeds is not None:
        raise InputError("--seeds goes with an image, not with a mesh")
    if arguments.channel is not None:
        raise InputError("--channel goes with an image, not with a mesh")
    if arguments.shape_error and not (arguments.photons and arguments.photons > 0):
        raise InputError("--shape-error with a mesh needs --photons P, at the peak of the images")


def _check_image(arguments: argparse.Namespace) -> None:
    if arguments.shape is not None:
        raise InputError("--shape goes with a mesh; an image has its own")
    if arguments.photons is not None:
        raise InputError("--photons goes with a mesh; an image has its own noise")
    if arguments.seeds is None:
        raise InputError("an image needs --seeds FILE")
    check_channel(arguments)
