"""Which layers of a viewer are used for something."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from psygnal import Signal

from .viewing.frame import made_by_fit
from .viewing.listening import Connections


class Layers:
    """The layers of a viewer that can be used for something.

    Parameters
    ----------
    accepts : whether a layer can be used.
    """

    listed = Signal()  # other layers, or names

    def __init__(self, viewer: Any, accepts: Callable[[Any], bool]) -> None:
        self._viewer, self._accepts = viewer, accepts
        self.layers: list[Any] = []
        self._connections = Connections()
        events = viewer.layers.events
        for emitter in (events.inserted, events.removed, events.reordered, events.renamed):
            # After the viewer itself, which shows a layer that is new.
            self._connections.connect(emitter, self.refresh, position="last")
        self.refresh()

    def refresh(self, event: Any = None) -> None:
        """Look at the viewer's layers again; what was chosen stays chosen if possible."""
        raise NotImplementedError

    def found(self) -> list[Any]:
        """The layers that can be used now, from lowest to highest."""
        return [layer for layer in self._viewer.layers if self._accepts(layer)]

    def close_links(self) -> None:
        """Stop listening to the viewer, and release its layers."""
        self._connections.undo()
        self.layers = []


class LayerChoice(Layers):
    """A choice of one of the layers, or none."""

    optional = False  # whether there may be none; then none is chosen but by the user

    def __init__(self, viewer: Any, accepts: Callable[[Any], bool]) -> None:
        self.layer: Any = None
        super().__init__(viewer, accepts)

    def choose(self, layer: Any) -> None:
        """Choose a layer that can be used, or None if there need not be one."""
        if layer is not self.layer and (layer in self.layers or (self.optional and layer is None)):
            self.layer = layer
            self.listed.emit()
            self._layer_changed()

    def refresh(self, event: Any = None) -> None:
        self.layers, before = self.found(), self.layer
        if before not in self.layers:
            # The layers that a fit adds are only used where someone chooses them.
            others = [x for x in self.layers if not made_by_fit(x)]
            self.layer = others[-1] if others and not self.optional else None
        self.listed.emit()
        if self.layer is not before:
            self._layer_changed()

    def _layer_changed(self) -> None:
        """Called when another layer is chosen."""
        raise NotImplementedError

    def close_links(self) -> None:
        super().close_links()
        self.layer = None


class LayerTicks(Layers):
    """A choice of any number of layers; new ones are ticked, except those that a fit made."""

    chosen = Signal()  # other ones are ticked

    def __init__(self, viewer: Any, accepts: Callable[[Any], bool]) -> None:
        self.ticked: list[Any] = []  # from the lowest to the highest
        super().__init__(viewer, accepts)

    def choose(self, layer: Any, ticked: bool = True) -> None:
        """Tick a layer that is listed, or untick it."""
        self._tick([x for x in self.layers if (ticked if x is layer else x in self.ticked)])

    def refresh(self, event: Any = None) -> None:
        known, self.layers = self.layers, self.found()
        before = self.ticked
        ticked = [x for x in self.layers if (x in before if x in known else not made_by_fit(x))]
        self.listed.emit()
        self._tick(ticked)

    def _tick(self, layers: list[Any]) -> None:
        if layers != self.ticked:
            self.ticked = layers
            self.chosen.emit()

    def close_links(self) -> None:
        super().close_links()
        self.ticked = []
