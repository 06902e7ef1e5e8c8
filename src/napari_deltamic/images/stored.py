"""Image files as opened, before voxels are read: shape, axes, voxel size, channels."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from math import prod
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import tifffile
from numpy.typing import NDArray

from ..common.choices import IMAGE_FILES, TIFF, ZARR
from ..common.reading import quiet
from ..errors import InputError
from .channel_names import tiff_channel_names
from .ome_zarr import open_zarr
from .units import unit_um

VoxelSize = tuple[float, float, float]
Index = tuple[int | slice, ...]

# No microscope has a voxel side outside of this range (um): the metadata is wrong.
_PLAUSIBLE = (1e-4, 1e4)
ALL = slice(None)


@dataclass(frozen=True, eq=False)
class Stored:
    """An image file that was opened.

    shape, dtype : as stored.
    axes : a letter for each, such as "TCZYX"; "" where the file does not name them.
    voxel_size : um, Z Y X, from the metadata; None unless all three sides are given in a unit of
        length and plausible.
    channels : their names; () where the file does not give them.
    read : gives the voxels at an index of all axes, as a copy in memory.
    in_parts : whether ``read`` reads only what is asked for.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    axes: str
    voxel_size: VoxelSize | None
    channels: tuple[str, ...]
    read: Callable[[Index], NDArray[Any]]
    in_parts: bool = True

    @property
    def described(self) -> str:
        """Shape and axes in words."""
        return f"shape {self.shape}" + (f", axes {self.axes}" if self.axes else "")

    def whole(self) -> NDArray[Any]:
        """All voxels."""
        return self.read((ALL,) * len(self.shape))


def open_stored(path: str | os.PathLike[str]) -> Stored:
    """Open a .tif or .tiff file (OME, ImageJ or plain; the first series), .npy, or OME-Zarr.

    Raises
    ------
    InputError
        If the extension is unknown, or the file is empty, holds no image or is cut short. Parsers
        raise other errors, too: see ``naming``.
    """
    path = Path(path)
    if path.suffix.lower() not in IMAGE_FILES:
        known = ", ".join(IMAGE_FILES)
        raise InputError(f"unknown image extension '{path.suffix}'; known are {known}")
    if path.suffix.lower() == ZARR and path.exists():
        return _open_zarr(path)
    if path.stat().st_size == 0:
        raise InputError("the file is empty")
    return _open_tiff(path) if path.suffix.lower() in TIFF else _open_npy(path)


@contextmanager
def naming(path: str | os.PathLike[str]) -> Iterator[None]:
    """Within the block, any error but MemoryError becomes an InputError that names the file."""
    try:
        yield
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except MemoryError:
        raise
    except Exception as error:  # whatever a parser may raise on damaged data
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: not a readable image ({reason})") from error


# ---- kinds of files ------------------------------------------------------------------------------


def _open_npy(path: Path) -> Stored:
    with quiet():
        try:
            # Memory-mapped: that checks the size before memory is allocated.
            array = np.load(path, mmap_mode="r", allow_pickle=False)
        except ValueError as error:
            if "Python objects" not in str(error):
                raise
            # Reading them would run whatever code the file holds.
            text = "it holds Python objects, not an image; in Cellpose, save the masks as TIFF"
            raise InputError(text) from None
    return Stored(
        tuple(array.shape), array.dtype, "", None, (), lambda index: np.array(array[index])
    )


def _open_zarr(path: Path) -> Stored:
    found = open_zarr(path)
    array, order = found.array, _in_order(found.axes, len(found.array.shape))

    def read(index: Index) -> NDArray[np.generic]:
        stored: list[int | slice] = [ALL] * len(order)
        for axis, at in zip(order, index, strict=True):
            stored[axis] = at
        left = [axis for axis, at in zip(order, index, strict=True) if isinstance(at, slice)]
        return np.asarray(array[tuple(stored)]).transpose(np.argsort(np.argsort(left)))

    return Stored(
        tuple(int(array.shape[axis]) for axis in order),
        np.dtype(array.dtype),
        "".join(found.axes[axis] for axis in order) if found.axes else "",
        plausible(found.voxel_size),
        found.channels,
        read,
    )


def _in_order(axes: str, count: int) -> list[int]:
    """Axis numbers that put the spatial axes in the order Z, Y, X, which OME-Zarr leaves open."""
    order = list(range(count))
    space = [axis for axis, name in enumerate(axes) if name in "ZYX"]
    sought = sorted(space, key=lambda axis: "ZYX".index(axes[axis]))
    for place, axis in zip(space, sought, strict=True):
        order[place] = axis
    return order


def _open_tiff(path: Path) -> Stored:
    with quiet("tifffile"), tifffile.TiffFile(path) as tif:
        if not tif.series:
            raise InputError("the file holds no image")
        series = tif.series[0]
        _check_planes(tif)
        shape, dtype = tuple(int(n) for n in series.shape), np.dtype(series.dtype)
        place, pages = series.dataoffset, _pages(series)
        size, names = tiff_voxel_size(tif), tiff_channel_names(tif)
        stored = dtype.newbyteorder(tif.byteorder)
        read = partial(_tiff_part, path, shape, stored, place, pages)
        in_parts = place is not None or pages is not None
        return Stored(shape, dtype, series.axes, size, names, read, in_parts)


