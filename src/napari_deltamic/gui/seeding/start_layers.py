"""Starting surfaces in the viewer: contours on the slices, a translucent surface in 3D."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ...geometry import Mesh
from ..viewing.frame import Frame
from ..viewing.mesh_layers import MeshLayers

_LOOK = {"opacity": 0.5, "blending": "translucent_no_depth"}


class StartLayers:
    """Two layers of the plugin's own that show where a fit would start.

    Parameters
    ----------
    viewer : a napari viewer or its model.
    on_removed : called when a user removes one of the layers.
    """

    def __init__(self, viewer: Any, on_removed: Callable[[], None]) -> None:
        self._viewer, self._on_removed = viewer, on_removed
        self._layers: _Start | None = None

    @property
    def mesh(self) -> Mesh | None:
        """What is shown."""
        return None if self._layers is None else self._layers.shown

    def show(self, mesh: Mesh, image_layer: Any, frame: Frame) -> None:
        """Show surfaces, um in the frame of an image layer; nothing where that is gone."""
        old = self._layers
        if image_layer not in self._viewer.layers:
            self.clear()
            return
        if old is None or old.frame != frame or old.image_layer is not image_layer:
            self.clear()
            self._layers = old = _Start(self._viewer, image_layer, frame)
            old.connections.connect(self._viewer.layers.events.removed, self._removed)
        old.take_time()
        old.mesh = mesh
        old.draw(mesh)

    def clear(self) -> None:
        """Take the layers away."""
        old, self._layers = self._layers, None
        if old is not None:
            old.close()
            for layer in (old.contours.layer, old.surface):
                if layer is not None and layer in self._viewer.layers:
                    self._viewer.layers.remove(layer)

    def close(self) -> None:
        """Listen to the viewer no more; the layers stay, as the window may be gone."""
        old, self._layers = self._layers, None
        if old is not None:
            old.close()

    def _removed(self, event: Any) -> None:
        old = self._layers
        if old is not None and event.value in (old.surface, old.contours.layer, old.image_layer):
            by_user = event.value is not old.image_layer
            self.clear()
            if by_user:
                self._on_removed()


class _Start(MeshLayers):
    """The layers of one image."""

    def __init__(self, viewer: Any, image_layer: Any, frame: Frame) -> None:
        name = image_layer.name
        names = (f"{name}: start", f"{name}: start contours")
        known = {"fit": True, "preview": True}
        super().__init__(viewer, image_layer, frame, names, known, _LOOK)
        self.mesh: Mesh | None = None

    @property
    def shown(self) -> Mesh | None:
        """See ``MeshLayers``."""
        return self.mesh

    def add_layers(self, *layers: Any) -> None:
        """Just above the image: under what else is shown of it."""
        for layer in layers:
            self.add(layer, above=True)
