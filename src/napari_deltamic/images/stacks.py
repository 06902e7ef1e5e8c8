"""Image files: stacks in, stacks out, with their voxel size."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import isfinite, prod
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import tifffile
from numpy.typing import ArrayLike, NDArray

from ..common.choices import IMAGE_FILES, TIFF, ZARR
from ..common.reading import quiet
from ..common.writing import write_atomically
from ..errors import InputError
from .missing import finite_or_nan, unmasked
from .ome_zarr import ZarrImage, open_zarr, write_zarr
from .units import unit_um

VoxelSize = tuple[float, float, float]
# What is in a file: the array, the names of its axes, the voxel size.
_Stored = tuple[NDArray[Any], str, VoxelSize | None]
_Reader = Callable[[Path], _Stored]

# A voxel side outside of this range (um) is no microscope's: the metadata is wrong.
_PLAUSIBLE = (1e-4, 1e4)
SIZES_AGREE = 0.01  # relative: headers round voxel sizes, so that less is no other size
_REFUSED = {
    "C": "several channels: save the membrane channel alone",
    "S": "several channels (colours): save one as a grey image",
    "T": "several time points: save one, or call its planes slices (Z)",
}


def read_image(path: str | os.PathLike[str]) -> tuple[NDArray[Any], VoxelSize | None]:
    """Read a stack.

    Parameters
    ----------
    path : path
        A .tif or .tiff file (OME, ImageJ or plain; the first series), .npy, or a .zarr folder
        (OME-Zarr; its finest resolution).

    Returns
    -------
    image : (Z, Y, X) array of real numbers, as they are in the file (bool becomes uint8).
    voxel_size : um, Z Y X, from the metadata of OME and ImageJ; None where all three sides in a
        unit of length are not given, or are not plausible.

    Raises
    ------
    InputError
        Naming the file and the reason: missing, unknown extension, empty, damaged, not 3D, several
        channels or time points, complex or other values that are no intensities.
    """
    array, axes, voxel_size = _read(path, _read_tiff, _read_npy, _read_zarr)
    with _naming(path):
        return _checked(array, axes), voxel_size


def read_voxel_size(path: str | os.PathLike[str]) -> VoxelSize | None:
    """The voxel size that :func:`read_image` would give, without reading the pixels.

    Raises
    ------
    InputError
        As :func:`read_image`, but damage among the pixels is not seen.
    """
    array, axes, voxel_size = _read(path, _tiff_header, _npy_header, _zarr_header)
    with _naming(path):
        _checked(array, axes)
    return voxel_size


def _read(path: str | os.PathLike[str], tiff: _Reader, npy: _Reader, zarr: _Reader) -> _Stored:
    path = Path(path)
    if path.suffix.lower() not in IMAGE_FILES:
        known = ", ".join(IMAGE_FILES)
        raise InputError(f"{path}: unknown image extension '{path.suffix}'; known are {known}")
    with _naming(path):
        if path.suffix.lower() == ZARR and path.exists():
            return zarr(path)
        if path.stat().st_size == 0:
            raise InputError("the file is empty")
        return (tiff if path.suffix.lower() in TIFF else npy)(path)


@contextmanager
def _naming(path: str | os.PathLike[str]) -> Iterator[None]:
    """Whatever goes wrong becomes an InputError that names the file."""
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


def write_image(
    path: str | os.PathLike[str], image: ArrayLike, voxel_size: Sequence[float]
) -> None:
    """Write a stack with its voxel size; the file appears whole or not at all.

    A .tif is an ImageJ hyperstack where that can hold the values (uint8, uint16, float32), else an
    OME-TIFF, as is a name that ends in .ome.tif. A .npy file holds no voxel size. A .zarr is an
    OME-Zarr folder.

    Parameters
    ----------
    path : path
    image : (Z, Y, X) array of real numbers.
    voxel_size : um, Z Y X.

    Raises
    ------
    InputError
        Unknown extension, not a 3D image of real numbers, a voxel size that is not positive, or
        the file cannot be written.
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
        write_zarr(path, array, (z, y, x))
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
        metadata = {"axes": "ZYX", **sides, **units}
        tifffile.imwrite(buffer, array, ome=True, photometric="minisblack", metadata=metadata)
    write_atomically(path, buffer.getvalue())


def stored_shape(path: str | os.PathLike[str]) -> tuple[int, ...] | None:
    """(Z, Y, X) of the stack that :func:`read_image` would give, without reading it all.

    None where there is no file that it could read.
    """
    path = Path(path)
    try:
        if path.suffix.lower() == ZARR:
            shape = open_zarr(path).array.shape
        elif path.suffix.lower() in TIFF:
            with quiet("tifffile"), tifffile.TiffFile(path) as tif:
                shape = tif.series[0].shape
        else:
            with quiet():
                shape = np.load(path, mmap_mode="r", allow_pickle=False).shape
    except Exception:  # whatever a parser may raise on damaged data
        return None
    while len(shape) > 3 and 1 in shape[: len(shape) - 3]:
        shape = tuple(np.delete(shape, shape.index(1)))
    return tuple(int(n) for n in shape)


def holds_image(path: str | os.PathLike[str], image: ArrayLike) -> bool:
    """Whether a file holds just these values; missing ones are equal. Reads the whole file."""
    array = np.asarray(image)
    if stored_shape(path) != array.shape:
        return False
    try:
        stored = read_image(path)[0]
    except InputError:
        return False
    # Plane by plane: no third copy of a large stack.
    return all(
        np.array_equal(
            finite_or_nan(a), finite_or_nan(b), equal_nan=a.dtype.kind == b.dtype.kind == "f"
        )
        for a, b in zip(stored, array, strict=True)
    )


