"""Images of several channels: which axis they may lie along, and one of them as a layer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pint
from napari.layers import Image
from qtpy.QtWidgets import QComboBox, QSizePolicy, QWidget

from ..qt import Signal
from ..viewing.frame import made_by_fit

_MOST = 5  # an axis of more than so many steps is no axis of stains, unless it is named so
_CHANNEL, _OTHER = ("c", "ch", "channel", "channels"), ("t", "time", "z", "y", "x")


def channel_axes(layer: Any) -> tuple[int, ...]:
    """Axes of an image layer that channels may lie along; those that are named so, if any are."""
    if not isinstance(layer, Image) or layer.rgb or layer.ndim < 4 or made_by_fit(layer):
        return ()
    names = [str(name).lower() for name in layer.axis_labels]
    named = tuple(axis for axis, name in enumerate(names) if name in _CHANNEL)
    if named:
        return named
    shape = _data(layer).shape
    return tuple(
        axis
        for axis in range(layer.ndim - 2)
        if 1 < shape[axis] <= _MOST and names[axis] not in _OTHER and not _is_time(layer, axis)
    )


def channel_layer(layer: Any, axis: int, channel: int) -> Image:
    """One channel of an image layer, as a layer at the same place; it shares the voxels."""
    index: list[Any] = [slice(None)] * layer.ndim
    index[axis] = channel

    def rest(values: Any) -> tuple[Any, ...]:
        return tuple(value for k, value in enumerate(values) if k != axis)

    data = _data(layer)[tuple(index)]
    return Image(
        data,
        name=f"{layer.name}, channel {channel + 1}",
        scale=rest(layer.scale),
        translate=rest(layer.translate),
        units=rest(layer.units),
        axis_labels=rest(layer.axis_labels),
    )


class ChannelChooser(QComboBox):
    """Hidden for an image that can have one channel only; ``chosen`` gives axis and channel."""

    chosen = Signal(int, int)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._choices: list[tuple[int, int] | None] = []
        self.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.setMinimumContentsLength(12)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setToolTip(
            "<qt>The channel that shows the membranes. It becomes a layer of its own, which is "
            "fitted.</qt>"
        )
        self.activated.connect(self._told)

    def offer(self, layer: Any) -> bool:
        """Offer the channels of a layer; whether it may have any."""
        self.clear()
        axes = () if layer is None else channel_axes(layer)
        first = "none: it is a series in time" if layer is not None and layer.ndim == 4 else "..."
        self._choices = [None]
        self.addItem(first)
        for axis in axes:
            n = int(_data(layer).shape[axis])
            self._choices += [(axis, k) for k in range(n)]
            self.addItems([f"{k + 1} of {n}, along axis {axis + 1}" for k in range(n)])
        return bool(axes)

    def _told(self, index: int) -> None:
        choice = self._choices[index] if 0 <= index < len(self._choices) else None
        if choice is not None:
            self.chosen.emit(*choice)


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
    if layer.ndim < 5:
        return ""
    if channel_axes(layer):
        return f"{name} has {layer.ndim} axes: choose the channel that shows the membranes"
    return (
        f"{name} has {layer.ndim} axes: keep Z, Y, X, and time before them if there is any "
        "(right-click it in the layer list, 'Split Stack')"
    )


def _data(layer: Any) -> Any:
    return layer.data[0] if layer.multiscale else layer.data


def _is_time(layer: Any, axis: int) -> bool:
    try:
        return bool(np.isfinite(float((1 * layer.units[axis]).to("second").magnitude)))
    except (pint.DimensionalityError, pint.UndefinedUnitError):
        return False
