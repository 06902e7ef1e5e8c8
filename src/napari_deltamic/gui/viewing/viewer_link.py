"""The bridge between a fit and the viewer: the layers that show it, and what it listens to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from napari.layers import Image
from numpy.typing import NDArray

from ...geometry import Mesh
from ...results.features import features_at
from .frame import MADE_BY_FIT, OWN, Frame, camera_of
from .mesh_layers import MeshLayers
from .own_layers import Points, cut_by_slices

_LEAST = 5.0  # standard deviations of the noise that have the strongest colours, at least
_SHARE = 95  # per cent of the voxels whose residuals have colours of their own
_LOOKED_AT = 1_000_000  # voxels
PINS = "pins"  # key under OWN
_OF_PINS = "white"
_GAP = 1.05  # of the width of the image: where the one beside it begins


class ViewerLink(MeshLayers):
    """Shows a mesh and its images in a viewer until it is closed; then it leaves no connection.

    Parameters
    ----------
    image_layer : the image that is fitted.
    frame : of what is fitted of it.
    """

    def __init__(self, viewer: Any, image_layer: Any, frame: Frame) -> None:
        super().__init__(viewer, image_layer, frame)
        self._held: Mesh | None = None  # shown instead of the newest
        self.rendered: Image | None = None
        self.residual: Image | None = None
        self._images: tuple[NDArray[Any], NDArray[Any]] | None = None
        self._limits = (0.0, 0.0)  # of the residual, as long as the user chooses no others
        self._view = "image"
        self._before: Any = None  # order of the axes, centre and zoom, before two images were seen
        self._pins = Pins(self, f"{image_layer.name}: pinned")

    @property
    def shown(self) -> Mesh | None:
        return self.mesh if self._held is None else self._held

    def show_mesh(self, mesh: Mesh, *, passing: bool = False) -> None:
        """Show a mesh, um in the frame: the surface in 3D, its contours in 2D.

        While another one is held, it is shown once that is let go.
        """
        self.mesh = mesh
        if self._held is None:
            self.draw(mesh, passing=passing)

    def draw(self, mesh: Mesh, *, passing: bool = False) -> None:
        super().draw(mesh, passing=passing)
        self._pins.show(mesh)

    def hold(self, mesh: Mesh) -> None:
        """Show a mesh until ``let_go``, whatever the fit does meanwhile."""
        self._held = mesh
        self.draw(mesh, passing=True)  # it gives way to the newest

    def let_go(self) -> None:
        if self._held is not None:
            self._held = None
            if self.mesh is not None:
                self.draw(self.mesh)

    def show_pins(self, pinned: NDArray[np.bool_] | None) -> None:
        """Mark the pinned vertices by points; without any, there is no layer of points."""
        self._pins.choose(pinned)
        self._pins.show(self.shown)

    def describe(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Put measurements of the cells shown into the features of the surface."""
        layer, apart = self.surface, self._apart
        if layer is not None and apart is not None and self.has(layer):
            layer.features = features_at(rows, apart.sides.max(axis=1))

    def take_images(self, rendered: NDArray[Any], residual: NDArray[Any]) -> None:
        """Take the rendered image, and the residual in standard deviations of the noise.

        The layers are made when they are first looked at.
        """
        self._images = (rendered, residual)
        if self.rendered is not None and self.has(self.rendered):
            self.rendered.data = rendered
        shown = self.residual
        if shown is not None and self.has(shown):
            shown.data = residual
            if tuple(shown.contrast_limits) == self._limits:  # not those that the user chose
                shown.contrast_limits = self._limits = limits_of(residual)
        self._place_images()

    def look(self, view: str) -> None:
        """Show the image alone, the rendered one in its place or beside it, or the residual."""
        if view != self._view:
            self._view = view
            # One that the user has removed is made anew when it is asked for again.
            self.rendered, self.residual = (
                layer if self.has(layer) else None for layer in (self.rendered, self.residual)
            )
            self._place_images()

    def flat(self) -> list[Any]:
        pins = self._pins.layer
        return [*super().flat(), *([] if pins is None else [pins])]

    def made(self) -> list[Any]:
        return [*super().made(), self.rendered, self.residual, self._pins.layer]

    def slice_changed(self, event: Any = None) -> None:
        super().slice_changed(event)
        self._place_images()

    def _place_images(self) -> None:
        """Show the image chosen by the view, but only at the time that it belongs to."""
        here, images, source = self.at_time, self._images, self.image_layer
        beside = self._view == "side by side"
        rendered = here and (beside or self._view == "rendered")
        residual = here and self._view == "residual"
        if rendered and self.rendered is None and images is not None:
            look = source.colormap, source.contrast_limits
            self.rendered = self._image(images[0], "rendered", *look)
            self.add(self.rendered, above=True)  # under the meshes, which it would hide
        if residual and self.residual is None and images is not None:
            self._limits = limits_of(images[1])
            self.residual = self._image(images[1], "residual", "PiYG", self._limits)
            self.add(self.residual, above=True)
            self.residual.colorbar.visible = True
        for layer, wanted in ((self.rendered, rendered), (self.residual, residual)):
            if layer is not None and bool(layer.visible) != wanted:
                layer.visible = wanted
        if self.rendered is not None:
            self._put_beside(self.rendered, beside)

    def _put_beside(self, layer: Image, beside: bool) -> None:
        """Place a layer over the image, or to the right of it in the present slices."""
        shift = np.array(self.frame.translate)
        if beside:
            displayed = self.viewer.dims.displayed[-1] - self.viewer.dims.ndim
            if displayed >= -3:
                shift[displayed] += _GAP * layer.data.shape[displayed] * layer.scale[displayed]
        if not np.allclose(layer.translate, shift):
            layer.translate = shift
            self._see_both(beside)

    def _see_both(self, beside: bool) -> None:
        """See two images side by side; after that, what was seen before."""
        camera, order = camera_of(self.viewer), tuple(self.viewer.dims.order)
        if beside:
            self._before = self._before or (order, camera.center, camera.zoom)
            self.viewer.reset_view()
        elif self._before is not None:
            (then, center, zoom), self._before = self._before, None
            if then == order:
                camera.center, camera.zoom = center, zoom

    def _image(self, data: NDArray[Any], what: str, colormap: Any, limits: Any) -> Image:
        """An image layer, not added yet: adding may change slices, and it must be known by then."""
        return Image(
            data,
            name=f"{self.image_layer.name}: {what}",
            metadata={OWN: dict(MADE_BY_FIT)},
            visible=False,
            colormap=colormap,
            contrast_limits=limits,
            **self.frame.image_options(),
        )


