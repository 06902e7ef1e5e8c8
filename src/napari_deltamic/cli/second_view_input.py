"""The arguments with which ``fit`` takes a second image of the same scene."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from ..common.choices import TIFF
from ..errors import InputError
from ..images.stacks import SIZES_AGREE, read_voxel_size
from ..runs.settings import SceneSettings, validated
from ..scene.effects import Effects, ViewEffect, kind_of


def with_second_view(scene: dict[str, Any], arguments: argparse.Namespace) -> None:
    """Add the second view that the arguments give, if any, to the values of a scene.

    Raises
    ------
    InputError
        If the file or the PSF is missing, or the PSF is not possible.
    """
    file = getattr(arguments, "view_file", None)
    sigma = getattr(arguments, "view_sigma", None)
    if file is None and sigma is None:
        return
    if file is None:
        raise InputError("--second-sigma belongs to --second-view FILE")
    if sigma is None:
        raise InputError("--second-view needs --second-sigma Z Y X (um), the widths of its PSF")
    if not Path(file).is_file():
        raise InputError(f"--second-view: there is no file {file}")
    view = validated(
        kind_of(ViewEffect), {"sigma": tuple(sigma), "image": str(Path(file).absolute())}
    )
    present = scene.get("effects") or Effects()
    if not isinstance(present, Effects):  # plain values, of a run.toml
        present = validated(Effects, present)
    scene["effects"] = present.adding(view)


def check_second_view(scene: SceneSettings) -> None:
    """Raise InputError if the file of a second view gives another voxel size than the image."""
    view = scene.effects.view
    path = None if view is None or not view.image else Path(view.image)
    if path is None or path.suffix.lower() not in TIFF or not path.is_file():
        return  # where there is no such file, the fit says so
    found = read_voxel_size(path)
    if found is not None and not np.allclose(found, scene.voxel_size, rtol=SIZES_AGREE):
        own, other = (" ".join(f"{d:.4g}" for d in size) for size in (found, scene.voxel_size))
        raise InputError(
            f"second view: {path.name} says that its voxels are {own} um (Z Y X), those of the "
            f"image are {other}: resample it on the image's voxels first"
        )
