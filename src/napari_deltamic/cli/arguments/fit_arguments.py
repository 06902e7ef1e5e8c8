"""What ``fit`` takes, and what every other command that fits takes too."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, get_args

from ...common.choices import EFFECTS, DensityModel, DeviceChoice, Likelihood
from ...errors import InputError
from ...runs.fit_settings import FitSettings, validated
from ..folders import check_folder
from ..optics_arguments import add_optics, optics_values
from .argument_checks import TRIPLE, check_files, help_of

CHECKPOINT = "checkpoint.npz"
# What one would not want to lose; the other results belong to them.
PRECIOUS = ("report.json", "mesh.ply", "mesh.rec", CHECKPOINT)
FIT_OPTIONS = (
    "accuracy",
    "fit_psf",
    "density",
    "likelihood",
    "levels",
    "remesh",
    "collisions",
    "topology",
    "as_in_the_paper",
    "max_iterations",
    "device",
)


def add_parser(commands: Any) -> None:
    """Add the command to the parser of all."""
    parser = commands.add_parser(
        "fit",
        help="fit meshes, and the PSF, to an image",
        description="Fit meshes to an image. Writes mesh.ply, mesh.rec, rendered.tif, "
        "measurements.csv, run.toml, report.json and picture.png.",
    )
    add = parser.add_argument
    add("image", nargs="?", metavar="IMAGE", help=".tif or .npy; not needed with --settings")
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
    """Add what every command that fits takes: seeds, scene, settings of a fit, and the folder."""
    add_fit_options(parser)
    add = parser.add_argument
    add("--overwrite", action="store_true", help="replace the results in DIR")
    add("-o", "--output", required=True, metavar="DIR", help="folder for the results")


def add_fit_options(parser: argparse.ArgumentParser) -> None:
    """Add what describes a fit: seeds, scene and settings."""
    add = parser.add_argument
    add("--seeds", metavar="FILE", help="mesh, label image, or CSV (z,y,x or z,y,x,radius; um)")
    add("--voxel-size", nargs=3, type=float, metavar=TRIPLE, help="um; else from the image file")
    add(
        "--sigma",
        nargs=3,
        type=float,
        metavar=TRIPLE,
        help="um; standard deviations of the PSF (default: 1.2 voxels)",
    )
    add_optics(parser)
    add("--fit-psf", action=argparse.BooleanOptionalAction, default=None, help=_help("fit_psf"))
    add("--accuracy", type=float, metavar="A", help=_help("accuracy"))
    names = ", ".join(EFFECTS)
    add("--effects", metavar="E", help=f"auto, none, or some of {names}, with commas between")
    add("--density", choices=get_args(DensityModel), help=_help("density"))
    for name in ("remesh", "collisions", "topology"):
        add(f"--{name}", action=argparse.BooleanOptionalAction, default=None, help=_help(name))
    add("--likelihood", choices=get_args(Likelihood), help=_help("likelihood"))
    add("--levels", nargs="+", type=float, metavar="B", help=_help("levels"))
    paper = "as_in_the_paper"
    add("--as-in-the-paper", action="store_true", default=None, help=_help(paper))
    add("--max-iterations", type=int, metavar="N", help=_help("max_iterations"))
    add("--device", choices=get_args(DeviceChoice), help=_help("device"))
    add("--settings", metavar="run.toml", help="settings of a former run; other options prevail")
    add("--missing-nan", action="store_true", help="leave out voxels that are NaN or infinite")


def check_fit_options(arguments: argparse.Namespace, command: str) -> None:
    """Refuse what cannot be, of all that :func:`add_fit_options` adds but voxel size and effects.

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
    given = {name: getattr(arguments, name) for name in FIT_OPTIONS}
    validated(FitSettings, {name: value for name, value in given.items() if value is not None})
    optics_values(arguments)


def _check(arguments: argparse.Namespace) -> None:
    folder = Path(arguments.output)
    check_folder(folder, PRECIOUS, overwrite=arguments.overwrite, but=arguments.resume)
    check_files(arguments, "image")
    check_fit_options(arguments, "fit")
    if arguments.effects == "auto" and arguments.resume:
        raise InputError("--resume goes on with the effects of its run.toml; leave out 'auto'")


def _add_second_view(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "second view", "the same scene through another PSF, registered to IMAGE, on its voxels"
    )
    add = group.add_argument
    add("--second-view", metavar="FILE", help="image of the second view, .tif or .npy")
    add(
        "--second-sigma",
        nargs=3,
        type=float,
        metavar=TRIPLE,
        help="um; standard deviations of its PSF, which is held",
    )


def _help(name: str) -> str:
    return help_of(FitSettings, name)
