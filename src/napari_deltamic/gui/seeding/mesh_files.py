"""The button that adds mesh files as Surface layers."""

from __future__ import annotations

from functools import partial

from qtpy.QtWidgets import QFileDialog, QPushButton, QWidget

from ...errors import InputError
from ...geometry.formats import MESH_FILES_LISTED, MESH_FILTER
from ..document import Document
from ..qt import Signal
from ..viewing.mesh_layer import LoadedMesh, load_meshes, surface_layer
from ..widgets import sentence
from ..work import Background


class MeshFiles(QPushButton):
    """Asks for mesh files, reads them in the background, adds them in the frame of the image.

    ``told`` says that ``message`` is another.
    """

    told = Signal()

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__("From file...", parent)
        self._doc, self._viewer, self._image = doc, doc.viewer, doc.image
        self.message = ""
        self.setToolTip(
            f"<qt>Adds surfaces from {MESH_FILES_LISTED} files as layers; their "
            "coordinates are um from the centre of the first voxel.</qt>"
        )
        self._background = Background(self._add, self._fail)
        self.clicked.connect(self._ask)

    def read(self, *paths: str) -> None:
        """Read files; the layers come when they have all been read."""
        if self._image.layer is None:
            self._tell(sentence(self._image.missing()))
            return
        self._background.ask(partial(load_meshes, list(paths)))
        self._tell("Reading ...")

    def close_links(self) -> None:
        """End what is under way."""
        self._background.close()

    def _ask(self) -> None:
        paths, _ = QFileDialog.getOpenFileNames(self, "Surfaces to start from", "", MESH_FILTER)
        if paths:
            self.read(*paths)

    def _add(self, meshes: list[LoadedMesh]) -> None:
        self._tell("")
        try:
            frame = self._image.frame()
        except InputError as error:
            self._fail(str(error))
            return
        for loaded in meshes:
            self._viewer.add_layer(surface_layer(loaded, frame).lie_on(self._image.layer))
            for remark in loaded.remarks:
                self._doc.warned.emit(remark)

    def _fail(self, message: str) -> None:
        self._tell("")
        self._doc.warned.emit(message)

    def _tell(self, message: str) -> None:
        self.message = message
        self.told.emit()
