"""A table of the cells, and files of everything that was found."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from qtpy.QtCore import QSignalBlocker
from qtpy.QtWidgets import (
    QComboBox,
    QFileDialog,
    QGroupBox,
    QHBoxLayout,
    QMenu,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from ...common.writing import write_atomically
from ...fitting import FitState
from ...fitting.job import FitInput
from ...geometry import Mesh, save_mesh
from ...geometry.formats import MESH_FILES, MESH_FILES_LISTED, MESH_FILTERS
from ...images.stacks import write_image
from ...measure import measure_cells
from ...measure.table import csv_text
from ...results.colouring import colour_indices
from ...results.report import History, write_results
from ..qt import Signal
from ..widgets import Note
from .cell_columns import COLUMNS, value_of
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
    coloured = Signal()  # by another column
    measured = Signal()  # more is known of the cells
    labels_wanted = Signal()

    def __init__(self, guard: Callable[[Callable[[], None]], None], parent: QWidget | None = None):
        super().__init__("5  Results", parent)
        self._guard = guard  # runs what may fail, and shows in plain words why it did
        self.last: tuple[FitState, FitInput, History, float] | None = None
        self.table = CellTable(self)
        self.table.chosen.connect(self._chosen)
        layout = QVBoxLayout(self)
        layout.addWidget(self.table)
        self.colour = QComboBox(self)
        self.colour.setToolTip("<qt>Colour the cells in the viewer by a column of the table.</qt>")
        self.colour.setAccessibleName("colour cells by")
        self.colour.setMinimumContentsLength(8)
        self.colour.setSizeAdjustPolicy(
            QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon
        )
        self.columns = QPushButton("Columns", self)
        self.columns.setToolTip("<qt>Choose what the table shows.</qt>")
        self._shown = QMenu(self.columns)
        self._shown.aboutToShow.connect(self._offer_columns)
        self.columns.setMenu(self._shown)
        self.export = QPushButton("Export", self)
        self.export.setToolTip("<qt>Save what was found, or add the cells as labels.</qt>")
        self.export.setMenu(self._export_menu())
        row = QHBoxLayout()
        for widget in (self.colour, self.columns, self.export):
            row.addWidget(widget)
        layout.addLayout(row)
        self.scale = Note(self)
        layout.addWidget(self.scale)
        self._offer_colours()
        self.colour.currentIndexChanged.connect(self._colour_chosen)
        self.setEnabled(False)
        self.hide()

    def show_result(self, state: FitState, job: FitInput, history: History, seconds: float) -> None:
        """Show the cells of a state, and offer to save it."""
        self.last = (state, job, history, seconds)
        self._show_cells(state.mesh)
        self.setEnabled(True)
        self.show()

    def show_more(self, cells: Mapping[int, Mapping[str, Any]]) -> None:
        """Show what else is known of the cells, by region."""
        self.table.show_more(cells)
        self._offer_colours()
        self.measured.emit()

    def show_scale(self, numbers: Mapping[int, float] | None) -> None:
        """Between which numbers the colours lie; None: each cell has its own."""
        column = next((c for c in COLUMNS if c.key == self.coloured_by), None)
        if not numbers or column is None:
            self.scale.say("")
            return
        low, high = (column.text(limit) for limit in (min(numbers.values()), max(numbers.values())))
        self.scale.say(f"{column.name}: from {low} (dark blue) to {high} (yellow)")

    @property
    def coloured_by(self) -> str:
        """The column that gives the cells their colours; '' for none."""
        return str(self.colour.currentData() or "")

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
        names = [column.key for column in self.table.known_columns()]
        rows = [{name: value_of(row, name) for name in names} for row in self.table.rows]
        write_atomically(path, csv_text(names, rows).encode())
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
        self._offer_colours()

    def _offer_colours(self) -> None:
        """The columns of numbers; the one in use stays, where it can."""
        before = self.coloured_by
        blocker = QSignalBlocker(self.colour)
        self.colour.clear()
        self.colour.addItem("a colour for each cell", "")
        for column in self.table.known_columns()[1:]:
            if self.table.numbers(column.key):
                self.colour.addItem(f"by {column.name}", column.key)
        self.colour.setCurrentIndex(max(self.colour.findData(before), 0))
        blocker.unblock()
        self.coloured.emit()

    def _offer_columns(self) -> None:
        self.table.fill_menu(self._shown)

    def _colour_chosen(self, index: int) -> None:
        self.coloured.emit()

    def _export_menu(self) -> QMenu:
        menu = QMenu(self)
        menu.setToolTipsVisible(True)
        for title, slot, tip in (
            ("Meshes...", self._ask_meshes, f"Save the meshes: {MESH_FILES_LISTED}, um."),
            ("Table...", self._ask_table, "Save all columns as .csv, um."),
            (
                "Image...",
                self._ask_image,
                "Save the rendered image with its voxel size: .ome.tif, or .tif for ImageJ.",
            ),
            (
                "All...",
                self._ask_all,
                "Save everything in a folder: meshes, image, measurements, settings, report.",
            ),
            (
                "Labels layer",
                self._ask_labels,
                "Add the cells as a Labels layer with their measurements.",
            ),
        ):
            action: Any = menu.addAction(title)
            action.setToolTip(tip)
            action.triggered.connect(slot)
        return menu

    def _ask_labels(self, checked: bool = False) -> None:
        self.labels_wanted.emit()

    def _chosen(self, regions: tuple[int, ...], by_hand: bool) -> None:
        self.cells_chosen.emit(frozenset(regions))
        if by_hand and regions:
            self.cell_chosen.emit(self.table.center(regions[-1]))

    def _ask_meshes(self, checked: bool = False) -> None:
        path, kind = QFileDialog.getSaveFileName(
            self, "Save meshes", f"mesh{MESH_FILES[0]}", MESH_FILTERS
        )
        if path and not Path(path).suffix:
            path += kind[kind.index("*") + 1 : -1]
        self._save(self.save_meshes, path)

    def _ask_table(self, checked: bool = False) -> None:
        path, _ = QFileDialog.getSaveFileName(self, "Save table", "measurements.csv", "CSV (*.csv)")
        self._save(self.save_table, path)

    def _ask_image(self, checked: bool = False) -> None:
        path, _ = QFileDialog.getSaveFileName(
            self, "Save rendered image", "rendered.ome.tif", IMAGE_FILES
        )
        if path and not Path(path).suffix:
            path += ".ome.tif"
        self._save(self.save_image, path)

    def _ask_all(self, checked: bool = False) -> None:
        folder = QFileDialog.getExistingDirectory(self, "Folder for the results")
        self._save(self.save_all, folder)

    def _save(self, write: Callable[[str], None], path: str) -> None:
        if path:
            self._guard(lambda: write(path))
