"""Which image is fitted, and how large its voxels are."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtWidgets import QFormLayout, QGroupBox, QHBoxLayout, QLabel, QPushButton, QWidget

from ...common.choices import TIFF
from ...errors import InputError
from ...images.stacks import read_voxel_size
from ..connections import Connections
from ..fields import TripleField
from ..qt import Signal
from ..viewing.frame import (
    ORIGIN,
    OWN,
    Frame,
    finite,
    is_stack,
    um_per_unit,
    unread_stack_of,
)
from ..viewing.kept_view import rescale
from ..viewing.layer_files import file_of
from ..widgets import LayerChooser, note_label, sentence, show_row
from .channels import ChannelChooser, channel_axes, channel_layer, why_unusable

_READ_AGAIN = 200e6  # bytes; larger files are not opened a second time for their voxel size


class ImagePanel(QGroupBox):
    """Choice of an image layer; ``changed`` says that it, or its voxel size, is another."""

    changed = Signal()

    def __init__(self, viewer: Any, parent: QWidget | None = None) -> None:
        super().__init__("1  Image", parent)
        self._viewer = viewer
        self.chooser = LayerChooser(viewer, is_stack, self)
        self.chooser.setToolTip("The 3D image of membranes to fit. Of a 4D one, the time shown.")
        self.voxel_size = TripleField("Voxel size, um. It is the scale of the image layer.", self)
        self.channels = ChannelChooser(self)
        self.size_line = QLabel(self)
        self.edit_size = QPushButton("Edit", self)
        self.edit_size.setToolTip("<qt>Type another voxel size.</qt>")
        self.edit_size.setCheckable(True)
        self.note = note_label()
        size = QHBoxLayout()
        size.addWidget(self.size_line, 1)
        size.addWidget(self.edit_size)
        self._form = layout = QFormLayout(self)
        layout.addRow("layer", self.chooser)
        layout.addRow("channel", self.channels)
        layout.addRow("voxel", size)
        layout.addRow(self.voxel_size)
        layout.addRow(self.note)
        self._of_channels: Any = None  # the layer whose channels are offered
        self._asked: set[str] = set()  # files that were asked for their voxel size
        self._scaled: Any = None
        self._connections = Connections()
        self._connections.connect(viewer.layers.events.inserted, self._place_meshes)
        self._connections.connect(viewer.layers.events.inserted, self._look, position="last")
        self._connections.connect(viewer.layers.events.removed, self._look, position="last")
        self.chooser.chosen.connect(self._show)
        self.channels.chosen.connect(self._take_channel)
        self.voxel_size.edited.connect(self._rescale)
        self.edit_size.toggled.connect(self.voxel_size.setVisible)
        self.voxel_size.hide()
        self._show()

    @property
    def layer(self) -> Any:
        """The image layer chosen, or None."""
        return self.chooser.layer()

    def frame(self) -> Frame:
        """Of the layer chosen. InputError if there is none, or it is turned."""
        if self.layer is None:
            raise InputError(self.missing())
        return Frame.of(self.layer)

    def missing(self) -> str:
        """Why there is no image to fit, in a sentence that says what to do."""
        reasons = [why_unusable(layer) for layer in self._viewer.layers]
        return next((reason for reason in reversed(reasons) if reason), "open a 3D image first")

    @property
    def time(self) -> tuple[int, ...]:
        """The step shown along the axes before Z, Y, X of the layer; () where it has none."""
        layer = self.layer
        if layer is None or layer.ndim < 4:
            return ()
        return tuple(int(step) for step in self._viewer.dims.current_step[-layer.ndim : -3])

    def stack(self, layer: Any = None) -> NDArray[Any]:
        """The 3D image chosen (the present time point of a 4D one), float if it has gaps.

        layer : another one, of which the same is wanted.
        """
        chosen = self.layer if layer is None else layer
        if chosen is None:
            raise InputError(self.missing())
        return finite(self._unread(chosen))

    def reader(self) -> Callable[[], NDArray[Any]]:
        """Reads the same when it is called, in any thread. InputError if there is no image."""
        if self.layer is None:
            raise InputError(self.missing())
        return partial(finite, self._unread(self.layer))

    def _unread(self, layer: Any) -> Any:
        return unread_stack_of(layer, tuple(self._viewer.dims.current_step))

    def path(self) -> str:
        """The file that the layer was opened from, if an image of this shape is in it; else ''.

        The pixels may have been edited since: see :func:`.stacks.holds_image`.
        """
        return "" if self.layer is None else file_of(self.layer)

    def close_links(self) -> None:
        """Listen to the viewer no more."""
        self.chooser.close_links()
        self._connections.undo()
        self._of_channels = None
        self._listen_to(None)

    def _show(self) -> None:
        layer = self.layer
        self._listen_to(layer)
        for field in (self.voxel_size, self.edit_size):
            field.setEnabled(layer is not None)
        if layer is None:
            self.size_line.setText("-")
        self._look()
        if layer is not None:
            self._take_size_of_file(layer)
            self._show_size()
            self._place_meshes()
        self.changed.emit()

    def _look(self, event: Any = None) -> None:
        """Offer channels; where no layer can be fitted, those of one that cannot, and say why."""
        layer = self.layer
        if layer is None:
            others = [other for other in self._viewer.layers if why_unusable(other)]
            layer = others[-1] if others else None
            text = "Open a 3D image (drag it into napari), or File > Open Sample."
            self.note.setText(sentence(self.missing()) if others else text)
        self._of_channels = layer
        show_row(self._form, self.channels, self.channels.offer(layer))

    def _take_channel(self, axis: int, channel: int) -> None:
        """One channel as a layer of its own, in the place of all."""
        whole = self._of_channels
        if whole is None or whole not in self._viewer.layers:
            return
        layer = channel_layer(whole, axis, channel)
        whole.visible = False
        self._viewer.add_layer(layer)
        self.chooser.choose(layer)

    def _place_meshes(self, event: Any = None) -> None:
        """Put layers of mesh files, which count from the first voxel, into the image's frame."""
        try:
            frame = self.frame()
        except InputError:
            return  # there is no image yet, or one that cannot be used
        for layer in self._viewer.layers:
            own = layer.metadata.get(OWN, {})
            if ORIGIN not in own or own[ORIGIN] is not None or layer.ndim != 3:
                continue
            own[ORIGIN] = frame.translate
            moved = np.any(layer.translate != 0) or np.any(layer.scale != 1)
            if not moved:  # by the user, who knows better
                for name, value in frame.layer_options().items():
                    setattr(layer, name, value)

    def _show_size(self, event: Any = None) -> None:
        try:
            frame = self.frame()
        except InputError as error:
            self.note.setText(str(error))
            return
        self.voxel_size.set_value(frame.voxel_size)
        self.size_line.setText(" x ".join(f"{d:.3g}" for d in frame.voxel_size) + " µm")
        unknown = um_per_unit(self.layer) is None and set(frame.voxel_size) == {1.0}
        if unknown:
            self.edit_size.setChecked(True)
        whole = (self.layer.data[0] if self.layer.multiscale else self.layer.data).shape
        text = " x ".join(map(str, whole[-3:])) + " voxels"
        if channel_axes(self.layer):
            times, planes = whole[:2]
            text += f", taken for {times} times of {planes} planes; if it has channels, choose one"
        if unknown:
            text += "; the voxel size is not known: enter it, or all lengths are in voxels"
        self.note.setText(text)

    def _rescale(self) -> None:
        layer = self.layer
        if layer is None:
            return
        um = np.asarray(um_per_unit(layer) or (1.0, 1.0, 1.0))
        scale = np.array(layer.scale, float)
        scale[-3:] = np.asarray(self.voxel_size.value()) / um
        rescale(self._viewer, layer, scale)
        self.changed.emit()

    def _take_size_of_file(self, layer: Any) -> None:
        """The voxel size that a TIFF file notes, where the layer has none."""
        path = layer.source.path
        unscaled = np.allclose(layer.scale, 1) and um_per_unit(layer) is None
        if not path or not unscaled or path in self._asked:
            return
        self._asked.add(path)
        file = Path(path)
        if file.suffix.lower() not in TIFF or not file.is_file():
            return
        if file.stat().st_size > _READ_AGAIN:
            return
        try:
            size = read_voxel_size(file)
        except InputError:
            return  # napari could read it, so it is an image all the same; its size stays unknown
        if size is not None and layer.ndim == 3:
            rescale(self._viewer, layer, size)

    def _listen_to(self, layer: Any) -> None:
        if self._scaled is not None:
            self._scaled.events.scale.disconnect(self._show_size)
        self._scaled = layer
        if layer is not None:
            layer.events.scale.connect(self._show_size)
