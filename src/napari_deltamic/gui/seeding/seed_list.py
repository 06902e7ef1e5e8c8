"""The layers that seeds may come from, each with a tick."""

from __future__ import annotations

from typing import Any

from napari.layers import Labels, Points, Surface
from qtpy.QtCore import QSignalBlocker, QSize, Qt
from qtpy.QtWidgets import QAbstractItemView, QListWidget, QListWidgetItem, QSizePolicy, QWidget

from ..qt import Signal
from ..viewing.connections import Connections
from ..viewing.frame import OWN, made_by_fit
from ..viewing.pins import PINS
from .seed_kinds import SEED_LAYERS

_ROWS = 5  # shown at once, at most
_HELP = {
    Points: "A point inside each cell.",
    Labels: "Each label becomes a surface.",
    Surface: "The surface as it is.",
}
PREVIEW = "preview"  # key under OWN: layers that only show what seeds would give


class SeedList(QListWidget):
    """A viewer's Points, Labels and Surface layers; ``chosen`` says that other ones are ticked.

    New layers are ticked, except those that a fit made.
    """

    chosen = Signal()

    def __init__(self, viewer: Any, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._viewer = viewer
        self._layers: list[Any] = []  # by row
        self._ticked: list[Any] = []
        self.setToolTip("Where the fit starts: tick one layer or several, of any kind.")
        self.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setTextElideMode(Qt.TextElideMode.ElideMiddle)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.connections = Connections()
        events = viewer.layers.events
        for emitter in (events.inserted, events.removed, events.reordered, events.renamed):
            self.connections.connect(emitter, self.refresh)
        self.itemChanged.connect(self._told)
        self.refresh()

    def ticked(self) -> list[Any]:
        """The layers ticked, from the lowest to the highest in the viewer."""
        return list(self._ticked)

    def choose(self, layer: Any, ticked: bool = True) -> None:
        """Tick a layer that is listed, or untick it."""
        if layer in self._layers:
            item = self.item(self._layers.index(layer))
            if item is not None:
                item.setCheckState(_state(ticked))

    def refresh(self, event: Any = None) -> None:
        """Look at the viewer's layers again; the ticks stay."""
        known, before = self._layers, self._ticked
        self._layers = [layer for layer in self._viewer.layers if is_seeds(layer)]
        blocker = QSignalBlocker(self)
        self.clear()
        for layer in self._layers:
            kind = seed_kind(layer)
            item = QListWidgetItem(f"{layer.name} ({kind.__name__.lower()})", self)
            item.setFlags(Qt.ItemFlag.ItemIsUserCheckable | Qt.ItemFlag.ItemIsEnabled)
            item.setToolTip(_HELP[kind])
            item.setSizeHint(QSize(0, self._row_height()))
            on = layer in before if layer in known else not made_by_fit(layer)
            item.setCheckState(_state(on))
        blocker.unblock()
        self._fit_height()
        self._told()

    def close_links(self) -> None:
        """Listen to the viewer no more, and let its layers go."""
        self.connections.undo()
        self._layers, self._ticked = [], []

    def _told(self, item: Any = None) -> None:
        before, self._ticked = self._ticked, []
        for row, layer in enumerate(self._layers):
            one = self.item(row)
            if one is not None and one.checkState() == Qt.CheckState.Checked:
                self._ticked.append(layer)
        if self._ticked != before:
            self.chosen.emit()

    def _row_height(self) -> int:
        return int(self.fontMetrics().height()) + 6

    def _fit_height(self) -> None:
        rows = min(max(self.count(), 1), _ROWS)
        self.setFixedHeight(rows * self._row_height() + 2 * self.frameWidth() + 4)
        self.setVisible(self.count() > 0)


def is_seeds(layer: Any) -> bool:
    """Whether a layer can give seeds."""
    kept = isinstance(layer, SEED_LAYERS) and layer.ndim >= 3
    own = layer.metadata.get(OWN, {})
    tracked = bool(own) and isinstance(layer, Surface) and layer.ndim > 3
    return kept and not (own.get(PREVIEW) or own.get(PINS) or tracked)


def seed_kind(layer: Any) -> type:
    """Which of the kinds of layers that give seeds it is; subclasses count as theirs."""
    return next(kind for kind in SEED_LAYERS if isinstance(layer, kind))


def _state(ticked: bool) -> Qt.CheckState:
    return Qt.CheckState.Checked if ticked else Qt.CheckState.Unchecked
