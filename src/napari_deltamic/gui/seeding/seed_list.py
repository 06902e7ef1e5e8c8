"""The layers that can give seeds, each with a tick; and remarks on the seeds."""

from __future__ import annotations

from html import escape
from typing import Any

from napari.layers import Labels, Points, Surface
from qtpy.QtCore import QSize, Qt
from qtpy.QtWidgets import QAbstractItemView, QListWidget, QListWidgetItem, QSizePolicy, QWidget
from superqt.utils import signals_blocked

from ...runs.seed_checks import Remark
from ..cell_source import seed_kind
from ..layer_choice import LayerTicks
from ..viewing.frame import go_to
from ..widgets import Note

_ROWS = 5  # shown at once, at most
_REMARKS = 4  # the same
LINK = "#3d7fd9"  # readable on dark and on light
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


class Remarks(Note):
    """Sentences in the colour of warnings; 'show' after one selects its points."""

    def __init__(self, viewer: Any, parent: QWidget | None = None) -> None:
        super().__init__(parent, "fair")
        self._viewer = viewer
        self.remarks: list[Remark] = []
        self.setTextFormat(Qt.TextFormat.RichText)
        self.setToolTip("'show' selects the points and goes to their slice.")
        self.linkActivated.connect(self.show_points)

    def show_remarks(self, remarks: list[Remark], busy: str = "") -> None:
        """Show the first of these remarks, and below them what is under way, if anything."""
        self.remarks = list(remarks)
        lines = []
        for index, remark in enumerate(remarks[:_REMARKS]):
            link = f" <a style='color: {LINK}' href='{index}'>show</a>" if remark.points else ""
            lines.append(f"{escape(remark.text)}.{link}")
        if len(remarks) > _REMARKS:
            lines.append(f"... and {len(remarks) - _REMARKS} more")
        if busy:
            lines.append(escape(busy))
        self.say("<br>".join(lines), "fair" if remarks else "")

    def show_points(self, link: str) -> None:
        """Select the points that a remark is about, and go to the first."""
        if int(link) >= len(self.remarks):
            return
        rows: dict[Any, set[int]] = {}  # by layer
        for layer, row in self.remarks[int(link)].points:
            if layer in self._viewer.layers and row < len(layer.data):
                rows.setdefault(layer, set()).add(row)
        if not rows:
            return
        self._viewer.layers.selection = set(rows)
        for layer, chosen in rows.items():
            layer.mode = "select"
            layer.selected_data = chosen
        layer, chosen = next(iter(rows.items()))
        go_to(self._viewer, layer.data_to_world(layer.data[min(chosen)])[-3:])

    def forget(self) -> None:
        """Release the layers."""
        self.remarks = []
