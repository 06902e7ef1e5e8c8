"""A table of the cells, files of everything that was found, and clicks that choose cells."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from napari.layers import Labels
from qtpy.QtWidgets import QFileDialog, QGroupBox, QMenu, QVBoxLayout, QWidget
from superqt.utils import signals_blocked

from ...common.table import csv_text
from ...common.words import sentence
from ...common.writing import write_atomically
from ...errors import InputError
from ...geometry import save_mesh
from ...geometry.formats import MESH_FILES, MESH_FILES_LISTED, MESH_FILTERS
from ...geometry.mesh import OUTSIDE
from ...images.stacks import write_image
from ...measure.picking import region_behind, region_in_slice
from ...results.cell_columns import value_of
from ...results.mesh_exchange import labels_of
from ...results.report import FILES as RESULT_FILES
from ...results.report import write_results
from ..cell_table import CellTable, why_of
from ..document import Document
from ..record import Record
from ..viewing.cell_layers import labels_options
from ..viewing.colours import label_colormap
from ..viewing.contours import sliced_axis
from ..viewing.frame import camera_of
from ..viewing.listening import Presses, is_click, wants_clicks
from ..viewing.viewer_link import ViewerLink
from ..widgets import Note, action, button, confirmed, filled, narrow_box, row

IMAGE_FILES = "OME-TIFF (*.ome.tif *.ome.tiff);;ImageJ TIFF (*.tif *.tiff)"
_NEAR = 6.0  # px: how far from its contour a click may be


class ResultsPanel(QGroupBox):
    """Shows the cells of the result of the image chosen, and saves what was found."""

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__("5  Results", parent)
        self._doc = doc
        self._shown_of: Any = None  # the state whose cells are shown
        self.table = CellTable(self)
        tip = "Colour the cells in the viewer by a column of the table."
        self.colour = narrow_box(self, "colour cells by", tip, characters=5)
        self.columns = button("Columns", "Choose what the table shows.", None, self)
        shown = QMenu(self.columns)
        shown.aboutToShow.connect(partial(self.table.fill_menu, shown))
        self.columns.setMenu(shown)
        tip = "Save what was found, or add the cells as labels."
        self.export = button("Export", tip, None, self)
        self.export.setMenu(self._export_menu())
        self.valid_for = Note(self, "fair")  # where that is not the image as it is now
        self.scale, self.why = Note(self), Note(self)  # of the colours; of the cell chosen
        buttons = row(self.colour, self.columns, self.export)
        filled(QVBoxLayout(self), self.valid_for, self.table, self.why, buttons, self.scale)
        self.table.chosen.connect(self._chosen)
        self.colour.currentIndexChanged.connect(self._colour_cells)
        of_result = doc.result_changed, doc.judged, doc.image.changed, doc.ended
        for signal in (*of_result, doc.image.looked, doc.looked_back, doc.work.changed):
            signal.connect(self._show)
        doc.selection_changed.connect(self._highlight)
        self._offer_colours()
        self._show()

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
            save_mesh(self._result().of_fit()[0].mesh, path)
        self._saved(path)
        for warning in caught:
            self._doc.warned.emit(str(warning.message))

    def save_table(self, path: str) -> None:
        """Write the table; a name of another kind of file gets .csv at its end."""
        if Path(path).suffix.lower() != ".csv":
            path = _new(f"{path}.csv")
        write_atomically(path, self._csv().encode())
        self._saved(path)

    def _csv(self) -> str:
        """The table as CSV, in the columns in which at least one cell has a value."""
        names = [column.key for column in self.table.known_columns()]
        rows = [{name: value_of(row, name) for name in names} for row in self.table.rows]
        return csv_text(names, rows)

    def save_image(self, path: str) -> None:
        state, job = self._result().of_fit()
        write_image(path, state.rendered(), job.grid.voxel_size)
        self._saved(path)

    def save_all(self, folder: str) -> None:
        """Write what the command line would, with the same table as :meth:`save_table`."""
        record = self._result()
        end = record.reached
        assert end is not None
        job = end.job
        given = end.state, job.image, job.grid, job.settings, end.history, end.seconds
        verdict = None if record.judged is None else record.judged.verdict
        write_results(folder, *given, verdict=verdict, table=self._csv())
        if not (job.settings.image and job.settings.seeds):
            self._doc.warned.emit(
                "run.toml does not repeat this run, as its image or its cells are in no file: "
                "'Copy as command' in the menu More writes them"
            )
        self._saved(folder)

    def add_labels(self) -> None:
        """Add the cells as a Labels layer with their measurements."""
        record = self._result()
        (state, job), link = record.of_fit(), record.link
        labels, name = labels_of(state.mesh, job.grid), f"{link.image_layer.name}: labels"
        layer = Labels(labels, **labels_options(self.table.rows, link.frame, name))
        layer.colormap = label_colormap(labels)
        self._doc.viewer.add_layer(layer)

    def _result(self) -> Record:
        record = self._doc.result
        if record is None:
            raise InputError("there is no result yet: run a fit first")
        return record

    def _saved(self, path: str) -> None:
        size = self._doc.other_size
        kept = f", as it was fitted with {size}" if size else ""
        if self._doc.other == "pixels":
            kept = ", as it was fitted to earlier pixels"
        self._doc.told.emit(f"saved {path}{kept}")

    def _show(self) -> None:
        """Show the cells of the result; nothing if there is none."""
        record = self._doc.result
        self.valid_for.say(self._valid_for())
        self.setVisible(record is not None)
        self.setEnabled(record is not None)
        if record is None:
            self._shown_of = None
            return
        name = self._doc.name_of_other(record)
        self.setTitle(record.link.with_time(f"5  Results of {name}" if name else "5  Results"))
        key = (record.state, record.judged)
        if key != self._shown_of:
            self._shown_of = key
            self.table.show_rows(record.rows, record.link.frame.length)
            self._explain()
            self._offer_colours()
            if record.judged is not None:
                record.link.describe(self.table.rows)

    def _valid_for(self) -> str:
        """Says what table and exports belong to if that is not what is seen; else ''."""
        doc = self._doc
        if doc.rescued is not None:
            return f"Of '{doc.rescued.link.image_layer.name}', which was removed."
        if doc.running:
            return "Of the fit before: the one that runs has no results before it ends."
        told = {
            "size": f"Fitted with {doc.other_size}: table and exports are for that size.",
            "pixels": "Fitted to other pixels than the image has now: table and exports are of "
            "that fit.",
            "place": "The image was moved since: what is shown of the fit stays where it was.",
        }
        if doc.other:
            return told[doc.other]
        earlier = "An earlier moment is shown: table and exports are of the end."
        return earlier if doc.moment is not None else ""

    def _offer_colours(self) -> None:
        """Offer the numeric columns for colouring; the one in use stays if possible."""
        before = self.coloured_by
        with signals_blocked(self.colour):
            self.colour.clear()
            self.colour.addItem("by cell", "")
            for column in self.table.known_columns()[1:]:
                if self.table.numbers(column.key):
                    self.colour.addItem(f"by {column.name}", column.key)
            self.colour.setCurrentIndex(max(self.colour.findData(before), 0))
        self._colour_cells()

    def _colour_cells(self, index: int = 0) -> None:
        """Colour the cells in the viewer by a column, and say which numbers the colours span."""
        key, link = self.coloured_by, self._doc.link
        numbers = self.table.numbers(key) if key else None
        column = next((c for c in self.table.columns if c.key == key), None)
        if link is not None:
            link.colour_by(numbers)
            self.table.show_swatches(link.contours.colours_of)
        if not numbers or column is None:
            self.scale.say("")
            return
        low, high = (column.text(limit) for limit in (min(numbers.values()), max(numbers.values())))
        self.scale.say(f"{column.name}: from {low} (blue) to {high} (yellow)")

    def _chosen(self, regions: tuple[int, ...], by_hand: bool) -> None:
        self._doc.select(regions)
        if by_hand and regions and self._doc.link is not None:
            self._doc.link.go_to(self.table.center(regions[-1]))

    def _highlight(self) -> None:
        self._explain()
        if self._doc.link is not None:
            self._doc.link.highlight(self._doc.selection)

    def _explain(self) -> None:
        """Show the remarks on the chosen cell, if it is a single one."""
        chosen = self._doc.selection
        rows = [row for row in self.table.rows if {row["region"]} == chosen]
        self.why.say(sentence(why_of(rows[0])) if rows else "")

    def _export_menu(self) -> QMenu:
        menu = QMenu(self)
        menu.setToolTipsVisible(True)
        meshes = f"mesh{MESH_FILES[0]}"
        image = "Save the rendered image with its voxel size: .ome.tif, or .tif for ImageJ."
        everything = "Save everything in a folder: meshes, image, measurements, settings, report."
        labels = "Add the cells as a Labels layer with their measurements."
        for title, tip, write, name, kinds in (
            ("Meshes", f"Save: {MESH_FILES_LISTED}, um.", self.save_meshes, meshes, MESH_FILTERS),
            ("Table", "Save all columns, um.", self.save_table, "measurements.csv", "CSV (*.csv)"),
            ("Image", image, self.save_image, "rendered.ome.tif", IMAGE_FILES),
            ("All", everything, self.save_all, "", ""),
        ):
            slot = partial(self._ask, write, name, kinds)
            menu.addAction(action(f"{title}...", tip, slot, menu))
        add = partial(self._doc.attempt, self.add_labels)
        menu.addAction(action("Labels layer", labels, add, menu))
        return menu

    def _ask(self, write: Callable[[str], None], name: str, kinds: str) -> None:
        """Ask for a file of some kinds, or without a name for a folder; then write it."""
        if name:
            path, kind = QFileDialog.getSaveFileName(self, "Save", name, kinds)
            suffix = re.search(r"\*([.\w]+)", kind or kinds)
            if path and suffix and not Path(path).suffix:
                self._doc.attempt(lambda: write(_new(path + suffix[1])))
                return
        else:
            path = QFileDialog.getExistingDirectory(self, "Folder for the results")
        if path and (name or self._may_replace(path)):
            self._doc.attempt(partial(write, path))

    def _may_replace(self, folder: str) -> bool:
        """Whether the results of another fit in a folder, if any, may be replaced."""
        there = [file for file in RESULT_FILES if (Path(folder) / file).exists()]
        text = f"{folder} holds another result: {', '.join(there)}."
        return not there or confirmed(self, "Replace it?", text, "Replace it", "Keep it")


def _new(path: str) -> str:
    """The path itself, for one that no dialog has checked. InputError if something is there."""
    if Path(path).exists():
        raise InputError(f"{path} is there already: choose it, or another name")
    return path


class ClickSelection:
    """Reports which cell was clicked on, while its ``presses`` listen.

    Parameters
    ----------
    link : gives what shows the meshes at present, or None.
    on_click : called with the region (0 beside all cells) and whether it is to be added to those
        chosen already (Ctrl or Shift).
    """

    def __init__(
        self,
        viewer: Any,
        link: Callable[[], ViewerLink | None],
        on_click: Callable[[int, bool], None],
    ) -> None:
        self._link, self._on_click = link, on_click
        self.presses = Presses(viewer, self._pressed)
        self.presses.listen()

    def _pressed(self, viewer: Any, event: Any) -> Iterator[None]:
        link = self._link()
        if event.button != 1 or event.handled or wants_clicks(viewer.layers.selection.active):
            return  # a tool of ours, or of the layer, is in use
        if link is None or link.shown is None:
            return
        adding = any(key in event.modifiers for key in ("Control", "Shift"))
        if (yield from is_click(event)):
            self._on_click(region_at(link, event), adding)


def region_at(link: ViewerLink, event: Any) -> int:
    """The region at a mouse event in the viewer in which a link shows a mesh; 0 if none."""
    mesh, dims = link.shown, link.viewer.dims
    if mesh is None or not link.at_time:
        return OUTSIDE
    if dims.ndisplay == 3:
        if link.surface is None or not link.surface.visible:
            return OUTSIDE
        _, face = link.surface.get_value(
            event.position,
            view_direction=event.view_direction,
            dims_displayed=list(event.dims_displayed),
            world=True,
        ) or (None, None)
        face = None if face is None else link.face_of(int(face))
        if face is None or face >= len(mesh.faces):
            return OUTSIDE
        return region_behind(mesh, face, link.frame.direction_of(event))
    axis = sliced_axis(dims)
    if axis is None:
        return OUTSIDE
    um = link.frame.place_of(event)
    drawn = max(unit for k, unit in enumerate(link.frame.um) if k != axis)
    near = drawn * _NEAR / max(float(camera_of(link.viewer).zoom), 1e-9)
    return region_in_slice(mesh, axis, um, near)
