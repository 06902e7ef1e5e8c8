"""The image of a bead in a session file, from which its PSF was measured."""

from __future__ import annotations

import atexit
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..geometry.archive import ArchiveReader, ArchiveWriter
from ..images.stacks import read_image, write_image
from ..runs.optics_settings import MeasuredOptics
from ..runs.settings import RunSettings


def keep_bead(archive: ArchiveWriter, name: str, settings: RunSettings) -> RunSettings:
    """Put the image of the bead into a session if the PSF is a measured one.

    Returns
    -------
    The settings, with the voxel size that the bead's file says.

    Raises
    ------
    InputError
        If the file is gone: the session could not be opened later.
    """
    optics = settings.scene.optics
    if not isinstance(optics, MeasuredOptics):
        return settings
    try:
        pixels, size = read_image(optics.file)
    except InputError as error:
        raise InputError(
            "the session needs the image of the bead that its PSF is measured from: put it back "
            f"({error})"
        ) from None
    archive.add_array(name, np.asarray(pixels))
    return _with(settings, optics.model_copy(update={"voxel_size": optics.voxel_size or size}))


def with_bead(archive: ArchiveReader, name: str, settings: RunSettings) -> RunSettings:
    """Return the settings of a session, with the bead's image unpacked to a new file.

    The file that the settings name is not used: a session may come from anybody, and its path may
    be one of another machine. The new file lasts as long as this process.

    Raises
    ------
    InputError
        If the session does not hold the image.
    """
    optics = settings.scene.optics
    if not isinstance(optics, MeasuredOptics):
        return settings
    if f"{name}.npy" not in archive.names:
        raise InputError("it does not hold the image of the bead that its PSF is measured on")
    folder = Path(tempfile.mkdtemp(dir=_folder()))
    path = folder / "bead.tif"
    write_image(path, archive.array(name), optics.voxel_size or (1.0, 1.0, 1.0))
    return _with(settings, optics.model_copy(update={"file": str(path)}))


@cache
def _folder() -> str:
    """Make a temporary folder for this process; it is removed when the process ends."""
    made = tempfile.TemporaryDirectory(prefix="deltamic-", ignore_cleanup_errors=True)
    atexit.register(made.cleanup)
    return made.name


def _with(settings: RunSettings, optics: MeasuredOptics) -> RunSettings:
    scene = settings.scene.model_copy(update={"optics": optics})
    return settings.model_copy(update={"scene": scene})
