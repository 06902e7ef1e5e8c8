"""The arguments of ``fit``, and those shared by every command that fits."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ...common.choices import EFFECTS
from ...errors import InputError
from ...runs.fit_settings import FitSettings, validated
from ...runs.scene_settings import RunFields, SceneFields
from ..flags import TRIPLE, add_flags, values_given
from ..folders import check_folder
from ..optics_arguments import add_optics, optics_values
from .argument_checks import check_channel, check_files

CHECKPOINT = "checkpoint.npz"
_GOING_ON = ("report.json", "mesh.ply", "mesh.rec", CHECKPOINT)
# Files that one would not want to lose; unrelated files may have such names, too.
PRECIOUS = (
    *_GOING_ON,
    "run.toml",
    "rendered.tif",
    "residual.tif",
    "measurements.csv",
    "picture.png",
)
_SCENE = ("voxel_size", "sigma", "effects")


def add_parser(commands: Any) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "fit",
        help="fit meshes, and the PSF, to an image",
        description="Fit meshes to an image. Writes mesh.ply, mesh.rec, rendered.tif, "
        "measurements.csv, run.toml, report.json and picture.png.",
    )
    add = parser.add_argument
    add("image", nargs="?", metavar="IMAGE", help=".tif, .npy or .zarr; not needed with --settings")
    add("--resume", metavar="CHECKPOINT", help="go on from a checkpoint of the same fit")
    add(
        "--residual",
        action="store_true",
        help="also write residual.tif: where the model does not explain the image, in standard "
        "deviations",
    )
    _add_second_view(parser)
    add_options(parser)
    parser.set_defaults(module="fit_command", check=_check)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of every command that fits: seeds, scene, fit settings, and the folder."""
    add_fit_options(parser)
    add = parser.add_argument
    add("--overwrite", action="store_true", help="replace the results in DIR")
    add("-o", "--output", required=True, metavar="DIR", help="folder for the results")


def add_fit_options(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that describe a fit: seeds, scene and settings."""
    add_flags(parser, RunFields)
    known = ", ".join(EFFECTS)
    text = f"auto, none, or some of {known}, separated by commas"
    add_flags(parser, SceneFields, _SCENE, helps={"effects": text})
    add_optics(parser)
    add_flags(parser, FitSettings)
    add = parser.add_argument
    add("--settings", metavar="run.toml", help="settings of an earlier run; options override them")
    add("--missing-nan", action="store_true", help="leave out voxels that are NaN or infinite")


def check_fit_options(arguments: argparse.Namespace, command: str) -> None:
    """Check the arguments of :func:`add_fit_options`, except voxel size and effects.

    Raises
    ------
    InputError
        Naming the option, or the file that is not there.
    """
    if arguments.settings is not None and not Path(arguments.settings).is_file():
        raise InputError(f"cannot read settings from {arguments.settings}: there is no such file")
    for name, wanted in (("image", "IMAGE"), ("seeds", "--seeds FILE")):
        if arguments.settings is None and getattr(arguments, name) is None:
            raise InputError(
                f"{command} needs {wanted}, or --settings with a run.toml that names it"
            )
    check_files(arguments, "seeds")
    check_channel(arguments)
    validated(FitSettings, values_given(arguments, FitSettings))
    optics_values(arguments)


def _check(arguments: argparse.Namespace) -> None:
    folder = Path(arguments.output)
    # Beside a checkpoint lies the run.toml of the same fit.
    names = _GOING_ON if arguments.resume else PRECIOUS
    check_folder(folder, names, overwrite=arguments.overwrite, but=arguments.resume)
    check_files(arguments, "image")
    check_fit_options(arguments, "fit")
    if arguments.effects == "auto" and arguments.resume:
        raise InputError("--resume goes on with the effects of its run.toml; leave out 'auto'")


def _add_second_view(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "second view", "the same scene through another PSF, registered to IMAGE, on its voxels"
    )
    add = group.add_argument
    text = "image of the second view, .tif or .npy"
    add("--second-view", dest="view_file", metavar="FILE", help=text)
    add(
        "--second-sigma",
        dest="view_sigma",
        nargs=3,
        type=float,
        metavar=TRIPLE,
        help="um; standard deviations of its PSF, which is kept fixed",
    )
