"""Starting surfaces in the viewer: contours on the slices, a translucent surface in 3D."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ...geometry import Mesh
from ..viewing.frame import Frame
from ..viewing.mesh_layers import MeshLayers

_LOOK = {"opacity": 0.5, "blending": "translucent_no_depth"}


class StartLayers(MeshLayers):
    """Two layers of the plugin's own that show where a fit of an image would start.

    Parameters
    ----------
    viewer : a napari viewer or its model.
    image_layer, frame : the image, and its frame.
    on_removed : called when one of the layers, or the image, is removed: whether by a user.
    """

    def __init__(
        self, viewer: Any, image_layer: Any, frame: Frame, on_removed: Callable[[bool], None]
    ) -> None:
        name = image_layer.name
        names = (f"{name}: start", f"{name}: start contours")
        known = {"fit": True, "preview": True}
        super().__init__(viewer, image_layer, frame, names, known, _LOOK)
        self.mesh: Mesh | None = None
        self._on_removed = on_removed
        self.connections.connect(viewer.layers.events.removed, self._removed)

    @property
    def shown(self) -> Mesh | None:
        """See ``MeshLayers``."""
        return self.mesh

    def show(self, mesh: Mesh) -> None:
        """Show surfaces, um in the frame."""
        self.take_time()
        self.mesh = mesh
        self.draw(mesh)

    def add_layers(self, *layers: Any) -> None:
        """Just above the image: under what else is shown of it."""
        for layer in layers:
            self.add(layer, above=True)

    def remove(self) -> None:
        """Take the layers away."""
        self.close()
        for layer in (self.contours.layer, self.surface):
            if layer is not None and layer in self.viewer.layers:
                self.viewer.layers.remove(layer)

    def _removed(self, event: Any) -> None:
        if event.value in (self.surface, self.contours.layer, self.image_layer):
            self._on_removed(event.value is not self.image_layer)
