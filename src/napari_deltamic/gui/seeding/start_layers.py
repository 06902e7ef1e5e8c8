"""Starting surfaces in the viewer: contours on the slices, a translucent surface in 3D."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ...geometry import Mesh
from ...results.colouring import colour_indices
from ..connections import Connections
from ..plain import camera_of
from ..viewing.colours import LIMITS, region_colormap, side_values
from ..viewing.contours import Contours
from ..viewing.frame import OWN, Frame
from ..viewing.own_layers import Surface
from ..viewing.walls import Apart

_OWN = {OWN: {"fit": True, "preview": True}}


class StartLayers:
    """Two layers of the plugin's own that show where a fit would start.

    Parameters
    ----------
    viewer : a napari viewer or its model.
    on_removed : called when a user removes one of the layers.
    """

    def __init__(self, viewer: Any, on_removed: Callable[[], None]) -> None:
        self._viewer = viewer
        self._on_removed = on_removed
        self._mesh: Mesh | None = None
        self._image_layer: Any = None
        self._contours: Contours | None = None
        self._surface: Surface | None = None
        self._drawn: Mesh | None = None  # what the surface holds: it is only filled in 3D
        self._connections = Connections()

    @property
    def mesh(self) -> Mesh | None:
        """What is shown."""
        return self._mesh

    def show(self, mesh: Mesh, image_layer: Any, frame: Frame) -> None:
        """Show surfaces, um in the frame of an image layer; nothing where that is gone."""
        if image_layer not in self._viewer.layers:
            self.clear()
            return
        if self._contours is None or self._contours.frame != frame:
            self.clear()
            self._contours = Contours(frame, f"{image_layer.name} start contours", image_layer)
            self._contours.layer.metadata.update(_OWN)
            self._image_layer = image_layer
            self._listen()
            self._add(self._contours.layer)
        self._mesh, self._contours.colours = mesh, colour_indices(mesh)
        self._update_view()

    def clear(self) -> None:
        """Take the layers away."""
        self._connections.undo()
        layers = [self._contours.layer] if self._contours is not None else []
        layers += [self._surface] if self._surface is not None else []
        self._forget()
        for layer in layers:
            if layer in self._viewer.layers:
                self._viewer.layers.remove(layer)

    def close(self) -> None:
        """Listen to the viewer no more; the layers stay, as the window may be gone."""
        self._connections.undo()
        self._forget()

    def _forget(self) -> None:
        self._mesh = self._drawn = self._contours = self._surface = self._image_layer = None

    def _listen(self) -> None:
        dims = self._viewer.dims.events
        for emitter in (dims.current_step, dims.order, dims.ndisplay):
            self._connections.connect(emitter, self._update_view)
        self._connections.connect(camera_of(self._viewer).events.zoom, self._zoomed)
        self._connections.connect(self._viewer.layers.events.removed, self._removed)

    def _update_view(self, event: Any = None) -> None:
        if self._contours is None:
            return
        self._contours.update(self._mesh, self._viewer)
        in_3d = self._viewer.dims.ndisplay == 3
        if in_3d:
            self._show_surface(self._contours.frame)
        if self._surface is not None:
            # In 2D napari draws a few faces of a surface, which look like dirt on its contours.
            self._surface.visible = in_3d

    def _zoomed(self, event: Any = None) -> None:
        if self._contours is not None and self._contours.off_width(self._viewer):
            self._update_view()

    def _show_surface(self, frame: Frame) -> None:
        mesh = self._mesh
        if mesh is None:
            return
        if self._surface is None:
            self._surface = Surface(
                _data(mesh),
                name=f"{self._image_layer.name} start",
                colormap=region_colormap(),
                contrast_limits=LIMITS,
                shading="smooth",
                opacity=0.5,
                blending="translucent_no_depth",
                metadata=_OWN,
                **frame.layer_options(),
            ).lie_on(self._image_layer)
            self._add(self._surface)
        elif self._drawn is not mesh:
            self._surface.data = _data(mesh)
        self._drawn = mesh

    def _add(self, layer: Any) -> None:
        """Add a layer just above the image; what is selected stays so."""
        viewer = self._viewer
        selected = set(viewer.layers.selection)
        viewer.add_layer(layer)
        index = viewer.layers.index(self._image_layer)
        viewer.layers.move(len(viewer.layers) - 1, index + 1)
        viewer.layers.selection = selected

    def _removed(self, event: Any) -> None:
        layers = [self._surface, self._contours.layer if self._contours is not None else None]
        if event.value is self._image_layer or event.value in layers:
            by_user = event.value is not self._image_layer
            self.clear()
            if by_user:
                self._on_removed()


def _data(mesh: Mesh) -> tuple[Any, Any, Any]:
    apart = Apart.of(mesh)
    values = side_values(apart.sides, (), colour_indices(mesh))
    return apart.vertices(mesh), apart.faces, values
