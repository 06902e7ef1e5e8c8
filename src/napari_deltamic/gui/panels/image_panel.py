"""Which image is fitted, and how large its voxels are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtWidgets import QFormLayout, QGroupBox, QWidget

from ...errors import InputError
from ...images import EXTENSIONS, TIFF, read_voxel_size, stored_shape
from ..connections import Connections
from ..qt import Signal
from ..viewing.frame import ORIGIN, OWN, Frame, is_stack, stack_of, um_per_unit
from .fields import LayerChooser, TripleField, note_label

_READ_AGAIN = 200e6  # bytes; larger files are not opened a second time for their voxel size


class ImagePanel(QGroupBox):
    """Choice of an image layer; ``changed`` says that it, or its voxel size, is another."""

    changed = Signal()

    def __init__(self, viewer: Any, parent: QWidget | None = None) -> None:
        super().__init__("Image", parent)
        self._viewer = viewer
        self.chooser = LayerChooser(viewer, is_stack, self)
        self.chooser.setToolTip("The 3D image of membranes to fit. Of a 4D one, the time shown.")
        self.voxel_size = TripleField("Voxel size, um. It is the scale of the image layer.", self)
        self.note = note_label()
        layout = QFormLayout(self)
        layout.addRow("layer", self.chooser)
        layout.addRow("voxel, um", self.voxel_size)
        layout.addRow(self.note)
        self._asked: set[str] = set()  # files that were asked for their voxel size
        self._scaled: Any = None
        self._connections = Connections()
        self._connections.connect(viewer.layers.events.inserted, self._place_meshes)
        self.chooser.chosen.connect(self._show)
        self.voxel_size.edited.connect(self._rescale)
        self._show()

    @property
    def layer(self) -> Any:
        """The image layer chosen, or None."""
        return self.chooser.layer()

    def frame(self) -> Frame:
        """Of the layer chosen. InputError if there is none, or it is turned."""
        if self.layer is None:
            raise InputError("open a 3D image first")
        return Frame.of(self.layer)

    def stack(self, layer: Any = None) -> NDArray[Any]:
        """The 3D image chosen (the present time point of a 4D one), float if it has gaps.

        layer : another one, of which the same is wanted.
        """
        chosen = self.layer if layer is None else layer
        if chosen is None:
            raise InputError("open a 3D image first")
        data = stack_of(chosen, tuple(self._viewer.dims.current_step))
        if np.issubdtype(data.dtype, np.floating) and not np.isfinite(data).all():
            return np.where(np.isfinite(data), data, np.nan)
        return data

    def path(self) -> str:
        """The file that the layer was opened from, if an image of this shape is in it; else ''.

        The pixels may have been edited since: see :func:`napari_deltamic.images.holds_image`.
        """
        return "" if self.layer is None else file_of(self.layer)

    def close_links(self) -> None:
        """Listen to the viewer no more."""
        self.chooser.close_links()
        self._connections.undo()
        self._listen_to(None)

    def _show(self) -> None:
        layer = self.layer
        self._listen_to(layer)
        self.voxel_size.setEnabled(layer is not None)
        if layer is None:
            self.note.setText("Open a 3D image (drag it into napari), or File > Open Sample.")
        else:
            self._take_size_of_file(layer)
            self._show_size()
            self._place_meshes()
        self.changed.emit()

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
        shape = self.layer.data.shape[-3:] if not self.layer.multiscale else ()
        text = " x ".join(map(str, shape)) + " voxels"
        if um_per_unit(self.layer) is None and set(frame.voxel_size) == {1.0}:
            text += "; the voxel size is not known: enter it, or all lengths are in voxels"
        self.note.setText(text)

    def _rescale(self) -> None:
        layer = self.layer
        if layer is None:
            return
        um = np.asarray(um_per_unit(layer) or (1.0, 1.0, 1.0))
        scale = np.array(layer.scale, float)
        scale[-3:] = np.asarray(self.voxel_size.value()) / um
        layer.scale = scale
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
            layer.scale = size
            self._viewer.reset_view()

    def _listen_to(self, layer: Any) -> None:
        if self._scaled is not None:
            self._scaled.events.scale.disconnect(self._show_size)
        self._scaled = layer
        if layer is not None:
            layer.events.scale.connect(self._show_size)


def file_of(layer: Any) -> str:
    """The file that a 3D image layer was opened from, if an image of its shape is in it; else ''.

    The pixels may have been edited since: see :func:`napari_deltamic.images.holds_image`.
    """
    path = layer.source.path
    if not path or layer.ndim != 3 or Path(path).suffix.lower() not in EXTENSIONS:
        return ""
    if stored_shape(path) != stack_of(layer, ()).shape:
        return ""  # a crop, a channel, a time point
    return str(Path(path).absolute())
