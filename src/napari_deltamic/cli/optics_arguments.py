"""The arguments that describe a PSF, and the PSF that they give."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.description import described
from ..errors import InputError
from ..runs.optics_settings import (
    GaussianOptics,
    MeasuredOptics,
    MicroscopeOptics,
    optics_from_toml,
    optics_from_values,
)
from ..runs.scene_settings import SceneFields
from .flags import TRIPLE, add_flags, dest_of, values_given

if TYPE_CHECKING:
    from ..optics import Optics

_MICROSCOPE, _BEAD = described(MicroscopeOptics), described(MeasuredOptics)
# Help texts where there is no image to take them from.
_GIVEN = {"voxel_size": "size of a voxel", "sigma": "standard deviations of the PSF"}
# Names of the arguments.
OPTICS_ARGUMENTS = ("optics", *(dest_of(d) for d in (*_BEAD.values(), *_MICROSCOPE.values())))


def add_grid_and_optics(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of a grid and a PSF, for commands without an image."""
    parser.add_argument("--shape", nargs=3, type=int, metavar=TRIPLE, required=True, help="voxels")
    helps = {name: f"um; {text}" for name, text in _GIVEN.items()}
    add_flags(parser, SceneFields, tuple(_GIVEN), required=("voxel_size",), helps=helps)
    add_optics(parser)


def add_optics(parser: Any) -> None:
    """Add the arguments of a PSF except --sigma, which every command words itself."""
    group = parser.add_argument_group(
        "PSF", "instead of --sigma: a file of settings, the image of a bead, or the objective"
    )
    add_flags(group, SceneFields, ("optics",), helps={"optics": "settings of a PSF"})
    add_flags(group, MeasuredOptics)
    add_flags(group, MicroscopeOptics)


def optics_values(arguments: argparse.Namespace) -> dict[str, Any] | None:
    """Settings of the PSF that the arguments describe, as plain values; None if they give none.

    Raises
    ------
    InputError
        If they describe two, or leave out something that one needs.
    """
    numbers = values_given(arguments, MicroscopeOptics)
    bead = values_given(arguments, MeasuredOptics)
    ways = [f"--{name}" for name in ("sigma", "optics", "psf") if getattr(arguments, name)]
    if numbers:
        ways.append(_MICROSCOPE[next(iter(numbers))].flag)
    if len(ways) > 1:
        raise InputError(f"{' and '.join(ways)} both say what the PSF is: give one of them")
    if bead and not arguments.psf:
        raise InputError(f"{_BEAD[next(iter(bead))].flag} belongs to --psf")
    if arguments.optics:
        return _plain(optics_from_toml(arguments.optics))
    if arguments.psf:
        bead["file"] = str(Path(arguments.psf).absolute())
        return _plain(optics_from_values({"kind": "measured", **bead}))
    if not numbers:
        return None
    for name in ("na", "wavelength"):
        if name not in numbers:
            raise InputError(f"a PSF from the objective needs --{name} too")
    return _plain(optics_from_values({"kind": "microscope", **numbers}))


def optics_from_arguments(arguments: argparse.Namespace) -> Optics:
    """The PSF that the arguments describe; InputError if they give none."""
    values = optics_values(arguments)
    if values is not None:
        return optics_from_values(values).build()
    if arguments.sigma is None:
        raise InputError("give the PSF: --sigma Z Y X, --na and --wavelength, --psf, or --optics")
    return GaussianOptics(sigma=tuple(arguments.sigma)).build()


def _plain(settings: Any) -> dict[str, Any]:
    found: dict[str, Any] = settings.model_dump(exclude_none=True)
    return found
