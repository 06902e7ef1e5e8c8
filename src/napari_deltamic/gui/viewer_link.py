"""The bridge between a fit and the viewer: the layers that show it, and what it listens to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from napari.layers import Image, Surface
from numpy.typing import NDArray

from ..geometry import Mesh
from .colours import LIMITS, region_colormap, vertex_values
from .connections import Connections
from .contours import Contours
from .frame import OWN, Frame
from .pins import Pins


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
        self.mesh: Mesh | None = None  # the newest; ``shown`` may be another
        self._held: Mesh | None = None
        self.chosen: frozenset[int] = frozenset()
        self.surface: Surface | None = None
        self.rendered: Image | None = None
        self.residual: Image | None = None
        self._pins = Pins(viewer, frame, f"{image_layer.name} pinned")
        self.contours = Contours(frame, f"{image_layer.name} contours")
        self._on_lost: Callable[[str], None] | None = on_lost
        self._seen_in_3d = True
        self._late = False  # whether the hidden surface is another than what is to be seen
        self._connections = Connections()
        dims = viewer.dims.events
        for emitter in (dims.current_step, dims.order):
            self._connections.connect(emitter, self._slice_changed)
        self._connections.connect(dims.ndisplay, self._view_changed)
        self._connections.connect(viewer.layers.events.removed, self._layer_removed)

    def show_mesh(self, mesh: Mesh, *, passing: bool = False) -> None:
        """Show a mesh, um in the frame: the surface in 3D, its contours in 2D.

        While another one is held, it is shown once that is let go. A surface that is hidden is not
        told of a mesh that is only passing, as that takes as long as if it were to be seen.
        """
        self.mesh = mesh
        if self._held is None:
            self._draw(mesh, passing=passing)

    @property
    def shown(self) -> Mesh | None:
        """The mesh that is to be seen."""
        return self.mesh if self._held is None else self._held

    def hold(self, mesh: Mesh) -> None:
        """Show a mesh until ``let_go``, whatever the fit does meanwhile."""
        self._held = mesh
        self._draw(mesh)

    def let_go(self) -> None:
        """Show the newest mesh again."""
        if self._held is not None:
            self._held = None
            if self.mesh is not None:
                self._draw(self.mesh)

    def show_pins(self, pinned: NDArray[np.bool_] | None) -> None:
        """Mark vertices as pinned: points that are only there where some are."""
        self._pins.choose(pinned)
        self._pins.show(self.shown)

    def highlight(self, regions: frozenset[int]) -> None:
        """Dim all cells but some; none of them: show all alike."""
        if regions == self.chosen:
            return
        self.chosen = self.contours.chosen = regions
        if self.shown is None:
            return
        if self.surface is not None and self.surface in self.viewer.layers:
            vertices, faces = self.surface.data[:2]
            # Kept with every further mesh that has the same faces.
            self.surface.data = (vertices, faces, vertex_values(self.shown, regions))
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

    def go_to(self, center: Sequence[float]) -> None:
        """Move slices and camera to a place, um in the frame."""
        if not np.isfinite(center).all():
            return
        world = [float(w) for w in self.frame.to_world(center)]
        n = self.viewer.dims.ndim
        self.viewer.dims.set_point(range(n - 3, n), world)
        scene = getattr(self.viewer, "scene", self.viewer)  # before napari 0.9, the viewer itself
        scene.camera.center = tuple(world)

    def close(self) -> None:
        """Undo every connection; the layers stay."""
        self._connections.undo()
        self._on_lost = None

    # ---------------------------------------------------------------------------------- layers

    def _draw(self, mesh: Mesh, *, passing: bool = False) -> None:
        vertices = mesh.vertices_numpy().astype(np.float32)
        if self.surface is None:
            self._add_surface(mesh, vertices)
        elif self.surface in self.viewer.layers:
            self._late = passing and not self.surface.visible
            if not self._late:
                self._set_surface(self.surface, mesh, vertices)
        self._pins.show(mesh)
        self._slice_changed()

    def _set_surface(self, layer: Surface, mesh: Mesh, vertices: NDArray[np.float32]) -> None:
        known = layer.metadata[OWN]
        values = layer.data[2]
        if len(layer.data[0]) != len(vertices) or known["regions"] is not mesh.regions:
            values = vertex_values(mesh, self.chosen)
            known["regions"] = mesh.regions
        layer.data = (vertices, mesh.faces, values)

    def _add_surface(self, mesh: Mesh, vertices: NDArray[np.float32]) -> None:
        self.surface = Surface(
            (vertices, mesh.faces, vertex_values(mesh, self.chosen)),
            name=f"{self.image_layer.name} cells",
            colormap=region_colormap(),
            contrast_limits=LIMITS,
            shading="smooth",
            visible=self.viewer.dims.ndisplay == 3,
            metadata={OWN: {"regions": mesh.regions, "fit": True}},
            **self.frame.layer_options(),
        )
        self._connections.connect(self.surface.events.visible, self._surface_shown)
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

    def _surface_shown(self, event: Any = None) -> None:
        if self._late and self.surface is not None and self.shown is not None:
            self._draw(self.shown)

    def _slice_changed(self, event: Any = None) -> None:
        if self.contours.layer in self.viewer.layers:
            self.contours.update(self.shown, self.viewer.dims)

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