def _named_ome(path: Path) -> bool:
    return path.name.lower().endswith((".ome.tif", ".ome.tiff"))


def _read_npy(path: Path) -> _Stored:
    # Mapped first: that checks the size before memory is asked for.
    with quiet():
        return np.array(np.load(path, mmap_mode="r", allow_pickle=False)), "", None


def _read_tiff(path: Path) -> _Stored:
    with quiet("tifffile"), tifffile.TiffFile(path) as tif:
        if not tif.series:
            raise InputError("the file holds no image")
        series = tif.series[0]
        _check_size(path, series.shape, series.dtype)
        _check_planes(tif)
        return series.asarray(), series.axes, tiff_voxel_size(tif)


def _read_zarr(path: Path) -> _Stored:
    found = open_zarr(path)
    _checked(*_zarr_outline(found))  # before anything is read
    return np.asarray(found.array[...]), found.axes, _plausible(found.voxel_size)


def _zarr_header(path: Path) -> _Stored:
    found = open_zarr(path)
    return (*_zarr_outline(found), _plausible(found.voxel_size))


def _zarr_outline(found: ZarrImage) -> tuple[NDArray[Any], str]:
    return _without_pixels(found.array.shape, np.dtype(found.array.dtype)), found.axes


def _npy_header(path: Path) -> _Stored:
    with quiet():
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    return _without_pixels(array.shape, array.dtype), "", None


def _tiff_header(path: Path) -> _Stored:
    with quiet("tifffile"), tifffile.TiffFile(path) as tif:
        if not tif.series:
            raise InputError("the file holds no image")
        series = tif.series[0]
        _check_planes(tif)
        empty = _without_pixels(series.shape, np.dtype(series.dtype))
        return empty, series.axes, tiff_voxel_size(tif)


def _without_pixels(shape: Sequence[int], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Zeros of a shape that take no memory, and need no conversion in `_checked`."""
    native = np.dtype(np.uint8) if dtype == np.bool_ else dtype.newbyteorder("=")
    return np.broadcast_to(np.zeros((), native), tuple(shape))


# What a file of so many bytes may hold, so many times as much: strong compressions of an empty
# image reach this; more would only fill the memory.
_GROWTH, _SMALL = 2000, 1 << 30


def _check_size(path: Path, shape: Sequence[int], dtype: Any) -> None:
    """InputError where a header claims more than the file can hold, before memory is asked for."""
    claimed = prod(int(n) for n in shape) * np.dtype(dtype).itemsize
    if claimed > max(_SMALL, _GROWTH * path.stat().st_size):
        raise InputError(f"it says that it holds {claimed:.3g} bytes, which it cannot")


def _check_planes(tif: tifffile.TiffFile) -> None:
    """InputError where the description promises more planes than are there: a copy cut short."""
    plane = max(prod(tif.pages.first.shape), 1)
    found, promised = prod(tif.series[0].shape) // plane, None
    if tif.is_imagej:
        promised = (tif.imagej_metadata or {}).get("images")
    elif tif.is_shaped and tif.shaped_metadata:
        promised = prod(tif.shaped_metadata[0].get("shape", ())) // plane
    if isinstance(promised, int) and found < promised:
        raise InputError(
            f"it is cut short: it says that it holds {promised} planes, and holds {found}; copy or "
            "save it again"
        )


def _checked(array: NDArray[Any], axes: str = "") -> NDArray[Any]:
    """The array as (Z, Y, X), in the byte order of this machine."""
    shape = tuple(int(n) for n in array.shape)
    if array.size == 0:
        raise InputError(f"the image is empty: its shape is {shape}")
    if np.iscomplexobj(array):
        raise InputError("the image is complex; take its magnitude first")
    if array.dtype != np.bool_ and not np.issubdtype(array.dtype, np.number):
        raise InputError(f"an image of real numbers is needed, not of {array.dtype}")
    described = f"shape {shape}" + (f", axes {axes}" if axes else "")
    for name, reason in _REFUSED.items():
        if any(a == name and n > 1 for a, n in zip(axes, shape, strict=False)):
            raise InputError(f"the image has {reason} ({described})")
    # Axes of length 1 in front are no dimensions of the stack.
    while array.ndim > 3 and 1 in array.shape[: array.ndim - 3]:
        array = np.squeeze(array, axis=array.shape.index(1))
    if array.ndim != 3:
        reason = "a 2D image" if array.ndim == 2 else f"an image of {array.ndim} dimensions"
        raise InputError(f"a 3D stack (Z, Y, X) is needed, not {reason} ({described})")
    if array.dtype == np.bool_:
        return array.astype(np.uint8)
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def tiff_voxel_size(tif: tifffile.TiffFile) -> VoxelSize | None:
    """um, Z Y X; None where the metadata does not say, or cannot be right."""
    try:
        size = _ome_size(tif) if tif.is_ome else _imagej_size(tif) if tif.is_imagej else None
    except (ValueError, KeyError, TypeError, ZeroDivisionError, ElementTree.ParseError):
        return None
    return _plausible(size)


def _plausible(size: VoxelSize | None) -> VoxelSize | None:
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
    unit = unit_um(str(metadata.get("unit", "")))
    if unit is None or "spacing" not in metadata:
        return None
    tags = tif.pages.first.tags
    sides = [float(metadata["spacing"])]
    for name in ("YResolution", "XResolution"):
        count, length = tags[name].value  # pixels per unit, as a fraction
        sides.append(length / count)
    return sides[0] * unit, sides[1] * unit, sides[2] * unit
