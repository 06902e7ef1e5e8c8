"""Where the fit starts: points, labels, surfaces or a mesh file."""

from __future__ import annotations

from typing import Any

import numpy as np
from napari.layers import Points
from qtpy.QtCore import Qt
from qtpy.QtWidgets import (
    QComboBox,
    QFileDialog,
    QFormLayout,
    QGroupBox,
    QHBoxLayout,
    QPushButton,
    QWidget,
)
from superqt import QLabeledDoubleSlider

from ..errors import InputError
from .connections import Connections
from .fields import LayerChooser, note_label, show_row
from .frame import Frame
from .qt import Signal
from .seeds import SEED_LAYERS, FileSeeds, Seeds, seeds_from_layer

_FOLLOW, _SPHERES = "membrane around each point", "sphere around each point"
_HELP = {
    "Points": "A point inside each cell. 'membrane' finds the dark region around it, up to its "
    "bright membrane; 'sphere' starts as large as drawn.",
    "Labels": "Each label becomes a surface.",
    "Surface": "The surface as it is.",
}


class SeedsPanel(QGroupBox):
    """Choice of the seeds; ``changed`` says that they may be others."""

    changed = Signal()

    def __init__(self, viewer: Any, image_panel: Any, parent: QWidget | None = None) -> None:
        super().__init__("Seeds", parent)
        self._viewer, self._image = viewer, image_panel
        self._file = ""
        self._connections = Connections()
        self.chooser = LayerChooser(viewer, _is_seeds, self)
        self.chooser.setToolTip("The layer of seeds: Points, Labels or Surface.")
        self.place = QPushButton("Place seeds", self)
        self.place.setToolTip("Then click inside each cell, on any slice.")
        self.open_file = QPushButton("Mesh file...", self)
        self.open_file.setToolTip("Start from a .ply, .obj, .off, .stl or .rec file.")
        self.shape = QComboBox(self)
        self.shape.addItems([_FOLLOW, _SPHERES])
        self.shape.setToolTip(_HELP["Points"])
        self.radius = QLabeledDoubleSlider(Qt.Orientation.Horizontal, self)
        self.radius.setToolTip("Radius of the spheres, um; of the selected points, or of all.")
        self.note = note_label()
        self._lay_out()
        self.place.clicked.connect(self.place_seeds)
        self.open_file.clicked.connect(self._ask_for_file)
        self.chooser.chosen.connect(self._layer_chosen)
        self.shape.currentTextChanged.connect(self._shape_chosen)
        self.radius.valueChanged.connect(self._resize)
        image_panel.changed.connect(self._image_changed)
        self._image_changed()
        self._layer_chosen()

    @property
    def spheres(self) -> bool:
        """Whether points are to be spheres."""
        return bool(self.shape.currentText() == _SPHERES)

    def seeds(self, frame: Frame) -> Seeds:
        """The seeds chosen, copied. InputError where there are none, or they cannot be used."""
        if self._file:
            return FileSeeds(self._file)
        layer = self.chooser.layer()
        if layer is None:
            raise InputError("no seeds yet: press 'Place seeds' and click inside each cell")
        step = tuple(self._viewer.dims.current_step)
        return seeds_from_layer(layer, frame, step, spheres=self.spheres)

    def place_seeds(self) -> None:
        """A Points layer that takes clicks: the one chosen, or a new one."""
        layer = self.chooser.layer()
        if self._image.layer is None:
            self.note.setText("Open a 3D image first.")
            return
        if not isinstance(layer, Points):
            layer = self._new_points(self._image.frame())
            self._viewer.add_layer(layer)
            self.chooser.choose(layer)
        self._use_file("")
        self._viewer.dims.ndisplay = 2
        self._viewer.layers.selection = {layer}
        layer.mode = "add"

    def finish_placing(self) -> None:
        """Clicks move the view again, they place no more seeds."""
        layer = self.chooser.layer()
        if isinstance(layer, Points) and str(layer.mode) == "add":
            layer.mode = "pan_zoom"

    def use_file(self, path: str) -> None:
        """Take the seeds from a mesh file."""
        self._use_file(path)

    def close_links(self) -> None:
        """Listen to the viewer no more."""
        self.chooser.close_links()
        self._connections.undo()

    # ----------------------------------------------------------------------------------- inside

    def _lay_out(self) -> None:
        buttons = QHBoxLayout()
        buttons.addWidget(self.place)
        buttons.addWidget(self.open_file)
        layout = QFormLayout(self)
        layout.addRow(buttons)
        layout.addRow("layer", self.chooser)
        layout.addRow("start as", self.shape)
        layout.addRow("radius, um", self.radius)
        layout.addRow(self.note)
        self._form = layout

    def _new_points(self, frame: Frame) -> Points:
        return Points(
            np.zeros((0, 3)),
            ndim=3,
            name="seeds",
            size=2 * self._drawn_radius(),
            face_color="#ffb000",
            border_color="white",
            opacity=0.8,
            projection_mode="rescale_spherical",  # a sphere is cut as a sphere by each slice
            **frame.layer_options(),
        )

    def _drawn_radius(self) -> float:
        """um; a point that is no sphere is drawn small, but over several slices."""
        return float(self.radius.value()) * (1.0 if self.spheres else 0.25)

    def _image_changed(self) -> None:
        if self._image.layer is None:
            return
        try:
            frame = self._image.frame()
        except InputError:
            return  # the image panel says so
        sides = np.asarray(frame.voxel_size) * self._image.layer.data.shape[-3:]
        largest = float(sides.max()) / 2
        self.radius.setRange(2 * min(frame.voxel_size), largest)
        self.radius.setValue(float(sides.min()) / 6)

    def _layer_chosen(self) -> None:
        self._connections.undo()
        layer = self.chooser.layer()
        if layer is not None:
            self._connections.connect(layer.events.data, self._data_changed)
            self._file = ""
        self._show()
        self.changed.emit()

    def _data_changed(self, event: Any = None) -> None:
        self._show()

    def _show(self) -> None:
        layer = self.chooser.layer()
        points = isinstance(layer, Points) or layer is None
        show_row(self._form, self.shape, points and not self._file)
        show_row(self._form, self.radius, points and self.spheres and not self._file)
        if self._file:
            self.note.setText(f"Starts from {self._file}")
        elif isinstance(layer, Points):
            n = len(layer.data)
            self.note.setText(f"{n} {'point' if n == 1 else 'points'}{self._outside(layer)}")
        elif layer is None:
            self.note.setText("Press 'Place seeds' and click inside each cell.")
        else:
            self.note.setText(_HELP[type(layer).__name__])

    def _outside(self, layer: Points) -> str:
        if not len(layer.data) or self._image.layer is None or layer.ndim < 3:
            return ""
        try:
            frame = self._image.frame()
            scale, shift = frame.data_to_um(layer)
        except InputError:
            return ""  # said when the fit starts
        voxels = (np.asarray(layer.data)[:, -3:] * scale + shift) / frame.voxel_size
        inside = (voxels > -0.5) & (voxels < np.array(self._image.layer.data.shape[-3:]) - 0.5)
        n = int((~inside.all(axis=1)).sum())
        return f"; {n} outside the image: move or delete {'it' if n == 1 else 'them'}" if n else ""

    def _shape_chosen(self, text: str) -> None:
        self._resize()
        self._show()
        self.changed.emit()

    def _resize(self, value: float = 0) -> None:
        layer = self.chooser.layer()
        if not isinstance(layer, Points) or self._image.layer is None:
            return
        scale, _ = self._image.frame().data_to_um(layer)
        size = 2 * self._drawn_radius() / float(np.mean(scale))
        layer.current_size = size
        chosen = sorted(layer.selected_data) or range(len(layer.data))
        sizes = np.array(layer.size, float)
        sizes[list(chosen)] = size
        layer.size = sizes

    def _ask_for_file(self) -> None:
        path, _ = QFileDialog.getOpenFileName(
            self, "Surfaces to start from", "", "Meshes (*.ply *.obj *.off *.stl *.rec)"
        )
        if path:
            self._use_file(path)

    def _use_file(self, path: str) -> None:
        self._file = path
        self._show()
        self.changed.emit()


def _is_seeds(layer: Any) -> bool:
    return type(layer).__name__ in SEED_LAYERS and layer.ndim >= 3
