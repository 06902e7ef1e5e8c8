"""A table of the cells that can be sorted, copied, and chosen from."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from math import nan
from typing import Any

from qtpy.QtCore import QEvent, QSignalBlocker, Qt
from qtpy.QtGui import QColor, QKeyEvent, QKeySequence
from qtpy.QtWidgets import (
    QAbstractItemView,
    QApplication,
    QHeaderView,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from ...evidence.residual import CellFit
from ...measure.cells import CellRow
from ...results.colouring import colour_of
from ..qt import Signal

_COLUMNS = (
    ("cell", "region", "{:.0f}", "Number of the cell; its colour is that of its surface."),
    ("volume, µm³", "volume_um3", "{:.2f}", "Volume, um^3."),
    ("area, µm²", "area_um2", "{:.2f}", "Area of the whole surface, walls included, um^2."),
    ("sphericity", "sphericity", "{:.3f}", "1 for a sphere, less for any other shape."),
)
# Only there once the residual was looked at.
_FITS = (
    (
        "explained",
        "explained",
        "{:.1%}",
        "Share of what varies near the cell, beyond noise, that the fit explains.",
    ),
    (
        "residual, z",
        "residual_z",
        "{:.1f}",
        "Standard deviations by which the residual near the cell is larger than noise.",
    ),
)
_FIT_KEYS = tuple(key for _, key, _, _ in _FITS)
_ALL = (*_COLUMNS, *_FITS)
_REGION = Qt.ItemDataRole.UserRole


class CellTable(QTableWidget):
    """One row a cell.

    ``chosen`` gives the regions of the rows that are selected, the newest last, and whether the
    user selected them here (rather than through :meth:`choose`).
    """

    chosen = Signal(tuple, bool)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(0, len(_ALL), parent)
        self._rows: dict[int, CellRow] = {}
        self._colours: Mapping[int, int] = {}
        self._told: tuple[int, ...] = ()
        for column, (title, _, _, tip) in enumerate(_ALL):
            item = QTableWidgetItem(title.replace(", ", "\n"))
            item.setToolTip(f"{tip} Click to sort.")
            self.setHorizontalHeaderItem(column, item)
        rows: Any = self.verticalHeader()
        rows.setVisible(False)
        columns: Any = self.horizontalHeader()
        columns.setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        columns.setSectionResizeMode(0, QHeaderView.ResizeMode.ResizeToContents)
        columns.setHighlightSections(False)
        columns.setMinimumSectionSize(30)
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.setMinimumHeight(90)
        self.setSortingEnabled(True)
        self.sortByColumn(0, Qt.SortOrder.AscendingOrder)
        self.setToolTip(
            "<qt>Choose a row to go to the cell, several with Ctrl or Shift; or click on cells in "
            "the viewer. Ctrl+C copies the rows chosen, or all.</qt>"
        )
        self.itemSelectionChanged.connect(self._selection_changed)
        self._hide_fits(True)

    def show_rows(
        self, rows: Collection[CellRow], colours: Mapping[int, int] | None = None
    ) -> None:
        """Show measurements, as from ``measure_cells``; cells that are still there stay chosen.

        colours : of the cells, see ``colour_indices``; None: as they were.
        """
        self._colours = self._colours if colours is None else colours
        self._hide_fits(not any("explained" in row for row in rows))
        before = self.chosen_regions()
        blocker = QSignalBlocker(self)
        self._rows = {int(row["region"]): row for row in rows}
        self.setSortingEnabled(False)  # or rows would move while they are filled
        self.setRowCount(len(rows))
        for r, row in enumerate(rows):
            for c, (_, key, form, _) in enumerate(_ALL):
                self.setItem(r, c, _cell(row, key, form, self._colours))
        self.setSortingEnabled(True)
        self._select(before)
        blocker.unblock()
        self._tell(by_hand=False)

    def show_fits(self, cells: Collection[CellFit]) -> None:
        """Show how well the cells are explained; nothing of it where there are none."""
        fits = {cell.region: cell for cell in cells}
        rows = [{k: v for k, v in row.items() if k not in _FIT_KEYS} for row in self._rows.values()]
        for row in rows if fits else ():
            fit = fits.get(int(row["region"]))
            share = None if fit is None else fit.explained
            row["explained"] = nan if share is None else share
            row["residual_z"] = nan if fit is None else fit.z
        self.show_rows(rows)

    def chosen_regions(self) -> tuple[int, ...]:
        """The regions of the rows selected, in the order in which they were."""
        model: Any = self.selectionModel()
        now = [self._region(row) for row in sorted(i.row() for i in model.selectedRows())]
        before = [region for region in self._told if region in now]
        return (*before, *(region for region in now if region not in before))

    def choose(self, regions: Collection[int]) -> None:
        """Select the rows of some regions, and no others."""
        blocker = QSignalBlocker(self)
        self._select(regions)
        blocker.unblock()
        self._tell(by_hand=False)

    def center(self, region: int) -> tuple[float, float, float]:
        """Centre of a cell, um; NaN if it has none."""
        row = self._rows[region]
        z, y, x = (float(row[f"centroid_{axis}_um"]) for axis in "zyx")
        return z, y, x

    def as_text(self) -> str:
        """The rows selected, or all, as they are sorted: tab-separated, with a header."""
        model: Any = self.selectionModel()
        rows = sorted(i.row() for i in model.selectedRows()) or range(self.rowCount())
        shown = [column for c, column in enumerate(_ALL) if not self.isColumnHidden(c)]
        lines = [[title for title, _, _, _ in shown]]
        for r in rows:
            row = self._rows[self._region(r)]
            lines.append([f"{row[key]:.10g}" for _, key, _, _ in shown])
        return "\n".join("\t".join(line) for line in lines) + "\n"

    def copy(self) -> None:
        """Copy the rows selected, or all, for a spreadsheet."""
        clipboard: Any = QApplication.clipboard()
        clipboard.setText(self.as_text())

    def event(self, event: QEvent | None) -> bool:
        """Qt's: Ctrl+C is ours before it is a shortcut of the window."""
        if (
            isinstance(event, QKeyEvent)
            and event.type() == QEvent.Type.ShortcutOverride
            and event.matches(QKeySequence.StandardKey.Copy)
        ):
            event.accept()
            return True
        return bool(super().event(event))

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Qt's."""
        if event is not None and event.matches(QKeySequence.StandardKey.Copy):
            self.copy()
        elif event is not None and event.key() == Qt.Key.Key_Escape:
            self.clearSelection()
        else:
            super().keyPressEvent(event)

    # ----------------------------------------------------------------------------------- inside

    def _hide_fits(self, hidden: bool) -> None:
        for column in range(len(_COLUMNS), len(_ALL)):
            self.setColumnHidden(column, hidden)

    def _region(self, row: int) -> int:
        item: Any = self.item(row, 0)
        return int(item.data(_REGION))

    def _select(self, regions: Collection[int]) -> None:
        self.clearSelection()
        mode = self.selectionMode()
        self.setSelectionMode(QAbstractItemView.SelectionMode.MultiSelection)
        for row in range(self.rowCount()):
            if self._region(row) in regions:
                self.selectRow(row)
        self.setSelectionMode(mode)
        model: Any = self.selectionModel()
        if model.selectedRows():
            self.scrollTo(model.selectedRows()[-1])

    def _selection_changed(self) -> None:
        self._tell(by_hand=True)

    def _tell(self, *, by_hand: bool) -> None:
        regions = self.chosen_regions()
        if regions != self._told:
            self._told = regions
            self.chosen.emit(regions, by_hand)


class _Item(QTableWidgetItem):
    """Sorts by its number; what has none comes last."""

    def __init__(self, text: str, value: float) -> None:
        super().__init__(text)
        self.value = value if value == value else float("inf")

    def __lt__(self, other: QTableWidgetItem) -> bool:
        return isinstance(other, _Item) and self.value < other.value


def _cell(row: CellRow, key: str, form: str, colours: Mapping[int, int]) -> QTableWidgetItem:
    value = float(row.get(key, nan))
    item = _Item(form.format(value) if value == value else "-", value)
    item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
    region = int(row["region"])
    if key == "region":
        item.setForeground(QColor(*colour_of(region, colours)))
        item.setData(_REGION, region)
    if value != value and key in _FIT_KEYS:
        item.setToolTip("Nothing near this cell varies by more than noise.")
    elif value != value:
        item.setToolTip("The surface of this cell is not closed, or inside out.")
    return item
