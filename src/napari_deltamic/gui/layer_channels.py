"""The file and channel that an image layer shows, and the channels that may be chosen."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

from napari.layers import Image

from ..common.choices import IMAGE_FILES, TIFF
from ..errors import InputError
from ..images.channels import channel_axis, listed_channels
from ..images.stacks import stored_shape
from ..images.stored import Stored, VoxelSize, naming, open_stored
from .viewing.frame import OWN, data_of, in_units, is_stack, made_by_fit

_FILE = "file"  # under OWN: path and channel of a layer that was made of another
_MOST = 5  # an axis of more than so many steps is no axis of stains, unless it is named so
_CHANNEL, _OTHER = ("c", "ch", "channel", "channels"), ("t", "time", "z", "y", "x")

# Axis of the layer, number from 0, how many there are, name or "".
Choice = tuple[int, int, int, str]


def channel_axes(layer: Any) -> tuple[int, ...]:
    """Axes of an image layer that may hold channels: by its file, else by names and lengths."""
    if not isinstance(layer, Image) or layer.rgb or layer.ndim < 4 or made_by_fit(layer):
        return ()
    stored = channels_of_file(layer)
    axis = None if stored is None else channel_axis(stored)
    if axis is not None:
        return (axis,)
    names = [str(name).lower() for name in layer.axis_labels]
    named = tuple(axis for axis, name in enumerate(names) if name in _CHANNEL)
    if named:
        return named
    shape = data_of(layer).shape
    return tuple(
        axis
        for axis in range(layer.ndim - 2)
        if 1 < shape[axis] <= _MOST
        and names[axis] not in _OTHER
        and in_units(layer.units[axis], "second") is None
    )


def channels(layer: Any) -> list[Choice]:
    """All channels that may be chosen of a layer."""
    axes = () if layer is None else channel_axes(layer)
    stored = channels_of_file(layer) if axes else None
    names = () if stored is None else stored.channels
    counts = [(axis, int(data_of(layer).shape[axis])) for axis in axes]
    return [(axis, k, n, names[k] if names else "") for axis, n in counts for k in range(n)]


def channel_layer(layer: Any, choice: Choice) -> Image:
    """One channel of an image layer, as a layer at the same place; it shares the voxels."""
    axis, channel, _, name = choice
    index: list[Any] = [slice(None)] * layer.ndim
    index[axis] = channel
    kept = {
        name: tuple(value for k, value in enumerate(getattr(layer, name)) if k != axis)
        for name in ("scale", "translate", "units", "axis_labels")
    }
    stored = channels_of_file(layer)
    known = stored is not None and channel_axis(stored) == axis
    # The number is what the command line takes, too.
    own = {_FILE: (str(layer.source.path), str(channel + 1))} if known else {}
    words = f"channel {channel + 1}" + (f", {name}" if name else "")
    return Image(
        data_of(layer)[tuple(index)], name=f"{layer.name}, {words}", metadata={OWN: own}, **kept
    )


def is_one_channel(layer: Any) -> bool:
    """Whether a layer can be fitted: a stack or series of which its file tells no channels."""
    return is_stack(layer) and channels_of_file(layer) is None


def why_unusable(layer: Any) -> str:
    """Why an image layer cannot be fitted, and what to do; '' for no image layer of the user's."""
    if not isinstance(layer, Image) or made_by_fit(layer):
        return ""
    name = f"'{layer.name}'"
    if layer.rgb:
        return (
            f"{name} is a colour image: right-click it in the layer list, choose 'Split RGB', and "
            "keep the colour of the membranes"
        )
    if layer.ndim < 3:
        return f"{name} is a single plane: open a stack of planes (Z, Y, X) of it"
    stored = channels_of_file(layer)
    if stored is not None:
        return f"{name} has {listed_channels(stored)}: choose the one that shows the membranes"
    if layer.ndim < 5:
        return ""
    if channel_axes(layer):
        return f"{name} has {layer.ndim} axes: choose the channel that shows the membranes"
    return (
        f"{name} has {layer.ndim} axes: keep Z, Y, X, and time before them if there is any "
        "(right-click it in the layer list, 'Split Stack')"
    )


# ---- the file of a layer -------------------------------------------------------------------------


def origin_of(layer: Any) -> tuple[str, str | None]:
    """The path that a layer was opened from, and its channel there; ('', None) for no file.

    What is in the file may be of another shape: see :func:`file_of`.
    """
    own = layer.metadata.get(OWN, {}).get(_FILE)
    if own is not None:
        path, channel = own
        return str(path), str(channel)
    return str(layer.source.path or ""), None


def of_one_stack(layer: Any, other: Any) -> bool:
    """Whether two layers are different channels of the same file."""
    (one, channel), (same, another) = file_of(layer), file_of(other)
    return bool(one) and one == same and None not in (channel, another)


def file_of(layer: Any) -> tuple[str, str | None]:
    """The file with this 3D image, and its channel there; ('', None) where it is in no file.

    The pixels may have been edited since: see :func:`.stacks.holds_image`.
    """
    path, channel = origin_of(layer)
    if not path or layer.ndim != 3 or Path(path).suffix.lower() not in IMAGE_FILES:
        return "", None
    stored = None if channel is not None else _opened(Path(path))
    if stored is not None and stored.channels.count(layer.name) == 1:
        # Readers that make a layer of each channel name it so.
        channel = str(stored.channels.index(layer.name) + 1)
    if stored_shape(path, channel) != tuple(data_of(layer).shape):
        return "", None  # a crop, a time point
    return str(Path(path).absolute()), channel


def channels_of_file(layer: Any) -> Stored | None:
    """What is stored in a layer's file if by that the layer has several channels; else None."""
    path = getattr(layer.source, "path", None)
    if not path or layer.ndim < 4 or not isinstance(layer, Image) or layer.rgb:
        return None
    stored = _opened(Path(path))
    if stored is None or stored.shape != tuple(data_of(layer).shape):
        return None
    return None if channel_axis(stored) is None else stored


def noted_size(layer: Any) -> VoxelSize | None:
    """The voxel size (um, Z Y X) in the TIFF file of a layer; None if it gives none."""
    path = Path(origin_of(layer)[0])
    stored = _opened(path) if path.suffix.lower() in TIFF else None
    if stored is None:
        return None
    # Planes over time have no size along Z.
    planes = stored.axes.replace("C", "").replace("S", "")[-3:]
    return None if "T" in planes else stored.voxel_size


def _opened(file: Path) -> Stored | None:
    """What is stored in a file, without its voxels; None if it is not a readable image."""
    if file.suffix.lower() not in IMAGE_FILES:
        return None
    try:
        state = file.stat()
        return _stored(str(file), state.st_mtime_ns, state.st_size)
    except (OSError, InputError):
        return None  # napari could read it, so it is an image all the same


@lru_cache(maxsize=16)  # layers are looked at whenever one of them changes
def _stored(path: str, changed: int, size: int) -> Stored:
    with naming(path):
        return open_stored(path)
