"""Series of stacks over time, read one at a time: a file with a time axis, or a file per frame."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ..common.choices import IMAGE_FILES, ZARR, is_image
from ..common.reading import one_reason
from ..errors import InputError
from .channels import one_channel
from .stacks import read_image, read_voxel_size, stored_shape
from .stored import ALL, Stored, VoxelSize, naming, open_stored

_LETTERS = re.compile(r"(\d+)")


class ImageSeries:
    """The frames of a series, each (Z, Y, X) as in its file; only the one asked for is read.

    Attributes
    ----------
    shape : (T, Z, Y, X); that of the first frame, where each has a file of its own.
    voxel_size : um, Z Y X, as the files give it; None where they do not.
    names : a name for each frame, for messages.
    """

    def __init__(
        self,
        read: Callable[[int], NDArray[Any]],
        shape: tuple[int, ...],
        voxel_size: VoxelSize | None,
        names: Sequence[str],
    ) -> None:
        self._read, self.voxel_size, self.names = read, voxel_size, list(names)
        self.shape = shape

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, frame: int) -> NDArray[Any]:
        """One frame, (Z, Y, X). InputError if its file cannot be read."""
        return self._read(frame)


def open_series(
    path: str | os.PathLike[str], channel: str | None = None, flag: str = ""
) -> ImageSeries:
    """Open a series without reading its pixels.

    Parameters
    ----------
    path : path
        A .tif, .tiff, .npy or OME-Zarr file (T, Z, Y, X); a folder of 3D files; or a pattern such
        as ``movie/t*.tif``. Files are sorted by the numbers in their names.
    channel : str, optional
        Its number, from 1, or its name, where there are several. Others are not read.
    flag : str
        The flag with which a user chooses a channel, for messages; "" where there is none.

    Raises
    ------
    InputError
        Naming the path and the reason: no such file, not an image, a single 3D image, 2D frames,
        several channels of which none is chosen, or frames of different shapes.
    """
    text = os.fspath(path)
    kind = Path(text).suffix.lower()
    if os.path.isdir(text) and kind != ZARR:
        files = [str(p) for p in Path(text).iterdir()]
        return _of_files(text, files, channel, flag)
    if not os.path.exists(text) and glob.has_magic(text):
        return _of_files(text, glob.glob(text, recursive=True), channel, flag)
    if not os.path.exists(text):
        raise InputError(f"{text}: there is no such file")
    with naming(text):
        return _of_one(one_channel(open_stored(text), channel, flag))


def _of_files(text: str, files: list[str], channel: str | None, flag: str) -> ImageSeries:
    files = sorted((f for f in files if is_image(f)), key=_by_numbers)
    if not files:
        raise InputError(f"{text}: no {', '.join(IMAGE_FILES)} files are there")
    shapes = [stored_shape(f, channel) for f in files]
    first = next((s for s in shapes if s is not None), None)
    if first is None:
        read_voxel_size(files[0], channel, flag)  # says why
        raise InputError(f"{files[0]}: not a readable image")
    if len(first) != 3:
        raise InputError(f"{files[0]}: each file must hold one 3D stack, not shape {first}")
    for file, shape in zip(files, shapes, strict=True):
        if shape is not None and shape != first:
            raise InputError(
                f"{file} has shape {shape}, {files[0]} has {first}: all frames must be of one size"
            )
    readable = next(f for f, s in zip(files, shapes, strict=True) if s is not None)
    return ImageSeries(
        lambda t: read_image(files[t], channel, flag)[0],
        (len(files), *first),
        read_voxel_size(readable, channel, flag),
        [Path(f).name for f in files],
    )


def _by_numbers(path: str) -> list[Any]:
    """Key that sorts by the numbers in a name: t2 before t10."""
    parts = _LETTERS.split(Path(path).name)
    return [int(p) if p.isdigit() else p for p in parts]


def _of_one(stored: Stored) -> ImageSeries:
    """The frames of one file."""
    _check(stored)
    if not stored.in_parts:
        raise InputError("its planes cannot be read one by one: save it uncompressed")

    def read(t: int) -> NDArray[Any]:
        try:
            return _native(stored.read((t, ALL, ALL, ALL)))
        except Exception as error:  # whatever a parser may raise on damaged data
            raise InputError(f"frame {t} cannot be read ({one_reason(error)})") from error

    names = [f"frame {t}" for t in range(stored.shape[0])]
    return ImageSeries(read, stored.shape, stored.voxel_size, names)


def _native(stored: NDArray[Any]) -> NDArray[Any]:
    """The array in the byte order of this machine."""
    return stored.astype(stored.dtype.newbyteorder("="), copy=False)


def _check(stored: Stored) -> None:
    """Raise InputError for what is not a series of 3D stacks."""
    shape, axes, described = stored.shape, stored.axes, stored.described
    if len(shape) == 3:
        kind = "2D images over time" if axes.startswith("T") else "a single 3D image"
        raise InputError(f"a series of 3D stacks (T, Z, Y, X) is needed, not {kind} ({described})")
    if len(shape) != 4 or axes[-2:] not in ("", "YX") or axes[:1] == "Z":
        raise InputError(f"a series of 3D stacks (T, Z, Y, X) is needed ({described})")
