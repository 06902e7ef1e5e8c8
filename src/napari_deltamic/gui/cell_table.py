"""A table of the cells that can be sorted, copied, and chosen from."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from qtpy.QtCore import QEvent, Qt
from qtpy.QtGui import QColor, QKeyEvent, QKeySequence
from qtpy.QtWidgets import (
    QAbstractItemView,
    QApplication,
    QMenu,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)
from superqt.utils import signals_blocked

from ..common.triple import Triple, triple
from ..results.cell_columns import (
    COLUMNS,
    FIRST,
    CellColumn,
    columns_in,
    is_number,
    value_of,
)
from .widgets import Signal, be_table_of_rows
from .window_words import as_tip, for_window

_REGION = Qt.ItemDataRole.UserRole
_OPEN = "The surface of this cell is not closed, or inside out."
_BEFORE = ("explained", "grade")  # come first, as a narrow dock shows few: the last one before all
_EMPTY = ("no volume: ", "no curvature: ", "no pressure: ")  # of ``measure.all_cells``
_WHY = {"explained": "Nothing near this cell varies by more than noise."}


class CellTable(QTableWidget):
    """A table with one row per cell.

    ``chosen`` gives the regions of the rows that are selected, the newest last, and whether the
    user selected them here (rather than through :meth:`choose`).
    """

    chosen = Signal(tuple, bool)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(0, len(COLUMNS), parent)
        self._rows: dict[int, dict[str, Any]] = {}
        self.columns: Sequence[CellColumn] = COLUMNS  # as they are titled
        self._told: tuple[int, ...] = ()
        self._wanted = set(FIRST)  # columns, by key; those without values are not shown
        more = "Click to sort, right-click for columns."
        titles = ((column.title, f"{column.tip} {more}") for column in COLUMNS)
        columns = be_table_of_rows(self, titles, 36)
        columns.setStretchLastSection(True)
        for key in _BEFORE:
            columns.moveSection([column.key for column in COLUMNS].index(key), 1)
        columns.setContextMenuPolicy(Qt.ContextMenuPolicy.CustomContextMenu)
        columns.customContextMenuRequested.connect(self._ask_columns)
        self.setMinimumHeight(120)
        self.setSortingEnabled(True)
        self.sortByColumn(0, Qt.SortOrder.AscendingOrder)
        self.setAccessibleName("table of cells")
        self.setToolTip(
            "<qt>Choose a row to go to the cell, several with Ctrl or Shift; or click on cells in "
            "the viewer. Ctrl+C copies the rows chosen, or all.</qt>"
        )
        self.itemSelectionChanged.connect(self._tell)
        self._hide_columns()

    @property
    def rows(self) -> tuple[Mapping[str, Any], ...]:
        """What is known about the cells: a mapping from column names for each."""
        return tuple(self._rows.values())

    def known_columns(self) -> list[CellColumn]:
        """The columns in which at least one cell has a value."""
        return [
            c for c in self.columns if any(value_of(row, c.key) is not None for row in self.rows)
        ]

    def numbers(self, key: str) -> dict[int, float]:
        """The numbers in a column, by region; cells without one are left out."""
        values: dict[int, Any] = {region: row.get(key) for region, row in self._rows.items()}
        return {region: float(v) for region, v in values.items() if is_number(v)}

    def show_column(self, key: str, shown: bool = True) -> None:
        """Show or hide a column; that of cell numbers always stays."""
        self._wanted = self._wanted | {key} if shown else self._wanted - {key}
        self._hide_columns()

    def fill_menu(self, menu: QMenu) -> None:
        """Fill a menu with a check box for each column."""
        menu.clear()
        menu.setToolTipsVisible(True)
        for column in self.known_columns()[1:]:
            action: Any = menu.addAction(column.name)
            action.setCheckable(True)
            action.setChecked(column.key in self._wanted)
            action.setToolTip(for_window(column.tip))
            action.toggled.connect(partial(self.show_column, column.key))

    def show_rows(self, rows: Collection[Mapping[str, Any]], length: str = "µm") -> None:
        """Show measurements, as from ``measure_cells``; cells that are still there stay chosen.

        length : what lengths are in.
        """
        self.columns = columns_in(length)
        for number, column in enumerate(self.columns):
            header: Any = self.horizontalHeaderItem(number)
            header.setText(column.title)
        before = self.chosen_regions()
        self._rows = {int(row["region"]): dict(row) for row in rows}
        with signals_blocked(self):
            self.setSortingEnabled(False)  # or rows would move while they are filled
            self.setRowCount(len(rows))
            for r, row in enumerate(rows):
                for c, column in enumerate(COLUMNS):
                    self.setItem(r, c, _cell(row, column))
            self.setSortingEnabled(True)
            self._hide_columns()
            self._select(before)
        bars: tuple[Any, ...] = self.horizontalHeader(), self.horizontalScrollBar()
        side: Any = self.verticalHeader()
        height = int(side.length()) + sum(bar.sizeHint().height() for bar in bars) + 2
        self.setMaximumHeight(max(height, self.minimumHeight()))  # no empty room below few rows
        self._tell(by_hand=False)

    def show_swatches(self, colours_of: Callable[[Any], Any]) -> None:
        """Give each row the colour of its cell in the viewer.

        Beside the number, which could not be read in a pale colour on a light theme.

        colours_of : (n, 4) RGBA, up to 1, of region numbers (n,).
        """
        if not self._rows:
            return
        colours = np.round(255 * np.asarray(colours_of(np.array(list(self._rows))))).astype(int)
        shown = dict(zip(self._rows, colours[:, :3].tolist(), strict=True))
        for row in range(self.rowCount()):
            item: Any = self.item(row, 0)
            item.setData(Qt.ItemDataRole.DecorationRole, QColor(*shown[self._region(row)]))

    def chosen_regions(self) -> tuple[int, ...]:
        """The regions of the selected rows, in the order in which they were selected."""
        now = [self._region(row) for row in self._selected()]
        before = [region for region in self._told if region in now]
        return (*before, *(region for region in now if region not in before))

    def choose(self, regions: Collection[int]) -> None:
        with signals_blocked(self):
            self._select(regions)
        self._tell(by_hand=False)

    def center(self, region: int) -> Triple:
        """Centre of a cell, um; NaN if it has none."""
        return triple(self._rows[region][f"centroid_{axis}_um"] for axis in "zyx")

    def as_text(self) -> str:
        """The selected rows, or all, in table order: tab-separated, with a header."""
        rows = self._selected() or range(self.rowCount())
        shown = [column for c, column in enumerate(self.columns) if not self.isColumnHidden(c)]
        lines = [[column.name for column in shown]]
        for r in rows:
            row = self._rows[self._region(r)]
            lines.append([_exact(row.get(column.key)) for column in shown])
        return "\n".join("\t".join(line) for line in lines) + "\n"

    def copy(self) -> None:
        """Copy the selected rows, or all, for a spreadsheet."""
        clipboard: Any = QApplication.clipboard()
        clipboard.setText(self.as_text())

    def event(self, event: QEvent | None) -> bool:
        """Called by Qt: takes Ctrl+C before it becomes a shortcut of the window."""
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

    def _hide_columns(self) -> None:
        known = {column.key for column in self.known_columns()} if self._rows else set(FIRST)
        for number, column in enumerate(COLUMNS):
            shown = number == 0 or (column.key in self._wanted and column.key in known)
            self.setColumnHidden(number, not shown)

    def _ask_columns(self, place: Any) -> None:
        menu = QMenu(self)
        self.fill_menu(menu)
        columns: Any = self.horizontalHeader()
        menu.exec(columns.mapToGlobal(place))

    def _region(self, row: int) -> int:
        item: Any = self.item(row, 0)
        return int(item.data(_REGION))

    def _selected(self) -> list[int]:
        """The rows that are selected, from the top."""
        model: Any = self.selectionModel()
        return sorted(index.row() for index in model.selectedRows())

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

    def _tell(self, *, by_hand: bool = True) -> None:
        regions = self.chosen_regions()
        if regions != self._told:
            self._told = regions
            self.chosen.emit(regions, by_hand)


class _Item(QTableWidgetItem):
    """A table item that sorts by its number or text; empty ones come last."""

    def __init__(self, text: str, value: Any) -> None:
        super().__init__(text)
        number = float(value) if is_number(value) else float("inf")
        self.key = (number, value if isinstance(value, str) else "~")

    def __lt__(self, other: QTableWidgetItem) -> bool:
        return isinstance(other, _Item) and self.key < other.key


def _cell(row: Mapping[str, Any], column: CellColumn) -> QTableWidgetItem:
    value = value_of(row, column.key)
    item = _Item(for_window(column.text(value)), value)
    side = Qt.AlignmentFlag.AlignLeft if isinstance(value, str) else Qt.AlignmentFlag.AlignRight
    item.setTextAlignment(side | Qt.AlignmentFlag.AlignVCenter)
    if column.key == "region":
        item.setData(_REGION, int(row["region"]))
    elif value is None and column.key in row:
        note = for_window(str(row.get("note") or ""))
        item.setToolTip(as_tip(note or _WHY.get(column.key, _OPEN)))
    elif isinstance(value, str):
        why = "; ".join(_notes(row)[0]) if column.key == "grade" else ""
        item.setToolTip(as_tip(why or value))
    return item


def why_of(row: Mapping[str, Any]) -> str:
    """Remarks on a cell, first why its grade is not better; '' for none."""
    why, empty = ("; ".join(part) for part in _notes(row))
    return ". ".join(filter(None, (why, f"Note: {empty}" if empty else "")))


def _notes(row: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """Notes on a cell, and those on its empty columns, which are no reasons for a grade."""
    parts = [part for part in for_window(str(row.get("note") or "")).split("; ") if part]
    empty = [part for part in parts if part.startswith(_EMPTY)]
    return [part for part in parts if part not in empty], empty


def _exact(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.10g}" if isinstance(value, int | float) else str(value)