def _pages(series: Any) -> NDArray[np.intp] | None:
    """Page numbers as an array over the axes in front of those within a page.

    None if pages do not follow each other in the order of the axes.
    """
    inside = len(series.keyframe.shape)
    before = tuple(series.shape[: len(series.shape) - inside])
    ordered = series.shape[len(before) :] == series.keyframe.shape
    if not ordered or len(series.pages) != prod(before):
        return None
    return np.arange(prod(before)).reshape(before)


def _tiff_part(
    path: Path,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    place: int | None,
    pages: NDArray[np.intp] | None,
    index: Index,
) -> NDArray[Any]:
    """The voxels at an index; where possible, only the pages asked for are read."""
    whole = all(at == ALL for at in index) or (place is None and pages is None)
    read = [n for n, at in zip(shape, index, strict=True) if whole or at == ALL]
    _check_size(path, read, dtype)
    if place is not None and not whole:
        return np.array(np.memmap(path, dtype, "r", place, shape)[index])
    with quiet("tifffile"), tifffile.TiffFile(path) as tif:
        series = tif.series[0]
        if whole or pages is None:
            return np.asarray(series.asarray())[index]
        asked = np.asarray(pages[index[: pages.ndim]])
        found = tif.asarray(key=asked.ravel().tolist(), series=0)
        inside = shape[pages.ndim :]
        return np.asarray(found).reshape(*asked.shape, *inside)[
            (..., *index[pages.ndim :]) if inside else ...
        ]


# An image may take _GROWTH times the bytes of its file, and _SMALL bytes in any case: strong
# compression of an empty image reaches this; more would only fill the memory.
_GROWTH, _SMALL = 2000, 1 << 30


def _check_size(path: Path, shape: Sequence[int], dtype: Any) -> None:
    """Raise InputError, before memory is allocated, if a header claims more than the file holds."""
    claimed = prod(int(n) for n in shape) * np.dtype(dtype).itemsize
    if claimed > max(_SMALL, _GROWTH * path.stat().st_size):
        raise InputError(f"it claims to hold {claimed:.3g} bytes, more than it can")


def _check_planes(tif: tifffile.TiffFile) -> None:
    """Raise InputError if there are fewer planes than the description promises: a partial copy."""
    plane = max(prod(tif.pages.first.shape), 1)
    found, promised = prod(tif.series[0].shape) // plane, None
    if tif.is_imagej:
        promised = (tif.imagej_metadata or {}).get("images")
    elif tif.is_shaped and tif.shaped_metadata:
        promised = prod(tif.shaped_metadata[0].get("shape", ())) // plane
    if isinstance(promised, int) and found < promised:
        raise InputError(
            f"it is cut short: it should hold {promised} planes, but holds {found}; copy or "
            "save it again"
        )


# ---- voxel sizes ---------------------------------------------------------------------------------


def tiff_voxel_size(tif: tifffile.TiffFile) -> VoxelSize | None:
    """Voxel size (um, Z Y X); None where the metadata does not give it, or cannot be right."""
    try:
        size = _ome_size(tif) if tif.is_ome else _imagej_size(tif) if tif.is_imagej else None
    except (ValueError, KeyError, TypeError, ZeroDivisionError, ElementTree.ParseError):
        return None
    return plausible(size)


def plausible(size: VoxelSize | None) -> VoxelSize | None:
    """The voxel size if a microscope can have it, else None."""
    low, high = _PLAUSIBLE
    # This comparison is also false for NaN.
    return size if size and all(low <= d <= high for d in size) else None


def _ome_size(tif: tifffile.TiffFile) -> VoxelSize | None:
    root = ElementTree.fromstring(tif.ome_metadata or "")
    pixels = next((e for e in root.iter() if e.tag.endswith("}Pixels")), None)
    if pixels is None:
        return None
    sides = []
    for name in "ZYX":
        unit = unit_um(pixels.get(f"PhysicalSize{name}Unit", "um"))
        value = pixels.get(f"PhysicalSize{name}")
        if value is None or unit is None:
            return None
        sides.append(float(value) * unit)
    return sides[0], sides[1], sides[2]


def _imagej_size(tif: tifffile.TiffFile) -> VoxelSize | None:
    metadata = tif.imagej_metadata or {}
    # Units of Y and Z are given only where they differ from that of X.
    z, y, x = (
        unit_um(str(metadata.get(f"{axis}unit", metadata.get("unit", "")))) for axis in "zyx"
    )
    if z is None or y is None or x is None or "spacing" not in metadata:
        return None
    tags = tif.pages.first.tags
    sides = [float(metadata["spacing"])]
    for name in ("YResolution", "XResolution"):
        count, length = tags[name].value  # pixels per unit, as a fraction
        sides.append(length / count)
    return sides[0] * z, sides[1] * y, sides[2] * x
