"""A table of the cells, and files of everything that was found."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

from qtpy.QtWidgets import QFileDialog, QGroupBox, QHBoxLayout, QPushButton, QVBoxLayout, QWidget

from ...fitting import FitState
from ...fitting.job import FitInput
from ...geometry import Mesh, save_mesh
from ...geometry.formats import MESH_FILES, MESH_FILES_LISTED, MESH_FILTERS
from ...images.stacks import write_image
from ...measure import measure_cells, write_csv
from ...results.colouring import colour_indices
from ...results.report import History, write_results
from ..qt import Signal
from .cell_table import CellTable

IMAGE_FILES = "OME-TIFF (*.ome.tif *.ome.tiff);;ImageJ TIFF (*.tif *.tiff)"


class ResultsPanel(QGroupBox):
    """Shows the cells of a mesh, and saves what was found.

    ``cell_chosen`` gives the centre (um) of the row selected last, ``cells_chosen`` the regions of
    all rows selected, also where they were selected through :meth:`choose`.
    """

    cell_chosen = Signal(tuple)
    cells_chosen = Signal(frozenset)
    saved = Signal(str)
    remarked = Signal(str)  # what a file cannot hold, for example

    def __init__(self, guard: Callable[[Callable[[], None]], None], parent: QWidget | None = None):
        super().__init__("Results", parent)
        self._guard = guard  # runs what may fail, and shows in plain words why it did
        self.last: tuple[FitState, FitInput, History, float] | None = None
        self.table = CellTable(self)
        self.table.chosen.connect(self._chosen)
        layout = QVBoxLayout(self)
        layout.addWidget(self.table)
        buttons = QHBoxLayout()
        self.buttons = {
            "Meshes...": self._ask_meshes,
            "Table...": self._ask_table,
            "Image...": self._ask_image,
            "All...": self._ask_all,
        }
        tips = (
            f"Save the meshes: {MESH_FILES_LISTED}, um.",
            "Save the measurements as .csv, um.",
            "Save the rendered image with its voxel size: .ome.tif, or .tif for ImageJ.",
            "Save everything in a folder: meshes, image, measurements, settings, report, picture.",
        )
        for (title, slot), tip in zip(self.buttons.items(), tips, strict=True):
            button = QPushButton(title, self)
            button.setToolTip(tip)
            button.clicked.connect(slot)
            buttons.addWidget(button)
        layout.addLayout(buttons)
        self.setEnabled(False)
        self.hide()

    def show_result(self, state: FitState, job: FitInput, history: History, seconds: float) -> None:
        """Show the cells of a state, and offer to save it."""
        self.last = (state, job, history, seconds)
        self._show_cells(state.mesh)
        self.setEnabled(True)
        self.show()

    def choose(self, region: int, add: bool = False) -> None:
        """Select the row of a region, as the only one or with (or without) the others; 0: none."""
        before = set(self.table.chosen_regions()) if add else set()
        self.table.choose(before ^ {region} if region else before)

    # ---- files: each raises InputError if it cannot be written --------------------------------

    def save_meshes(self, path: str) -> None:
        """Write the meshes, in the format of the path's extension."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            save_mesh(self._result()[0].mesh, path)
        self.saved.emit(path)
        for warning in caught:
            self.remarked.emit(str(warning.message))

    def save_table(self, path: str) -> None:
        """Write the measurements."""
        write_csv(measure_cells(self._result()[0].mesh), path)
        self.saved.emit(path)

    def save_image(self, path: str) -> None:
        """Write the rendered image."""
        state, job, _, _ = self._result()
        write_image(path, state.rendered(), job.grid.voxel_size)
        self.saved.emit(path)

    def save_all(self, folder: str) -> None:
        """Write what the command line would."""
        state, job, history, seconds = self._result()
        write_results(folder, state, job.image, job.grid, job.settings, history, seconds)
        self.saved.emit(folder)

    # ----------------------------------------------------------------------------------- inside

    def _result(self) -> tuple[FitState, FitInput, History, float]:
        assert self.last is not None, "the panel is disabled until there is a result"
        return self.last

    def _show_cells(self, mesh: Mesh) -> None:
        self.table.show_rows(measure_cells(mesh), colour_indices(mesh))

    def _chosen(self, regions: tuple[int, ...], by_hand: bool) -> None:
        self.cells_chosen.emit(frozenset(regions))
        if by_hand and regions:
            self.cell_chosen.emit(self.table.center(regions[-1]))

    def _ask_meshes(self) -> None:
        path, kind = QFileDialog.getSaveFileName(
            self, "Save meshes", f"mesh{MESH_FILES[0]}", MESH_FILTERS
        )
        if path and not Path(path).suffix:
            path += kind[kind.index("*") + 1 : -1]
        self._save(self.save_meshes, path)

    def _ask_table(self) -> None:
        path, _ = QFileDialog.getSaveFileName(self, "Save table", "measurements.csv", "CSV (*.csv)")
        self._save(self.save_table, path)

    def _ask_image(self) -> None:
        path, _ = QFileDialog.getSaveFileName(
            self, "Save rendered image", "rendered.ome.tif", IMAGE_FILES
        )
        if path and not Path(path).suffix:
            path += ".ome.tif"
        self._save(self.save_image, path)

    def _ask_all(self) -> None:
        folder = QFileDialog.getExistingDirectory(self, "Folder for the results")
        self._save(self.save_all, folder)

    def _save(self, write: Callable[[str], None], path: str) -> None:
        if path:
            self._guard(lambda: write(path))
