"""Series of stacks over time, read one at a time: a file with a time axis, or a file a frame."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from ..common.choices import IMAGE_FILES, TIFF, ZARR
from ..common.reading import one_reason, quiet
from ..errors import InputError
from .ome_zarr import open_zarr
from .stacks import VoxelSize, read_image, read_voxel_size, stored_shape
from .stacks import tiff_voxel_size as _size_in

_LETTERS = re.compile(r"(\d+)")


class ImageSeries:
    """The frames of a series, each (Z, Y, X) as it is in its file; only the one asked for is read.

    Attributes
    ----------
    shape : (T, Z, Y, X); of the first frame, where each has a file of its own.
    voxel_size : um, Z Y X, as the files say; None where they do not.
    names : of the frames, for messages.
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
        """One frame. InputError where its file cannot be read."""
        return self._read(frame)


def open_series(path: str | os.PathLike[str]) -> ImageSeries:
    """Open a series without reading its pixels.

    Parameters
    ----------
    path : path
        A .tif, .tiff, .npy or OME-Zarr file (T, Z, Y, X); a folder of 3D files; or a pattern such
        as ``movie/t*.tif``. Files are sorted by the numbers in their names.

    Raises
    ------
    InputError
        Naming the path and the reason: no such file, no image, a single 3D image, 2D frames,
        several channels, or frames of different shapes.
    """
    text = os.fspath(path)
    kind = Path(text).suffix.lower()
    if os.path.isdir(text) and kind != ZARR:
        files = [str(p) for p in Path(text).iterdir() if p.suffix.lower() in IMAGE_FILES]
        return _of_files(text, files)
    if not os.path.exists(text) and glob.has_magic(text):
        return _of_files(text, glob.glob(text, recursive=True))
    if not os.path.exists(text):
        raise InputError(f"{text}: there is no such file")
    if kind not in IMAGE_FILES:
        known = ", ".join(IMAGE_FILES)
        raise InputError(f"{text}: unknown image extension '{kind}'; known are {known}")
    try:
        if kind == ZARR:
            return _of_zarr(text)
        return _of_tiff(text) if kind in TIFF else _of_npy(text)
    except InputError as error:
        raise InputError(f"{text}: {error}") from None
    except Exception as error:  # whatever a parser may raise on damaged data
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{text}: not a readable image ({reason})") from error


def _of_files(text: str, files: list[str]) -> ImageSeries:
    files = sorted((f for f in files if Path(f).suffix.lower() in IMAGE_FILES), key=_by_numbers)
    if not files:
        raise InputError(f"{text}: no {', '.join(IMAGE_FILES)} files are there")
    shapes = [stored_shape(f) for f in files]
    first = next((s for s in shapes if s is not None), None)
    if first is None:
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
        lambda t: read_image(files[t])[0],
        (len(files), *first),
        read_voxel_size(readable),
        [Path(f).name for f in files],
    )


def _by_numbers(path: str) -> list[Any]:
    """t2 before t10."""
    parts = _LETTERS.split(Path(path).name)
    return [int(p) if p.isdigit() else p for p in parts]


def _of_npy(path: str) -> ImageSeries:
    with quiet():
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    _check(array.shape, "")
    return _of_array(lambda t: np.array(array[t]), array.shape, None)


def _of_zarr(path: str) -> ImageSeries:
    found = open_zarr(path)
    shape, axes = tuple(found.array.shape), found.axes
    if axes == "TCZYX" and shape[1] == 1:
        _check((shape[0], *shape[2:]), "TZYX")
        return _of_array(
            lambda t: _native(found.array[t, 0]), (shape[0], *shape[2:]), found.voxel_size
        )
    _check(shape, axes)
    return _of_array(lambda t: _native(found.array[t]), shape, found.voxel_size)


def _of_tiff(path: str) -> ImageSeries:
    with quiet("tifffile"), tifffile.TiffFile(path) as tif:
        if not tif.series:
            raise InputError("the file holds no image")
        series = tif.series[0]
        shape, axes, size = series.shape, series.axes, _size_in(tif)
        _check(shape, axes)
        place, dtype, pages = series.dataoffset, series.dtype, len(series.pages)
        order = tif.byteorder
    if place is not None:
        stored = np.memmap(path, np.dtype(dtype).newbyteorder(order), "r", place, tuple(shape))
        return _of_array(lambda t: _native(stored[t]), shape, size)
    depth = shape[1]
    if pages != shape[0] * depth:
        raise InputError("its planes cannot be read one by one: save it uncompressed")

    def read(t: int) -> NDArray[Any]:
        try:
            with quiet("tifffile"), tifffile.TiffFile(path) as tif:
                found = tif.asarray(key=range(t * depth, (t + 1) * depth), series=0)
            return np.asarray(found).reshape(shape[1:])
        except Exception as error:  # whatever a parser may raise on damaged data
            raise InputError(f"frame {t} cannot be read ({one_reason(error)})") from error

    return _of_array(read, shape, size)


def _of_array(
    read: Callable[[int], NDArray[Any]], shape: Sequence[int], size: VoxelSize | None
) -> ImageSeries:
    whole = tuple(int(n) for n in shape)
    return ImageSeries(read, whole, size, [f"frame {t}" for t in range(whole[0])])


def _native(stored: NDArray[Any]) -> NDArray[Any]:
    """A copy in memory, in the byte order of this machine."""
    return np.array(stored, dtype=stored.dtype.newbyteorder("="))


def _check(shape: Sequence[int], axes: str) -> None:
    """InputError for what is no series of 3D stacks of one channel."""
    described = f"shape {tuple(shape)}" + (f", axes {axes}" if axes else "")
    for name in "CS":
        if name in axes and shape[axes.index(name)] > 1:
            raise InputError(f"it has several channels ({described}): save the membranes alone")
    if len(shape) == 3:
        kind = "2D images over time" if axes.startswith("T") else "a single 3D image"
        raise InputError(f"a series of 3D stacks (T, Z, Y, X) is needed, not {kind} ({described})")
    if len(shape) != 4 or axes[-2:] not in ("", "YX") or axes[:1] == "Z":
        raise InputError(f"a series of 3D stacks (T, Z, Y, X) is needed ({described})")
