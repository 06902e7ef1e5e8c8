"""The bridge between a fit and the viewer: the layers that show it, and what it listens to."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from napari.layers import Image
from numpy.typing import NDArray

from ...geometry import Mesh
from ...results.colouring import colour_indices
from ..connections import Connections
from ..editing.pins import Pins
from ..plain import camera_of
from .cell_features import features_at
from .colours import BY_VALUE, LIMITS, ByValue, region_colormap, side_values
from .contours import Contours
from .frame import OWN, Frame
from .own_layers import Surface
from .walls import COPIES, Apart

_RESIDUAL = 5.0  # standard deviations of the noise that have the strongest colours


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
        self._pins = Pins(viewer, frame, f"{image_layer.name} pinned", image_layer)
        self.contours = Contours(frame, f"{image_layer.name} contours", image_layer)
        self._on_lost: Callable[[str], None] | None = on_lost
        self._seen_in_3d = True
        self._placed = True  # whether the surface belongs to what is shown: 3D, at its time
        self._images_wanted = (False, False)  # rendered and residual
        self._images_placed = True  # whether they belong to the time that is shown
        self._late = False  # whether the hidden surface is another than what is to be seen
        self._time: tuple[int, ...] = ()  # of the image, that is fitted; () where it has none
        self.take_time()
        self._colours_of: Mesh | None = None
        self._apart: Apart | None = None  # how the surface is drawn
        self._apart_of: Mesh | None = None
        self._values: NDArray[np.float32] | None = None
        self._connections = Connections()
        dims = viewer.dims.events
        for emitter in (dims.current_step, dims.order, dims.ndisplay):
            self._connections.connect(emitter, self._slice_changed)
        self._connections.connect(camera_of(viewer).events.zoom, self._zoomed)
        self._connections.connect(viewer.layers.events.removed, self._layer_removed)

    @property
    def time(self) -> tuple[int, ...]:
        """Step of the time point that is fitted, of a 4D image; () where it has none."""
        return tuple(int(step) for step in self._time)

    def take_time(self) -> None:
        """From now on the meshes are those of the time point that is shown, of a 4D image."""
        steps = tuple(self.viewer.dims.current_step)
        self._time = steps[:-3] if self.image_layer.ndim > 3 else ()

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
            self._apart, self._late = None, False
            # With its vertices: those of a layer that is late may be of other triangles.
            self._set_surface(self.surface, self.shown)
        self._slice_changed()

    def colour_by(self, values: Mapping[int, float] | None) -> None:
        """Colour cells by a number of each, by region; None: each has its own colour."""
        if values is None and self.contours.by is None:
            return
        by = self.contours.by = None if values is None else ByValue(values)
        layer = self.surface
        if layer is not None and layer in self.viewer.layers and self.shown is not None:
            layer.colormap = region_colormap() if by is None else BY_VALUE
            layer.contrast_limits = LIMITS if by is None else by.limits
            self._apart, self._late = None, False
            self._set_surface(layer, self.shown)
        self._slice_changed()

    def show_rendered(self, rendered: NDArray[Any], residual: NDArray[Any] | None) -> None:
        """Show a rendered image and the residual, in standard deviations of the noise."""
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
        if residual is not None:
            self._show_residual(residual)

    def show_layers(self, rendered: bool, residual: bool) -> None:
        """Whether the images that a fit adds are visible."""
        self._images_wanted = (rendered, residual)
        self._place_images()

    def face_of(self, drawn: int) -> int | None:
        """The face of the mesh shown that one of the surface layer is; None where there is none."""
        order = self._apart.order if self._apart is not None else ()
        return int(order[drawn]) if drawn < len(order) else None

    def go_to(self, center: Sequence[float]) -> None:
        """Move slices and camera to a place, um in the frame."""
        if not np.isfinite(center).all():
            return
        world = [float(w) for w in self.frame.to_world(center)]
        n = self.viewer.dims.ndim
        self.viewer.dims.set_point(range(n - 3, n), world)
        camera_of(self.viewer).center = tuple(world)

    def close(self) -> None:
        """Undo every connection; the layers stay."""
        self._connections.undo()
        self._on_lost = None

    # ---------------------------------------------------------------------------------- layers

    @property
    def colours(self) -> Mapping[int, int]:
        """Places in the palette of the regions shown; see ``colour_indices``."""
        return self.contours.colours

    def _colour(self, mesh: Mesh, *, passing: bool) -> None:
        """Other colours where regions have other neighbours; boxes are only looked at anew now."""
        if passing and self._colours_of is not None and _same(self._colours_of, mesh):
            return
        self._colours_of, found = mesh, colour_indices(mesh)
        if found != self.contours.colours:
            self.contours.colours, self._values = found, None

    def _draw(self, mesh: Mesh, *, passing: bool = False) -> None:
        self._colour(mesh, passing=passing)
        if self.surface is None:
            self._add_surface(mesh)
        elif self.surface in self.viewer.layers:
            self._late = passing and not self.surface.visible
            if not self._late:
                self._set_surface(self.surface, mesh)
        self._pins.show(mesh)
        self._slice_changed()

    def _drawn(self, mesh: Mesh) -> tuple[Any, Any, Any]:
        """Vertices, faces and values of the layer."""
        apart, of = self._apart, self._apart_of
        if apart is None or of is None or not _same(of, mesh):
            apart = self._apart = Apart.of(mesh)
            self._apart_of, self._values = mesh, None
        if self._values is None:
            by = self.contours.by
            if by is not None:
                values = by.at(apart.sides.max(axis=1))
                self._values = np.nan_to_num(values, nan=by.limits[0])
            else:
                self._values = side_values(apart.sides, self.chosen, self.colours)
            apart = self._apart = apart.first(mesh, self.chosen)
        return apart.vertices(mesh), apart.faces, self._values

    def describe(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Put measurements of the cells shown into the features of the surface."""
        layer, apart = self.surface, self._apart
        if layer is not None and apart is not None and layer in self.viewer.layers:
            layer.features = features_at(rows, apart.sides.max(axis=1))

    def _set_surface(self, layer: Surface, mesh: Mesh) -> None:
        drawn = self._drawn(mesh)
        if len(layer.features.columns) and len(layer.features) != len(drawn[0]):
            layer.features = None  # they are of other vertices
        layer.data = drawn
        self._note(layer, mesh)

    def _note(self, layer: Surface, mesh: Mesh) -> None:
        """What is needed to make a mesh of the layer again."""
        assert self._apart is not None
        regions = mesh.regions[self._apart.order]
        layer.metadata[OWN].update({"regions": regions, COPIES: self._apart.copies})

    def _add_surface(self, mesh: Mesh) -> None:
        self.surface = Surface(
            self._drawn(mesh),
            name=f"{self.image_layer.name} cells",
            colormap=region_colormap(),
            contrast_limits=LIMITS,
            shading="smooth",
            visible=self._belongs(),
            metadata={OWN: {"fit": True}},
            **self.frame.layer_options(),
        ).lie_on(self.image_layer)
        self._placed = self._belongs()
        self._note(self.surface, mesh)
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
        if self.image_layer in self.viewer.layers:  # under the meshes, which it would hide
            index = self.viewer.layers.index(self.image_layer)
            self.viewer.layers.move(len(self.viewer.layers) - 1, index + 1)
        self.viewer.layers.selection = selected
        return layer

    def _show_residual(self, residual: NDArray[Any]) -> None:
        if self.residual is None:
            self.residual = self._add_image(
                residual,
                "residual",
                colormap="PiYG",
                contrast_limits=(-_RESIDUAL, _RESIDUAL),
                visible=False,
            )
        elif self.residual in self.viewer.layers:
            self.residual.data = residual

    # -------------------------------------------------------------------------------- listening

    def _surface_shown(self, event: Any = None) -> None:
        if self._late and self.surface is not None and self.shown is not None:
            self._draw(self.shown)

    def _slice_changed(self, event: Any = None) -> None:
        self._place_surface()
        if self.at_time != self._images_placed:
            self._place_images()
        if self.contours.layer in self.viewer.layers:
            self.contours.update(self.shown if self.at_time else None, self.viewer)

    def _zoomed(self, event: Any = None) -> None:
        if self.contours.off_width(self.viewer):
            self._slice_changed()

    @property
    def at_time(self) -> bool:
        """Whether the image shown is that of the meshes."""
        return not self._time or tuple(self.viewer.dims.current_step[:-3]) == self._time

    def _belongs(self) -> bool:
        # In 2D napari draws a few faces of a surface, which look like dirt on its contours.
        return self.viewer.dims.ndisplay == 3 and self.at_time

    def _place_surface(self) -> None:
        """Show the surface where it belongs, if the user has not hidden it there."""
        if self.surface is None or self.surface not in self.viewer.layers:
            return
        if self._belongs() == self._placed:
            return
        if self._placed:
            self._seen_in_3d = self.surface.visible
        self._placed = not self._placed
        self.surface.visible = self._placed and self._seen_in_3d

    def _place_images(self) -> None:
        """Show the images that are wanted at the time that they belong to, and nowhere else."""
        self._images_placed = self.at_time
        for layer, wanted in zip((self.rendered, self.residual), self._images_wanted, strict=True):
            if layer is not None:
                layer.visible = wanted and self._images_placed

    def _layer_removed(self, event: Any) -> None:
        if self._on_lost is None:
            return
        if event.value is self.image_layer:
            self._on_lost("the image layer was removed")
        elif event.value is self.surface:
            self._on_lost("the layer of the meshes was removed")


def _same(a: Mesh, b: Mesh) -> bool:
    """Whether two meshes have the same triangles between the same regions; the arrays tell."""
    return a.faces is b.faces and a.regions is b.regions
