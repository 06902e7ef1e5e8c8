"""Reading and writing stacks with their voxel size."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import ArrayLike, NDArray

from ..common.choices import IMAGE_FILES, ZARR
from ..common.writing import write_atomically
from ..errors import InputError
from .channels import one_channel
from .missing import finite_or_nan, unmasked
from .ome_zarr import write_zarr
from .stored import Stored, VoxelSize, naming, open_stored

SIZES_AGREE = 0.01  # relative: headers round voxel sizes, so less is not a different size
_REFUSED = {
    "S": "several colours in each channel: save one as a grey image",
    "T": "several time points: save one, or call its planes slices (Z)",
}


def read_image(
    path: str | os.PathLike[str], channel: str | None = None, flag: str = ""
) -> tuple[NDArray[Any], VoxelSize | None]:
    """Read a stack.

    Parameters
    ----------
    path : path
        A .tif or .tiff file (OME, ImageJ or plain; the first series), .npy, or a .zarr folder
        (OME-Zarr; its finest resolution).
    channel : str, optional
        Its number, from 1, or its name, where the file holds several. Others are not read.
    flag : str
        The flag with which a user chooses a channel, for messages; "" where there is none.

    Returns
    -------
    image : (Z, Y, X) array of real numbers, as they are in the file (bool becomes uint8).
    voxel_size : um, Z Y X, from OME or ImageJ metadata; None unless all three sides are given in a
        unit of length and plausible.

    Raises
    ------
    InputError
        Naming the file and the reason: missing, unknown extension, empty, damaged, not 3D, several
        channels of which none is chosen, several time points, complex or other values that are not
        intensities.
    """
    with naming(path):
        stored = _stack(path, channel, flag)
        return _checked(stored.whole(), stored.axes), stored.voxel_size


def read_voxel_size(
    path: str | os.PathLike[str], channel: str | None = None, flag: str = ""
) -> VoxelSize | None:
    """The voxel size that :func:`read_image` would give, without reading the pixels.

    Raises
    ------
    InputError
        As :func:`read_image`, but damage among the pixels is not seen.
    """
    with naming(path):
        return _stack(path, channel, flag).voxel_size


def _stack(path: str | os.PathLike[str], channel: str | None, flag: str) -> Stored:
    """A file, opened and reduced to one channel. InputError if it does not hold one stack."""
    stored = open_stored(path)
    _refuse_along(stored.shape, stored.axes, "T")
    stored = one_channel(stored, channel, flag)
    _checked(_without_pixels(stored), stored.axes)
    return stored


def write_image(
    path: str | os.PathLike[str],
    image: ArrayLike,
    voxel_size: Sequence[float],
    origin: Sequence[float] = (0.0, 0.0, 0.0),
) -> None:
    """Write a stack with its voxel size; the file appears whole or not at all.

    A .tif is written as an ImageJ hyperstack where that can hold the values (uint8, uint16,
    float32), else as OME-TIFF; a name ending in .ome.tif always gives OME-TIFF. A .npy file holds
    no voxel size. A .zarr is an OME-Zarr folder.

    Parameters
    ----------
    path : path
    image : (Z, Y, X) array of real numbers.
    voxel_size : um, Z Y X.
    origin : centre of the first voxel, um, Z Y X; only OME-TIFF and OME-Zarr keep it.

    Raises
    ------
    InputError
        If the extension is unknown, the image is not 3D or not of real numbers, the voxel size is
        not positive, or the file cannot be written.
    """
    path = Path(path)
    array = _checked(np.asarray(unmasked(image)))
    z, y, x = (float(d) for d in voxel_size)
    if not all(isfinite(d) and d > 0 for d in (z, y, x)):
        raise InputError(f"voxel size must be three positive numbers (um), not {(z, y, x)}")
    buffer = io.BytesIO()
    kind = path.suffix.lower()
    if kind not in IMAGE_FILES:
        raise InputError(f"{path}: unknown image extension '{path.suffix}'; use .tif")
    if kind == ZARR:
        write_zarr(path, array, (z, y, x), origin)
        return
    if kind == ".npy":
        np.save(buffer, array)
    elif array.dtype in (np.uint8, np.uint16, np.float32) and not _named_ome(path):
        tifffile.imwrite(
            buffer,
            array,
            imagej=True,
            photometric="minisblack",
            resolution=(1 / x, 1 / y),
            metadata={"axes": "ZYX", "spacing": z, "unit": "um"},
        )
    else:
        sides = {f"PhysicalSize{name}": d for name, d in zip("ZYX", (z, y, x), strict=True)}
        units = {f"PhysicalSize{name}Unit": "µm" for name in "ZYX"}
        metadata: dict[str, Any] = {"axes": "ZYX", **sides, **units}
        if any(origin):
            metadata["Plane"] = _places(len(array), z, origin)
        held = _held_by_ome(array)
        tifffile.imwrite(buffer, held, ome=True, photometric="minisblack", metadata=metadata)
    write_atomically(path, buffer.getvalue())


def stored_shape(
    path: str | os.PathLike[str], channel: str | None = None
) -> tuple[int, ...] | None:
    """Shape (Z, Y, X) of the stack that :func:`read_image` would give, without reading the pixels.

    (T, Z, Y, X) for a series; None if the file cannot be read.
    """
    try:
        shape = one_channel(open_stored(path), channel).shape
    except Exception:  # whatever a parser may raise on damaged data
        return None
    while len(shape) > 3 and 1 in shape[: len(shape) - 3]:
        shape = tuple(np.delete(shape, shape.index(1)))
    return tuple(int(n) for n in shape)


def holds_image(path: str | os.PathLike[str], image: ArrayLike, channel: str | None = None) -> bool:
    """Whether a file holds exactly these values; missing ones count as equal. Reads all of it."""
    array = np.asarray(image)
    if stored_shape(path, channel) != array.shape:
        return False
    try:
        stored = read_image(path, channel)[0]
    except InputError:
        return False
    # Plane by plane: no third copy of a large stack.
    return all(
        np.array_equal(
            finite_or_nan(a), finite_or_nan(b), equal_nan=a.dtype.kind == b.dtype.kind == "f"
        )
        for a, b in zip(stored, array, strict=True)
    )


def _places(count: int, step: float, origin: Sequence[float]) -> dict[str, list[Any]]:
    """OME-TIFF metadata on the positions (um) of slices."""
    z, y, x = origin
    along = {"Z": [z + k * step for k in range(count)], "Y": [y] * count, "X": [x] * count}
    units = {f"Position{name}Unit": ["µm"] * count for name in "ZYX"}
    return {**{f"Position{name}": places for name, places in along.items()}, **units}


def _held_by_ome(array: NDArray[Any]) -> NDArray[Any]:
    """The array in a type that OME-TIFF has: integers of at most 32 bits, no float16."""
    if array.dtype == np.float16:
        return array.astype(np.float32)
    if array.dtype.kind not in "iu" or array.dtype.itemsize <= 4:
        return array
    kind: Any = np.int32 if array.min() < 0 else np.uint32
    limits = np.iinfo(kind)
    fits = limits.min <= array.min() and array.max() <= limits.max
    return array.astype(kind if fits else np.float64)


def _named_ome(path: Path) -> bool:
    return path.name.lower().endswith((".ome.tif", ".ome.tiff"))


def _without_pixels(stored: Stored) -> NDArray[Any]:
    """An array of the stored shape that takes no memory and needs no conversion in `_checked`."""
    dtype = stored.dtype
    native = np.dtype(np.uint8) if dtype == np.bool_ else dtype.newbyteorder("=")
    return np.broadcast_to(np.zeros((), native), stored.shape)


def _refuse_along(shape: Sequence[int], axes: str, names: str) -> None:
    """Raise InputError if one of the named axes is longer than 1."""
    for name in names:
        if any(a == name and n > 1 for a, n in zip(axes, shape, strict=False)):
            described = f"shape {tuple(shape)}, axes {axes}"
            raise InputError(f"the image has {_REFUSED[name]} ({described})")


def _checked(array: NDArray[Any], axes: str = "") -> NDArray[Any]:
    """The array as (Z, Y, X) in native byte order; InputError if it is not a 3D image."""
    shape = tuple(int(n) for n in array.shape)
    if array.size == 0:
        raise InputError(f"the image is empty: its shape is {shape}")
    if np.iscomplexobj(array):
        raise InputError("the image is complex; take its magnitude first")
    if array.dtype != np.bool_ and not np.issubdtype(array.dtype, np.number):
        raise InputError(f"an image of real numbers is needed, not of {array.dtype}")
    described = f"shape {shape}" + (f", axes {axes}" if axes else "")
    _refuse_along(shape, axes, "TS")
    # Leading axes of length 1 are not dimensions of the stack.
    while array.ndim > 3 and 1 in array.shape[: array.ndim - 3]:
        array = np.squeeze(array, axis=array.shape.index(1))
    if array.ndim != 3:
        reason = "a 2D image" if array.ndim == 2 else f"an image of {array.ndim} dimensions"
        raise InputError(f"a 3D stack (Z, Y, X) is needed, not {reason} ({described})")
    if array.dtype == np.bool_:
        return array.astype(np.uint8)
    return array.astype(array.dtype.newbyteorder("="), copy=False)
