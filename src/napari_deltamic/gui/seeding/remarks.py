"""What may be wrong with seeds, told under them, with links to the points."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np
from qtpy.QtCore import Qt
from qtpy.QtWidgets import QWidget

from ...runs.seed_checks import Remark
from ..widgets import Note

_SHOWN = 4  # at most
# Readable on dark and on light.
_WARNING, LINK = "#d9822b", "#4a90e2"


class Remarks(Note):
    """Sentences in the colour of warnings; 'show' after one selects its points."""

    def __init__(self, viewer: Any, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._viewer = viewer
        self.remarks: list[Remark] = []
        self.setTextFormat(Qt.TextFormat.RichText)
        self.setToolTip("'show' selects the points and goes to their slice.")
        self.linkActivated.connect(self.show_points)

    def show_remarks(self, remarks: list[Remark], busy: str = "") -> None:
        """Show these, the first of many; or else what is under way."""
        self.remarks = list(remarks)
        lines = []
        for index, remark in enumerate(remarks[:_SHOWN]):
            link = f" <a style='color: {LINK}' href='{index}'>show</a>" if remark.points else ""
            lines.append(f"<span style='color: {_WARNING}'>{escape(remark.text)}.</span>{link}")
        if len(remarks) > _SHOWN:
            lines.append(f"... and {len(remarks) - _SHOWN} more")
        if busy:
            lines.append(escape(busy))
        self.say("<br>".join(lines))

    def show_points(self, link: str) -> None:
        """Select the points that a remark is about, and go to the first."""
        if int(link) >= len(self.remarks):
            return
        rows: dict[int, tuple[Any, set[int]]] = {}
        for layer, row in self.remarks[int(link)].points:
            if layer in self._viewer.layers and row < len(layer.data):
                rows.setdefault(id(layer), (layer, set()))[1].add(row)
        if not rows:
            return
        viewer = self._viewer
        viewer.layers.selection = {layer for layer, _ in rows.values()}
        for layer, chosen in rows.values():
            layer.mode = "select"
            layer.selected_data = chosen
        layer, chosen = next(iter(rows.values()))
        world = np.asarray(layer.data_to_world(layer.data[min(chosen)]))
        n = viewer.dims.ndim
        viewer.dims.set_point(range(n - 3, n), [float(w) for w in world[-3:]])

    def forget(self) -> None:
        """Let the layers go."""
        self.remarks = []
