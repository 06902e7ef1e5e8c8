"""The image of a bead that tells the PSF: a layer or a file, and the bead's size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from qtpy.QtWidgets import (
    QFileDialog,
    QHBoxLayout,
    QLabel,
    QMenu,
    QPushButton,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from ...common.choices import IMAGE_FILES
from ...errors import InputError
from ...images.stacks import read_voxel_size, stored_shape, write_image
from ...runs.optics_settings import MeasuredOptics
from ..fields import Form
from ..qt import Signal
from ..viewing.frame import Frame, is_stack, stack_of
from ..widgets import Note

_FILES = "images (*.tif *.tiff *.npy)"


class MeasuredFields(QWidget):
    """Fields of :class:`MeasuredOptics`; ``edited`` comes from the user.

    Parameters
    ----------
    viewer : a napari viewer or its model, whose layers are offered.
    """

    edited = Signal()

    def __init__(self, viewer: Any, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._viewer = viewer
        self.file = ""
        self.name = QLabel("no image of a bead yet", self)
        self.name.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.layer_button, self.file_button = (
            QPushButton("Layer", self),
            QPushButton("File...", self),
        )
        self.layer_button.setToolTip("<qt>Take an image layer: one bead, near its middle.</qt>")
        self.file_button.setToolTip("<qt>Open the image of one bead, .tif or .npy.</qt>")
        self._menu = QMenu(self.layer_button)
        self._menu.aboutToShow.connect(self._fill)
        self.layer_button.setMenu(self._menu)
        self.form = Form(MeasuredOptics, ("voxel_size", "bead_diameter", "bead"), self)
        fields = self.form.fields
        self.voxel_size, self.bead = fields["voxel_size"], fields["bead"]
        self.diameter = fields["bead_diameter"]
        self.note = Note(self, wrong=True)
        buttons = QHBoxLayout()
        for button in (self.layer_button, self.file_button):
            buttons.addWidget(button)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addLayout(buttons)
        for row in (self.name, self.form, self.note):
            layout.addWidget(row)
        self.file_button.clicked.connect(self._ask_file)
        self.form.edited.connect(self._changed)
        self._show_rows()

    def settings(self) -> MeasuredOptics:
        """The settings shown. InputError where there is no image."""
        if not self.file:
            raise InputError("choose the image of a bead: a layer or a file")
        values = self.form.values()
        diameter = values["bead_diameter"]
        if diameter > 50:
            raise InputError(f"a bead of {diameter:g} um: did you mean {diameter / 1000:g}?")
        return MeasuredOptics(file=self.file, **values)

    def show_settings(self, settings: MeasuredOptics) -> None:
        """Show settings, without a signal."""
        blocked = self.blockSignals(True)
        self._show_file(settings.file)
        try:
            size = settings.voxel_size or _noted_size(settings.file)
        except InputError:
            size = None  # the file is gone: building the PSF says so
        self.form.show_values(settings.model_copy(update={"voxel_size": size}))
        self.blockSignals(blocked)

    def complain(self, message: str) -> None:
        """Show an error; '' for none."""
        self.note.say(message)

    def take_file(self, path: str) -> None:
        """Take the image of a bead. InputError if its voxel size cannot be read."""
        size = _noted_size(path)
        self._show_file(path)
        if size is not None:
            self.form.show_value("voxel_size", size)
        self.edited.emit()

    def take_layer(self, layer: Any) -> None:
        """Take a layer; one that is in no file is saved first, where the user says."""
        size = Frame.of(layer).voxel_size
        pixels = stack_of(layer, tuple(self._viewer.dims.current_step))
        path = layer.source.path or ""
        known = path and Path(path).suffix.lower() in IMAGE_FILES
        if not known or stored_shape(path) != pixels.shape:
            path = self._ask_where(layer.name)
            if not path:
                return
            write_image(path, pixels, size)
        self._show_file(str(Path(path).absolute()))
        self.form.show_value("voxel_size", size)
        self.edited.emit()

    def forget(self) -> None:
        """Let go of the layers that were offered."""
        self._menu.clear()

    # ----------------------------------------------------------------------------------- inside

    def _show_file(self, path: str) -> None:
        self.file = path
        self.name.setText(Path(path).name)
        self.name.setToolTip(path)
        self._show_rows()

    def _show_rows(self) -> None:
        self.form.setVisible(bool(self.file))

    def _fill(self) -> None:
        self._menu.clear()
        for layer in self._viewer.layers:
            if is_stack(layer):
                action: Any = self._menu.addAction(layer.name)
                action.triggered.connect(lambda _=False, layer=layer: self._try(layer))
        if self._menu.isEmpty():
            action = self._menu.addAction("no image layer is open")
            action.setEnabled(False)

    def _try(self, layer: Any) -> None:
        try:
            self.take_layer(layer)
        except InputError as error:
            self.complain(str(error))

    def _ask_file(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Image of a bead", "", _FILES)
        if path:
            try:
                self.take_file(path)
            except InputError as error:
                self.complain(str(error))

    def _ask_where(self, name: str) -> str:
        title = "The layer is in no file yet: save the image of the bead"
        path, _ = QFileDialog.getSaveFileName(self, title, f"{name}.tif", "TIFF (*.tif)")
        if path and Path(path).suffix.lower() not in (".tif", ".tiff"):
            path += ".tif"
        return str(path)

    def _changed(self, value: Any = None) -> None:
        self.edited.emit()


def _noted_size(path: str) -> tuple[float, float, float] | None:
    """The voxel size that a file notes, um. InputError if it cannot be read."""
    return read_voxel_size(path) if Path(path).suffix.lower() != ".npy" else None
