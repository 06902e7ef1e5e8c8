"""One channel of an image that holds several, chosen by its number or its name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .stored import Index, Stored

_MOST_SHOWN = 8  # channels that a message names; a spectral image has dozens
_STACK = 3  # axes of a stack
_NAMED = set("TCZYXS")  # axes whose meaning is known


def channel_axis(stored: Stored) -> int | None:
    """Number of the axis of channels, or colours; None unless there are several of them."""
    for letter in "CS":
        axis = stored.axes.find(letter)
        if axis >= 0 and stored.shape[axis] > 1:
            return axis
    return None


def one_channel(stored: Stored, channel: str | None, flag: str = "") -> Stored:
    """The image reduced to one of its channels.

    Parameters
    ----------
    stored : an image that was opened.
    channel : its number, from 1, or its name; None where there is only one.
    flag : the flag with which a user chooses a channel, for messages; "" where there is none.

    Raises
    ------
    InputError
        If there are several channels and none is chosen, no such channel, or no axis known to hold
        channels.
    """
    axis = channel_axis(stored)
    if axis is None:
        _check_only(stored, channel, flag)
        axis = stored.axes.find("C")
        return stored if axis < 0 or len(stored.shape) <= _STACK else _at(stored, axis, 0)
    if len(stored.shape) <= _STACK:
        raise InputError(
            f"a 3D stack (Z, Y, X) is needed, not a 2D image of {stored.shape[axis]} channels "
            f"({stored.described}); if these are its planes, save them as slices (Z)"
        )
    return _at(stored, axis, _chosen(stored, axis, channel, flag))


def _at(stored: Stored, axis: int, number: int) -> Stored:
    """The image at one place along an axis, without that axis."""

    def read(index: Index) -> NDArray[np.generic]:
        return stored.read((*index[:axis], number, *index[axis:]))

    shape, axes = list(stored.shape), list(stored.axes)
    del shape[axis], axes[axis]
    return replace(stored, shape=tuple(shape), axes="".join(axes), channels=(), read=read)


def _check_only(stored: Stored, channel: str | None, flag: str) -> None:
    """Raise InputError if a channel is asked for that is not the only one."""
    if channel is None:
        return
    unnamed = not stored.axes or set(stored.axes) - _NAMED
    if unnamed and sum(n > 1 for n in stored.shape) > _STACK:
        raise InputError(
            f"it does not say which of its axes are channels ({stored.described}): save it as an "
            "ImageJ hyperstack, OME-TIFF or OME-Zarr"
        )
    if _found(channel, stored.channels, 1) != [0]:
        advice = f": leave out {flag}" if flag else ""
        raise InputError(f"there is no channel '{channel}', the image has one only{advice}")


def listed_channels(stored: Stored) -> str:
    """How many channels there are, and their names, in words."""
    axis = channel_axis(stored)
    count, names = 1 if axis is None else stored.shape[axis], stored.channels
    if not names:
        return f"{count} channels (1 to {count})"
    shown = [f"{k} {name}".strip() for k, name in enumerate(names[:_MOST_SHOWN], start=1)]
    more = ["..."] if count > _MOST_SHOWN else []
    return f"{count} channels ({', '.join([*shown, *more])})"


def _chosen(stored: Stored, axis: int, channel: str | None, flag: str) -> int:
    listed = f"the image has {listed_channels(stored)}"
    if channel is None:
        what = f"choose one with {flag}" if flag else "save one of them alone"
        raise InputError(f"{listed}: {what} ({stored.described})")
    found = _found(channel, stored.channels, stored.shape[axis])
    if len(found) > 1:
        raise InputError(f"{len(found)} channels are called '{channel}': give the number of one")
    if not found:
        raise InputError(f"there is no channel '{channel}': {listed}")
    return found[0]


def _found(channel: str, names: Sequence[str], count: int) -> list[int]:
    """Indices of matching channels: by number first, then exact name, then ignoring case."""
    if channel.isdecimal() and 1 <= int(channel) <= count:
        return [int(channel) - 1]
    just = [k for k, name in enumerate(names) if name == channel]
    return just or [k for k, name in enumerate(names) if name.lower() == channel.lower()]
