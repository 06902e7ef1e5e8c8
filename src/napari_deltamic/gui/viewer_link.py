"""The bridge between a fit and the viewer: the layers that show it, and what it listens to."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from napari.layers import Image, Surface
from numpy.typing import NDArray

from ..geometry import Mesh
from .colours import LIMITS, region_colormap, vertex_values
from .connections import Connections
from .contours import Contours
from .frame import OWN, Frame


class ViewerLink:
    """Shows a mesh and its images in a viewer until it is closed; then it leaves no connection.

    Parameters
    ----------
    viewer : a napari viewer or its model.
    image_layer : the image that is fitted.
    frame : of the image layer.
    on_lost : called with a sentence when a layer that the fit needs is removed.
    """

    def __init__(
        self, viewer: Any, image_layer: Any, frame: Frame, on_lost: Callable[[str], None]
    ) -> None:
        self.viewer, self.image_layer, self.frame = viewer, image_layer, frame
        self.mesh: Mesh | None = None
        self.surface: Surface | None = None
        self.rendered: Image | None = None
        self.residual: Image | None = None
        self.contours = Contours(frame, f"{image_layer.name} contours")
        self._on_lost: Callable[[str], None] | None = on_lost
        self._seen_in_3d = True
        self._connections = Connections()
        dims = viewer.dims.events
        for emitter in (dims.current_step, dims.order):
            self._connections.connect(emitter, self._slice_changed)
        self._connections.connect(dims.ndisplay, self._view_changed)
        self._connections.connect(viewer.layers.events.removed, self._layer_removed)

    def show_mesh(self, mesh: Mesh) -> None:
        """Show a mesh, um in the frame: the surface in 3D, its contours in 2D."""
        self.mesh = mesh
        vertices = mesh.vertices_numpy().astype(np.float32)
        if self.surface is None:
            self._add_surface(mesh, vertices)
        elif (
            len(self.surface.data[0]) == len(vertices)
            and self.surface.metadata[OWN]["regions"] is mesh.regions
        ):
            self.surface.data = (vertices, mesh.faces, self.surface.data[2])
        else:
            self.surface.data = (vertices, mesh.faces, vertex_values(mesh))
            self.surface.metadata[OWN]["regions"] = mesh.regions
        self._slice_changed()

    def show_rendered(self, rendered: NDArray[Any], measured: NDArray[Any] | None) -> None:
        """Show a rendered image and, with the measured one, the signed residual."""
        if self.rendered is None:
            self.rendered = self._add_image(
                rendered,
                "rendered",
                colormap="magenta",
                blending="additive",
                opacity=0.7,
                visible=False,
                contrast_limits=self.image_layer.contrast_limits,
            )
        elif self.rendered in self.viewer.layers:
            self.rendered.data = rendered
        if measured is not None:
            self._show_residual(measured - rendered)

    def show_layers(self, rendered: bool, residual: bool) -> None:
        """Whether the images that a fit adds are visible."""
        for layer, visible in ((self.rendered, rendered), (self.residual, residual)):
            if layer is not None:
                layer.visible = visible

    def close(self) -> None:
        """Undo every connection; the layers stay."""
        self._connections.undo()
        self._on_lost = None

    # ---------------------------------------------------------------------------------- layers

    def _add_surface(self, mesh: Mesh, vertices: NDArray[np.float32]) -> None:
        self.surface = Surface(
            (vertices, mesh.faces, vertex_values(mesh)),
            name=f"{self.image_layer.name} cells",
            colormap=region_colormap(),
            contrast_limits=LIMITS,
            shading="smooth",
            visible=self.viewer.dims.ndisplay == 3,
            metadata={OWN: {"regions": mesh.regions, "fit": True}},
            **self.frame.layer_options(),
        )
        # Last: the layer that is added last is selected, and its controls are shown.
        selected = set(self.viewer.layers.selection)
        self.viewer.add_layer(self.surface)
        self.viewer.add_layer(self.contours.layer)
        self.viewer.layers.selection = selected or {self.surface}

    def _add_image(self, data: NDArray[Any], what: str, **options: Any) -> Image:
        layer = Image(
            data,
            name=f"{self.image_layer.name} {what}",
            metadata={OWN: {"fit": True}},
            **self.frame.image_options(),
            **options,
        )
        selected = set(self.viewer.layers.selection)
        self.viewer.add_layer(layer)
        # Under the meshes, which it would hide.
        index = self.viewer.layers.index(self.image_layer)
        self.viewer.layers.move(len(self.viewer.layers) - 1, index + 1)
        self.viewer.layers.selection = selected
        return layer

    def _show_residual(self, residual: NDArray[Any]) -> None:
        if self.residual is None:
            finite = np.abs(residual[np.isfinite(residual)])
            limit = float(np.percentile(finite, 99.5)) if finite.size else 1.0
            self.residual = self._add_image(
                residual,
                "residual",
                colormap="PiYG",
                contrast_limits=(-limit or -1.0, limit or 1.0),
                visible=False,
            )
        elif self.residual in self.viewer.layers:
            self.residual.data = residual

    # -------------------------------------------------------------------------------- listening

    def _slice_changed(self, event: Any = None) -> None:
        if self.contours.layer in self.viewer.layers:
            self.contours.update(self.mesh, self.viewer.dims)

    def _view_changed(self, event: Any = None) -> None:
        # In 2D napari draws a few faces of a surface, which look like dirt on its contours.
        if self.surface is not None and self.surface in self.viewer.layers:
            in_3d = self.viewer.dims.ndisplay == 3
            if not in_3d:
                self._seen_in_3d = self.surface.visible
            self.surface.visible = in_3d and self._seen_in_3d
        self._slice_changed()

    def _layer_removed(self, event: Any) -> None:
        if self._on_lost is None:
            return
        if event.value is self.image_layer:
            self._on_lost("the image layer was removed")
        elif event.value is self.surface:
            self._on_lost("the layer of the meshes was removed")
