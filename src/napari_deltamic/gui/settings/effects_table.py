"""The table of effects, with a check box and the evidence for each."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from qtpy.QtCore import QSignalBlocker, Qt
from qtpy.QtWidgets import QAbstractItemView, QHeaderView, QTableWidget, QTableWidgetItem, QWidget

from ...common.words import sentence
from ...evidence import Evidence
from ...evidence.candidates import CONSIDERED
from ...scene.effects import KINDS
from ..widgets import Signal, be_as_high_as_rows, be_table_of_rows
from ..window_words import as_tip

_COLUMNS = (
    ("correction", "Tick to include it: in a running fit from now on, otherwise in the next one."),
    ("evidence\nσ", "How clearly the image shows it, in standard deviations (σ) of chance."),
    ("shift\nnm", "How far off the surface is without it, as predicted."),
    ("slower\nms", "How much longer an iteration takes with it, as predicted."),
)
_BOXES = (
    "QTableWidget::indicator { border: 1px solid #8d99a6; background: transparent; }"
    "QTableWidget::indicator:checked { background: #4f8fe0; }"
)
_NAME = Qt.ItemDataRole.UserRole


class EffectsTable(QTableWidget):
    """A table of effects; ``ticked`` gives name and state when the user changes a box."""

    ticked = Signal(str, bool)
    looked_at = Signal(str)  # the effect of the row chosen

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(0, len(_COLUMNS), parent)
        self._evidence: dict[str, Evidence] = {}
        self._present: frozenset[str] = frozenset()
        columns = be_table_of_rows(self, _COLUMNS, 30)
        columns.setSectionResizeMode(0, QHeaderView.ResizeMode.Stretch)
        rows: Any = self.verticalHeader()
        rows.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        be_as_high_as_rows(self)
        # napari's own boxes can hardly be seen on a table.
        self.setStyleSheet(_BOXES)
        self.itemChanged.connect(self._changed)
        self.itemSelectionChanged.connect(self._chosen)
        self._fill()

    def show_evidence(self, evidence: Iterable[Evidence]) -> None:
        """Show the evidence, recommended effects first."""
        self._evidence = {e.name: e for e in evidence}
        self._fill()

    def show_present(self, names: Iterable[str]) -> None:
        """Tick these effects, and no others."""
        self._present = frozenset(names)
        self._fill()

    def names(self) -> tuple[str, ...]:
        return tuple(self._name(row) for row in range(self.rowCount()))

    def tick(self, name: str, on: bool = True) -> None:
        """Change a box as the user does."""
        item: Any = self.item(self.names().index(name), 0)
        item.setCheckState(Qt.CheckState.Checked if on else Qt.CheckState.Unchecked)

    def _fill(self) -> None:
        blocker = QSignalBlocker(self)
        found = self._evidence
        known = [*found, *(n for n in CONSIDERED if n not in found)]
        # A camera or missing voxels are only offered where they were found, or are there.
        names = [*known, *(n for n in KINDS if n in self._present and n not in known)]
        self.setRowCount(len(names))
        for row, name in enumerate(names):
            evidence = found.get(name)
            for column, text in enumerate(_texts(name, evidence)):
                item = QTableWidgetItem(text)
                item.setToolTip(_tip(name, evidence))
                if column:
                    item.setTextAlignment(
                        Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
                    )
                if evidence is not None and evidence.recommended:
                    font = item.font()
                    font.setBold(True)
                    item.setFont(font)
                self.setItem(row, column, item)
            first: Any = self.item(row, 0)
            first.setData(_NAME, name)
            first.setFlags(first.flags() | Qt.ItemFlag.ItemIsUserCheckable)
            on = name in self._present
            first.setCheckState(Qt.CheckState.Checked if on else Qt.CheckState.Unchecked)
        blocker.unblock()

    def _name(self, row: int) -> str:
        item: Any = self.item(row, 0)
        return str(item.data(_NAME))

    def _changed(self, item: QTableWidgetItem) -> None:
        if item.column() == 0:
            on = item.checkState() == Qt.CheckState.Checked
            name = self._name(item.row())
            if on != (name in self._present):
                self.ticked.emit(name, on)

    def _chosen(self) -> None:
        model: Any = self.selectionModel()
        rows = model.selectedRows()
        self.looked_at.emit(self._name(rows[0].row()) if rows else "")


def spoken(name: str) -> str:
    """The name of an effect in words."""
    return KINDS[name].title


def _texts(name: str, evidence: Evidence | None) -> tuple[str, str, str, str]:
    if evidence is None:
        return spoken(name), "", "", ""
    numbers = _two_digits(evidence.bias_nm), _two_digits(evidence.cost_ms)
    return spoken(name), f"{evidence.score:.1f}", *numbers


def _two_digits(value: float) -> str:
    if value < 0.05:
        return "0"
    return f"{value:.1f}" if value < 10 else f"{value:.0f}"


def _tip(name: str, evidence: Evidence | None) -> str:
    reason = f"<br><br>{evidence.reason}" if evidence else ""
    return as_tip(f"{sentence(KINDS[name].help)}{reason}")
