"""OME-Zarr (OME-NGFF 0.4 and 0.5): folders of chunks, read lazily.

The format: https://ngff.openmicroscopy.org. Needs the package zarr, and says so if it is missing.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.writing import folder_atomically
from ..errors import InputError
from .channel_names import known_names, zarr_channel_names
from .units import unit_um

_CHUNK = 64  # voxels along each axis: 1 MB of float32, which viewers read in one go


@dataclass(frozen=True, eq=False)
class ZarrImage:
    """The finest resolution of an image; slicing it reads only those pixels.

    array : as stored; slicing it gives a numpy array.
    axes : a letter for each, such as "TCZYX".
    voxel_size : um, Z Y X; None where the file does not give it.
    channels : their names; () where the file does not give them.
    """

    array: Any
    axes: str
    voxel_size: tuple[float, float, float] | None
    channels: tuple[str, ...] = ()


def open_zarr(path: str | os.PathLike[str]) -> ZarrImage:
    """Open an image without reading its pixels.

    Raises
    ------
    InputError
        If zarr is not installed, or the folder is not an OME-Zarr image.
    """
    zarr = _zarr()
    with _quietly():
        try:
            group = zarr.open_group(str(path), mode="r")
        except (FileNotFoundError, NotADirectoryError):
            raise InputError("it holds no OME-Zarr image") from None
        except zarr.errors.ContainsArrayError:
            raise InputError(
                "it is a bare Zarr array, which says neither axes nor voxel size: an OME-Zarr "
                "image is needed, or a .tif"
            ) from None
        told = _told(group)
        if "bioformats2raw.layout" in told and "multiscales" not in told and "0" in group:
            group = group["0"]  # the first of the images that bioformats2raw put into one folder
            told = _told(group)
        facts = _first_image(told)
        dataset = facts["datasets"][0]
        array = group[dataset["path"]]
    axes = "".join(_axis_name(axis) for axis in facts.get("axes", ())).upper()
    if axes and len(axes) != len(array.shape):
        raise InputError(f"it names {len(axes)} axes of {len(array.shape)}")
    count = array.shape[axes.index("C")] if "C" in axes else 1
    names = known_names(zarr_channel_names(told), count)
    return ZarrImage(array, axes, _voxel_size(facts, dataset), names)


def write_zarr(
    path: str | os.PathLike[str],
    image: NDArray[Any],
    voxel_size: Sequence[float],
    origin: Sequence[float] = (0.0, 0.0, 0.0),
) -> None:
    """Write a (Z, Y, X) image, or labels if its values are whole numbers of 16 or 32 bits.

    One resolution, OME-NGFF 0.4. The folder appears whole or not at all; an older one of that name
    is replaced. origin : centre of the first voxel, um, Z Y X.

    Raises
    ------
    InputError
        If zarr is not installed, or the folder cannot be written.
    """
    zarr = _zarr()
    path = Path(path)
    transforms = [{"type": "scale", "scale": [float(d) for d in voxel_size]}]
    if any(origin):
        transforms.append({"type": "translation", "translation": [float(o) for o in origin]})
    image_facts = {
        "version": "0.4",
        "name": path.name.split(".")[0],
        "axes": [{"name": n, "type": "space", "unit": "micrometer"} for n in "zyx"],
        "datasets": [{"path": "0", "coordinateTransformations": transforms}],
    }
    attributes: dict[str, Any] = {"multiscales": [image_facts]}
    if path.name.split(".")[0] == "labels":  # what readers take for a label image
        attributes["image-label"] = {"version": "0.4"}
    with folder_atomically(path) as aside, _quietly():
        group = zarr.open_group(str(aside), mode="w", zarr_format=2, attributes=attributes)
        chunks = tuple(min(n, _CHUNK) for n in image.shape)
        made = group.create_array(
            "0",
            shape=image.shape,
            dtype=image.dtype,
            chunks=chunks,
            chunk_key_encoding={"name": "v2", "separator": "/"},
        )
        made[...] = image


def _zarr() -> Any:
    try:
        import zarr
    except ImportError:
        raise InputError("OME-Zarr needs a package: pip install 'napari-deltamic[many]'") from None
    return zarr


@contextmanager
def _quietly() -> Iterator[None]:
    """Silence warnings within the block, such as zarr's on names and versions."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _told(group: Any) -> Any:
    attributes = dict(group.attrs)
    return attributes.get("ome", attributes)


def _first_image(facts: Any) -> Mapping[str, Any]:
    images = facts.get("multiscales") if isinstance(facts, Mapping) else None
    if not images or not images[0].get("datasets"):
        raise InputError("it holds no OME-Zarr image (no multiscales)")
    found: Mapping[str, Any] = images[0]
    return found


def _axis_name(axis: Any) -> str:
    # Up to version 0.3 axes were just names.
    return str(axis["name"] if isinstance(axis, Mapping) else axis)[:1]


def _voxel_size(
    facts: Mapping[str, Any], dataset: Mapping[str, Any]
) -> tuple[float, float, float] | None:
    """Voxel size (um, Z Y X): scale of the finest resolution times that of all, in axis units."""
    axes = [a for a in facts.get("axes", ()) if isinstance(a, Mapping)]
    scale = np.ones(len(axes))
    told = False
    for holder in (dataset, facts):
        for transform in holder.get("coordinateTransformations", ()):
            if transform.get("type") == "scale":
                scale, told = scale * np.asarray(transform["scale"], np.float64), True
    sides = {
        str(axis["name"]).lower(): side * (unit_um(str(axis.get("unit", ""))) or np.nan)
        for axis, side in zip(axes, scale.tolist(), strict=True)
    }
    if not told or not all(np.isfinite(sides.get(name, np.nan)) for name in "zyx"):
        return None
    return sides["z"], sides["y"], sides["x"]
