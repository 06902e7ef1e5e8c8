"""Which layer of a viewer is used for something."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from psygnal import Signal

from .viewing.connections import Connections
from .viewing.frame import made_by_fit


class LayerChoice:
    """The layers of a viewer that can be used for something, and the one that is.

    Parameters
    ----------
    viewer : a napari viewer or its model.
    accepts : whether a layer can be used.
    optional : whether there may be none; then none is chosen but by the user.
    """

    listed = Signal()  # other layers, or names
    changed = Signal()  # another layer is chosen

    def __init__(
        self, viewer: Any, accepts: Callable[[Any], bool], *, optional: bool = False
    ) -> None:
        self._viewer, self._accepts, self.optional = viewer, accepts, optional
        self.layers: list[Any] = []
        self.layer: Any = None
        self._connections = Connections()
        events = viewer.layers.events
        for emitter in (events.inserted, events.removed, events.reordered, events.renamed):
            # After the viewer itself, which shows a layer that is new.
            self._connections.connect(emitter, self.refresh, position="last")
        self.refresh()

    def choose(self, layer: Any) -> None:
        """Choose a layer that can be used, or None where there may be none."""
        if layer is not self.layer and (layer in self.layers or (self.optional and layer is None)):
            self.layer = layer
            self.listed.emit()
            self.changed.emit()

    def refresh(self, event: Any = None) -> None:
        """Look at the viewer's layers again; the choice stays where it can."""
        self.layers = [layer for layer in self._viewer.layers if self._accepts(layer)]
        before = self.layer
        if before not in self.layers:
            # The layers that a fit adds are only used where someone chooses them.
            others = [x for x in self.layers if not made_by_fit(x)]
            self.layer = others[-1] if others and not self.optional else None
        self.listed.emit()
        if self.layer is not before:
            self.changed.emit()

    def close_links(self) -> None:
        """Listen to the viewer no more, and let its layers go."""
        self._connections.undo()
        self.layers, self.layer = [], None
