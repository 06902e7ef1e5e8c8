"""The layers that seeds may come from, each with a tick."""

from __future__ import annotations

from typing import Any

from napari.layers import Labels, Points, Surface
from qtpy.QtCore import QSize, Qt
from qtpy.QtWidgets import QAbstractItemView, QListWidget, QListWidgetItem, QSizePolicy, QWidget
from superqt.utils import signals_blocked

from ..layer_choice import LayerTicks
from .seed_kinds import seed_kind

_ROWS = 5  # shown at once, at most
_HELP = {
    Points: "A point inside each cell.",
    Labels: "Each label becomes a surface.",
    Surface: "The surface as it is.",
}


class SeedList(QListWidget):
    """Shows which layers can give seeds, and lets the user tick them."""

    def __init__(self, cells: LayerTicks, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._cells = cells
        self.setToolTip("Where the fit starts: tick one layer or several, of any kind.")
        self.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setTextElideMode(Qt.TextElideMode.ElideMiddle)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.itemChanged.connect(self._ticked)
        cells.listed.connect(self._show)
        cells.chosen.connect(self._show_ticks)
        self._show()

    def _show(self) -> None:
        with signals_blocked(self):
            self.clear()
            for layer in self._cells.layers:
                kind = seed_kind(layer)
                item = QListWidgetItem(f"{layer.name} ({kind.__name__.lower()})", self)
                item.setFlags(Qt.ItemFlag.ItemIsUserCheckable | Qt.ItemFlag.ItemIsEnabled)
                item.setToolTip(_HELP[kind])
                item.setSizeHint(QSize(0, self._row_height()))
        self._show_ticks()
        self._fit_height()

    def _show_ticks(self) -> None:
        with signals_blocked(self):
            for row, layer in enumerate(self._cells.layers):
                item: Any = self.item(row)
                on = layer in self._cells.ticked
                item.setCheckState(Qt.CheckState.Checked if on else Qt.CheckState.Unchecked)

    def _ticked(self, item: QListWidgetItem) -> None:
        layer = self._cells.layers[self.row(item)]
        self._cells.choose(layer, item.checkState() == Qt.CheckState.Checked)

    def _row_height(self) -> int:
        return int(self.fontMetrics().height()) + 6

    def _fit_height(self) -> None:
        rows = min(max(self.count(), 1), _ROWS)
        self.setFixedHeight(rows * self._row_height() + 2 * self.frameWidth() + 4)
        self.setVisible(self.count() > 0)
