"""A table of the cells, and files of everything that was found."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from qtpy.QtCore import Qt
from qtpy.QtGui import QColor
from qtpy.QtWidgets import (
    QAbstractItemView,
    QFileDialog,
    QGroupBox,
    QHBoxLayout,
    QHeaderView,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from ..geometry import Mesh, save_mesh
from ..images import write_image
from ..inference import FitState
from ..job import FitInput
from ..measure import measure_cells, write_csv
from ..measure.cells import CellRow
from ..picture import COLOURS
from ..report import History, write_results
from .qt import Signal

_COLUMNS = (
    ("cell", "region", "{:.0f}"),
    ("volume, um³", "volume_um3", "{:.2f}"),
    ("area, um²", "area_um2", "{:.2f}"),
    ("sphericity", "sphericity", "{:.3f}"),
)
MESH_FILES = "PLY (*.ply);;OBJ (*.obj);;STL (*.stl);;multimaterial (*.rec)"


class ResultsPanel(QGroupBox):
    """Shows the cells of a mesh; ``cell_chosen`` gives the centre (um) of the row selected."""

    cell_chosen = Signal(tuple)
    saved = Signal(str)

    def __init__(self, guard: Callable[[Callable[[], None]], None], parent: QWidget | None = None):
        super().__init__("Results", parent)
        self._guard = guard  # runs what may fail, and shows in plain words why it did
        self._rows: list[CellRow] = []
        self.last: tuple[FitState, FitInput, History, float] | None = None
        self.table = QTableWidget(0, len(_COLUMNS), self)
        self.table.setHorizontalHeaderLabels([title for title, _, _ in _COLUMNS])
        rows: Any = self.table.verticalHeader()
        rows.setVisible(False)
        self.table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        columns: Any = self.table.horizontalHeader()
        columns.setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        self.table.setMinimumHeight(90)
        self.table.setToolTip("Choose a row to go to the cell.")
        self.table.itemSelectionChanged.connect(self._chosen)
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
            "Save the meshes: .ply, .obj, .stl or .rec, um.",
            "Save the measurements as .csv, um.",
            "Save the rendered image as .tif, with its voxel size.",
            "Save everything in a folder: meshes, image, measurements, settings, report, picture.",
        )
        for (title, slot), tip in zip(self.buttons.items(), tips, strict=True):
            button = QPushButton(title, self)
            button.setToolTip(tip)
            button.clicked.connect(slot)
            buttons.addWidget(button)
        layout.addLayout(buttons)
        self.setEnabled(False)

    def show_result(self, state: FitState, job: FitInput, history: History, seconds: float) -> None:
        """Show the cells of a state, and offer to save it."""
        self.last = (state, job, history, seconds)
        self._show_cells(state.mesh)
        self.setEnabled(True)

    # ---- files: each raises InputError if it cannot be written --------------------------------

    def save_meshes(self, path: str) -> None:
        """Write the meshes, in the format of the path's extension."""
        save_mesh(self._result()[0].mesh, path)
        self.saved.emit(path)

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
        self._rows = measure_cells(mesh)
        self.table.setRowCount(len(self._rows))
        for r, row in enumerate(self._rows):
            for c, (_, key, form) in enumerate(_COLUMNS):
                item = QTableWidgetItem(form.format(row[key]))
                item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                if c == 0:
                    item.setForeground(QColor(*COLOURS[(int(row["region"]) - 1) % len(COLOURS)]))
                self.table.setItem(r, c, item)

    def _chosen(self) -> None:
        model: Any = self.table.selectionModel()
        chosen = model.selectedRows()
        if chosen:
            row = self._rows[chosen[0].row()]
            self.cell_chosen.emit(tuple(row[f"centroid_{axis}_um"] for axis in "zyx"))

    def _ask_meshes(self) -> None:
        path, kind = QFileDialog.getSaveFileName(self, "Save meshes", "mesh.ply", MESH_FILES)
        if path and not Path(path).suffix:
            path += kind[kind.index("*") + 1 : -1]
        self._save(self.save_meshes, path)

    def _ask_table(self) -> None:
        path, _ = QFileDialog.getSaveFileName(self, "Save table", "measurements.csv", "CSV (*.csv)")
        self._save(self.save_table, path)

    def _ask_image(self) -> None:
        path, _ = QFileDialog.getSaveFileName(
            self, "Save rendered image", "rendered.ome.tif", "TIFF (*.tif *.tiff)"
        )
        self._save(self.save_image, path)

    def _ask_all(self) -> None:
        folder = QFileDialog.getExistingDirectory(self, "Folder for the results")
        self._save(self.save_all, folder)

    def _save(self, write: Callable[[str], None], path: str) -> None:
        if path:
            self._guard(lambda: write(path))
