"""The arguments by which commands take a PSF, and what they say."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from ..common.choices import IMMERSIONS, Modality, PSFModel
from ..errors import InputError
from ..runs.optics_settings import (
    GaussianOptics,
    MeasuredOptics,
    MicroscopeOptics,
    optics_from_toml,
    optics_from_values,
)
from .arguments.argument_checks import TRIPLE, help_of

if TYPE_CHECKING:
    from ..optics import Optics

# Argument -> field of MicroscopeOptics.
_MICROSCOPE = {
    "na": "na",
    "wavelength": "wavelength",
    "modality": "modality",
    "immersion": "immersion",
    "excitation": "excitation",
    "pinhole": "pinhole",
    "sheet": "sheet",
    "sample_index": "sample_index",
    "depth": "depth",
    "psf_model": "model",
}
_MEASURED = ("psf_voxel_size", "bead_diameter")
OPTICS_ARGUMENTS = ("optics", "psf", *_MEASURED, *_MICROSCOPE)


def add_grid_and_optics(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of a grid and a PSF, where no image gives any."""
    add = parser.add_argument
    add("--shape", nargs=3, type=int, metavar=TRIPLE, required=True, help="voxels")
    add("--voxel-size", nargs=3, type=float, metavar=TRIPLE, required=True, help="um")
    add(
        "--sigma",
        nargs=3,
        type=float,
        metavar=TRIPLE,
        help="um; standard deviations of the PSF",
    )
    add_optics(parser)


def add_optics(parser: Any) -> None:
    """Add the arguments, all but --sigma, which every command words itself."""
    group = parser.add_argument_group(
        "PSF", "instead of --sigma: a file of settings, the image of a bead, or the objective"
    )
    add = group.add_argument
    add("--optics", metavar="FILE.toml", help="settings of a PSF")
    add("--psf", metavar="FILE", help="image of one bead, .tif or .npy")
    add("--psf-voxel-size", nargs=3, type=float, metavar=TRIPLE, help="um; else from its file")
    add("--bead-diameter", type=float, metavar="D", help=help_of(MeasuredOptics, "bead_diameter"))
    for name in ("na", "wavelength"):
        add(f"--{name}", type=float, metavar=name.upper(), help=help_of(MicroscopeOptics, name))
    add("--modality", choices=get_args(Modality), help=help_of(MicroscopeOptics, "modality"))
    known = ", ".join(IMMERSIONS)
    add("--immersion", type=_immersion, metavar="M", help=f"{known}, or a refractive index")
    for name in ("excitation", "pinhole", "sheet", "sample_index", "depth"):
        option = f"--{name.replace('_', '-')}"
        add(option, type=float, metavar="X", help=help_of(MicroscopeOptics, name))
    add("--psf-model", choices=get_args(PSFModel), help=help_of(MicroscopeOptics, "model"))


def optics_values(arguments: argparse.Namespace) -> dict[str, Any] | None:
    """Settings of the PSF that the arguments give, as plain values; None where they give none.

    Raises
    ------
    InputError
        If they give two, or not all that one needs.
    """
    given = {name: getattr(arguments, name) for name in _MICROSCOPE}
    numbers = {_MICROSCOPE[name]: value for name, value in given.items() if value is not None}
    ways = [f"--{name}" for name in ("sigma", "optics", "psf") if getattr(arguments, name)]
    if numbers:
        first = next(name for name, value in given.items() if value is not None)
        ways.append(f"--{first.replace('_', '-')}")
    if len(ways) > 1:
        raise InputError(f"{' and '.join(ways)} both say what the PSF is: give one of them")
    for name in _MEASURED:
        if getattr(arguments, name) is not None and not arguments.psf:
            raise InputError(f"--{name.replace('_', '-')} belongs to --psf")
    if arguments.optics:
        return _plain(optics_from_toml(arguments.optics))
    if arguments.psf:
        values: dict[str, Any] = {"kind": "measured", "file": str(Path(arguments.psf).absolute())}
        if arguments.psf_voxel_size is not None:
            values["voxel_size"] = tuple(arguments.psf_voxel_size)
        if arguments.bead_diameter is not None:
            values["bead_diameter"] = arguments.bead_diameter
        return values
    if not numbers:
        return None
    for name in ("na", "wavelength"):
        if name not in numbers:
            raise InputError(f"a PSF from the objective needs --{name} too")
    return _plain(optics_from_values({"kind": "microscope", **numbers}))


def optics_options(settings: Any) -> list[str]:
    """The arguments that give settings of a PSF, the other way round.

    Raises
    ------
    InputError
        If only a file of settings can.
    """
    if isinstance(settings, MeasuredOptics) and settings.bead == "solid":
        words = ["--psf", settings.file]
        if settings.voxel_size is not None:
            words += ["--psf-voxel-size", *(f"{d:.6g}" for d in settings.voxel_size)]
        if settings.bead_diameter:
            words += ["--bead-diameter", f"{settings.bead_diameter:.6g}"]
        return words
    own = isinstance(settings, MicroscopeOptics)
    if not own or settings.zernike or settings.fitted is not None:
        raise InputError(
            "no arguments of the command line give this PSF: save the results, whose run.toml "
            "repeats the run"
        )
    words = []
    for argument, name in _MICROSCOPE.items():
        value = getattr(settings, name)
        if value != MicroscopeOptics.model_fields[name].default:
            text = value if isinstance(value, str) else f"{value:.6g}"
            words += [f"--{argument.replace('_', '-')}", text]
    return words


def optics_from_arguments(arguments: argparse.Namespace) -> Optics:
    """The PSF; InputError where none is given."""
    values = optics_values(arguments)
    if values is not None:
        return optics_from_values(values).build()
    if arguments.sigma is None:
        raise InputError("give the PSF: --sigma Z Y X, --na and --wavelength, --psf, or --optics")
    return GaussianOptics(sigma=tuple(arguments.sigma)).build()


def _plain(settings: Any) -> dict[str, Any]:
    found: dict[str, Any] = settings.model_dump(exclude_none=True)
    return found


def _immersion(text: str) -> str | float:
    try:
        return float(text)
    except ValueError:
        return text