def limits_of(residual: NDArray[Any]) -> tuple[float, float]:
    """Contrast limits for a residual: noise is pale, and little is saturated."""
    some = residual.reshape(-1)[:: 1 + residual.size // _LOOKED_AT]
    some = np.abs(some[np.isfinite(some)])
    most = max(_LEAST, float(np.percentile(some, _SHARE)) if len(some) else 0.0)
    most = float(f"{most:.2g}")
    return -most, most


class Pins:
    """A layer of points on pinned vertices, made when the first is pinned."""

    def __init__(self, shown_in: MeshLayers, name: str) -> None:
        self._in, self._name = shown_in, name
        self._pinned: NDArray[np.bool_] = np.zeros(0, bool)
        self._removed = False  # by the user, who does not want to see them
        self.layer: Points | None = None

    def choose(self, pinned: NDArray[np.bool_] | None) -> None:
        """Take which vertices are pinned, (V,) bool; None for none."""
        self._pinned = self._pinned[:0] if pinned is None else np.asarray(pinned, bool)
        self._removed = False

    def show(self, mesh: Mesh | None) -> None:
        """Put the marks on the vertices of a mesh."""
        if self.layer is not None and self.layer not in self._in.viewer.layers:
            self.layer, self._removed = None, True
        if mesh is None or self._removed:
            return
        # Of another triangulation, an earlier moment for example, it is not known which are pinned.
        known = len(self._pinned) == len(mesh.vertices)
        places = mesh.vertices_numpy()[self._pinned] if known else np.zeros((0, 3))
        if self.layer is not None:
            if not np.array_equal(self.layer.data, places):
                self.layer.data = places
        elif len(places):
            self._add(places, mesh)

    def _add(self, places: NDArray[np.float64], mesh: Mesh) -> None:
        size = 0.6 * float(np.median(mesh.edge_lengths()[:200]))
        self.layer = Points(
            places,
            ndim=3,
            name=self._name,
            size=max(size, max(self._in.frame.voxel_size)),
            face_color=_OF_PINS,
            border_width=0,
            shading="spherical",
            **cut_by_slices(),  # a slice shows what lies near it
            metadata={OWN: {"fit": True, PINS: True}},
            **self._in.frame.layer_options(),
        ).lie_on(self._in.image_layer)
        self._in.add(self.layer)
        self._in.place()
