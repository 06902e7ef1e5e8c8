"""A mesh in a viewer: its contours on the slice that is shown, its surface in 3D."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from superqt.utils import qdebounced

from ...geometry import Mesh
from ...results.colouring import colour_indices
from .colours import LIMITS, ByValue, region_colormap, side_values, surface_look
from .contours import Contours
from .frame import MADE_BY_FIT, OWN, Frame, camera_of, go_to
from .listening import Connections
from .own_layers import Surface
from .walls import COPIES, Apart

_STILL = 60  # ms that a view has to rest before faces are sorted for it; chosen: two frames or more


class MeshLayers:
    """Two layers that show a mesh, and follow the slices until they are closed.

    The surface is there in 3D only: in 2D napari draws a few faces of one, which look like dirt on
    its contours.

    Parameters
    ----------
    image_layer : the image that the mesh is of.
    frame : of the image layer.

    Attributes
    ----------
    names : of the surface, and of the contours, behind that of the image.
    known : what the layers' metadata say of them.
    time : step of the time point that the mesh is of, of a 4D image; () where it has none.
    surface_options : further ones, of the surface.
    of_chosen : whether their image is the one chosen, and they lie on it: others are not seen.
    low : whether they lie just above the image, under what else is shown of it.
    """

    names = ("surfaces", "contours")
    known: ClassVar[Mapping[str, Any]] = MADE_BY_FIT
    surface_options: ClassVar[Mapping[str, Any]] = {}
    low = False

    def __init__(self, viewer: Any, image_layer: Any, frame: Frame) -> None:
        self.viewer, self.image_layer, self.frame = viewer, image_layer, frame
        self._name, contours = (f"{image_layer.name}: {name}" for name in self.names)
        self.mesh: Mesh | None = None  # the newest
        self.surface: Surface | None = None
        self.contours = Contours(frame, contours, image_layer)
        self.contours.layer.metadata[OWN] = dict(self.known)
        self._contours_added = False
        self.of_chosen = True
        # Layers that do not belong to what is shown, and whether they were seen before.
        self._put_away: dict[Any, bool] = {}
        self._late = False  # whether the hidden surface is another than what is to be seen
        self.take_time()
        self._colours_of: Mesh | None = None
        self._apart: Apart | None = None  # how the surface is drawn
        self._values: NDArray[np.float32] | None = None
        self.connections = Connections()
        dims = viewer.dims.events
        for emitter in (dims.point, dims.order, dims.ndisplay):
            self.connections.connect(emitter, self.slice_changed)
        self.connections.connect(camera_of(viewer).events.zoom, self._zoomed)
        self._sorting = qdebounced(self._sort_faces, timeout=_STILL)
        camera = camera_of(viewer).events
        for emitter in (camera.angles, camera.orientation, dims.order, dims.ndisplay):
            self.connections.connect(emitter, self._turned)
        self.connections.connect(self.contours.layer.events.visible, self.slice_changed)

    @property
    def shown(self) -> Mesh | None:
        """The mesh that is shown; None if there is none."""
        return self.mesh

    def take_time(self, time: tuple[int, ...] | None = None) -> None:
        """Set the time point of a 4D image to which the meshes belong; None: the one shown."""
        if time is None:
            time = self.viewer.dims.current_step[:-3]
        self.time = tuple(int(step) for step in time) if self.image_layer.ndim > 3 else ()

    @property
    def at_time(self) -> bool:
        """Whether the viewer shows the time point of the meshes."""
        return not self.time or tuple(self.viewer.dims.current_step[:-3]) == self.time

    @property
    def time_in_words(self) -> str:
        """The time point of the meshes, as the slider counts; '' for an image without times."""
        return f"time {self.time[-1]}" if self.time else ""

    def go_to(self, center: Sequence[float]) -> None:
        """Move slices and camera to a place, um in the frame, at the time of the meshes."""
        if not np.isfinite(center).all():
            return
        self.go_to_time()
        world = self.frame.to_world(center).tolist()
        go_to(self.viewer, world)
        camera_of(self.viewer).center = tuple(world)

    def go_to_time(self) -> None:
        """Move the time slider to the time of the meshes."""
        end = self.viewer.dims.ndim - 3
        self.viewer.dims.set_current_step(range(end - len(self.time), end), self.time)

    def with_time(self, title: str) -> str:
        """A title with the time point of the meshes."""
        return ", ".join(filter(None, (title, self.time_in_words)))

    def highlight(self, regions: frozenset[int]) -> None:
        """Dim all cells except these; with none, show all alike."""
        if regions != self.contours.chosen:
            self.contours.chosen = regions
            self._dress()
            self._colour_anew()

    def colour_by(self, values: Mapping[int, float] | None) -> None:
        """Colour cells by a number of each, by region; None: each has its own colour."""
        if values is None and self.contours.by is None:
            return
        before, self.contours.by = self.contours.by, None if values is None else ByValue(values)
        self._dress(anew=before is not None)
        self._colour_anew()

    def face_of(self, drawn: int) -> int | None:
        """The face of the mesh to which a face of the surface layer belongs; None without any."""
        order = self._apart.order if self._apart is not None else ()
        return int(order[drawn]) if drawn < len(order) else None

    def close(self) -> None:
        """Undo every connection; the layers stay."""
        self.connections.undo()
        with suppress(RuntimeError):  # at the end of a program, Qt has deleted it
            self._sorting.cancel()

    def remove(self, but: Collection[Any] = ()) -> None:
        """Close it, and remove its layers except some."""
        self.close()
        for layer in self.made():
            if self.has(layer) and layer not in but:
                self.viewer.layers.remove(layer)

    def made(self) -> list[Any]:
        """Its layers, from the top; None for one that is not made yet."""
        return [self.contours.layer, self.surface]

    @property
    def whole(self) -> bool:
        """Whether the layers of the mesh are all in the viewer, or not made yet."""
        return self.surface is None or (self.has(self.surface) and self.has(self.contours.layer))

    def has(self, layer: Any) -> bool:
        """Whether there is a layer, and it is in the viewer."""
        return layer is not None and layer in self.viewer.layers

    def slice_changed(self, event: Any = None) -> None:
        """Update after another slice or view is shown."""
        self.place()
        # napari slices no layer that is hidden, and then refuses colours for its new vectors.
        if self.has(self.contours.layer) and self.contours.layer.visible:
            self.contours.update(self.shown if self.at_time else None, self.viewer)

    def draw(self, mesh: Mesh, *, passing: bool = False) -> None:
        """Show a mesh. A hidden surface is not updated for a mesh that is only passing.

        That takes as long as if it were to be seen. Of one that is only passing, a layer is made
        that is seen; the other one comes with the next: for each, napari takes a while.
        """
        self._colour(mesh, passing=passing)
        layer = self.surface
        if layer is None or not self._contours_added:
            self._add_layers(mesh, at_once=not passing)
        if layer is not None and layer in self.viewer.layers:
            self._late = passing and not layer.visible
            if not self._late:
                self._set_surface(layer, mesh)
        self.slice_changed()

    def follow_image(self, chosen: bool) -> None:
        """Show layers only while their image is chosen, and they lie on it."""
        self.of_chosen = chosen
        self.place()

    def place(self) -> None:
        """Show layers only where they belong; there, what the user shows or hides stays so."""
        for layer in self.flat():
            self._show_where(layer, self.of_chosen)
        if self.surface is not None:
            self._show_where(self.surface, self._belongs())

    def flat(self) -> list[Any]:
        """The layers that show a mesh on slices."""
        return [self.contours.layer]

    def add(self, layer: Any, above: bool = False) -> None:
        """Add a layer, and leave the selection as it is; above: just above the image."""
        layers = self.viewer.layers
        selected, place = set(layers.selection), len(layers)
        if above and self.image_layer in layers:
            place = layers.index(self.image_layer) + 1
        elif layer is self.surface and self.contours.layer in layers:
            place = layers.index(self.contours.layer)
        layers.insert(place, layer)
        layers.selection = selected or {layer}

    def _colour(self, mesh: Mesh, *, passing: bool) -> None:
        """Choose colours anew, unless a passing mesh has the triangles that they are chosen for."""
        if passing and self._colours_of is not None and _same(self._colours_of, mesh):
            return
        self._colours_of, found = mesh, colour_indices(mesh)
        if found != self.contours.colours:
            self.contours.colours, self._values = found, None

    def _dress(self, *, anew: bool = False) -> None:
        """Give the surface the colormap for its values; anew : also that of regions."""
        by, layer = self.contours.by, self.surface
        if layer is None or not self.has(layer) or (by is None and not anew):
            return
        both = (region_colormap(), LIMITS) if by is None else by.look()
        layer.colormap, layer.contrast_limits = both

    def _colour_anew(self) -> None:
        layer = self.surface
        if self.shown is None:
            return
        if layer is not None and self.has(layer):
            self._apart, self._late = None, False
            # With its vertices: those of a layer that is late may be of other triangles.
            self._set_surface(layer, self.shown)
        self.slice_changed()

    def _drawn(self, mesh: Mesh) -> tuple[Any, Any, Any]:
        """Vertices, faces and values for the surface layer of a mesh."""
        apart = self._apart
        if apart is None or not _same(apart.mesh, mesh):
            apart, self._values = Apart.of(mesh), None
            self._apart = apart
        if self._values is None:
            by = self.contours.by
            if by is not None:
                self._values = by.surface_values(apart.sides, self.contours.chosen)
            else:
                sides, contours = apart.sides, self.contours
                self._values = side_values(sides, contours.chosen, contours.colours)
            apart = self._apart = apart.seen(self.contours.chosen, mesh, self._view_direction())
        return apart.vertices(mesh), apart.faces, self._values

    def _set_surface(self, layer: Surface, mesh: Mesh) -> None:
        drawn = self._drawn(mesh)
        if len(layer.features.columns) and len(layer.features) != len(drawn[0]):
            layer.features = None  # they are of other vertices
        layer.data = drawn
        self._note(layer, mesh)

    def _note(self, layer: Surface, mesh: Mesh) -> None:
        """Store in a layer what is needed to make a mesh of it again."""
        assert self._apart is not None
        regions = mesh.regions[self._apart.order]
        layer.metadata[OWN].update({"regions": regions, COPIES: self._apart.copies})

    def _add_layers(self, mesh: Mesh, *, at_once: bool) -> None:
        """Add the missing layers; unless ``at_once``, only the one that is seen first."""
        first = self._belongs() or self._contours_added
        surface = self.surface is None and (at_once or first)
        if surface:
            self._add_surface(mesh)
        if not self._contours_added and (at_once or not surface):
            self._contours_added = True
            self.add(self.contours.layer, above=self.low)

    def _add_surface(self, mesh: Mesh) -> None:
        look = {**surface_look(), **self.surface_options, **self.frame.layer_options()}
        surface = self._make_surface(self._drawn(mesh), **look)
        self._note(surface, mesh)
        self.connections.connect(surface.events.visible, self._catch_up)
        # Last: the layer that is added last is selected, and its controls are shown.
        self.add(surface, above=self.low)
        self._dress()

    def _make_surface(self, data: Any, **options: Any) -> Surface:
        seen, metadata = self._belongs(), {OWN: dict(self.known)}
        made = Surface(data, name=self._name, visible=seen, metadata=metadata, **options)
        if not seen:
            self._put_away[made] = True
        self.surface = made.lie_on(self.image_layer)
        return made

    def _catch_up(self, event: Any = None) -> None:
        """Update the surface with what it missed while it was hidden."""
        if self._late and self.surface is not None and self.shown is not None:
            self._late = False
            self._set_surface(self.surface, self.shown)

    def _zoomed(self, event: Any = None) -> None:
        if self.contours.off_width(self.viewer):
            self.slice_changed()

    def _turned(self, event: Any = None) -> None:
        if self.contours.chosen:
            self._sorting()

    def _sort_faces(self) -> None:
        """Draw the faces in the order that the view needs now."""
        layer, apart, mesh = self.surface, self._apart, self.shown
        if layer is None or not self.has(layer) or apart is None or mesh is None:
            return
        if not _same(apart.mesh, mesh):
            return
        self._apart = apart.seen(self.contours.chosen, mesh, self._view_direction())
        with layer.events.data.blocker():  # it is the same surface
            self._set_surface(layer, mesh)

    def _view_direction(self) -> NDArray[np.float64]:
        """(3,) along Z, Y, X: depth in the view for each um."""
        direction, dims = np.zeros(3), self.viewer.dims
        if dims.ndisplay == 3 and dims.ndim >= 3:
            seen = np.zeros(dims.ndim)
            seen[list(dims.displayed)] = camera_of(self.viewer).view_direction
            direction = seen[-3:] / np.asarray(self.frame.um)
        return direction

    def _belongs(self) -> bool:
        """Whether the surface belongs to what is shown."""
        return self.viewer.dims.ndisplay == 3 and self.at_time and self.of_chosen

    def _show_where(self, layer: Any, belongs: bool) -> None:
        if belongs and self._put_away.pop(layer, False) and not layer.visible:
            if layer is self.surface:
                self._catch_up()
            layer.visible = True
        elif not belongs and layer not in self._put_away:
            self._put_away[layer] = bool(layer.visible)
            layer.visible = False


def _same(a: Mesh, b: Mesh) -> bool:
    """Whether two meshes share the same arrays of triangles and regions."""
    return a.faces is b.faces and a.regions is b.regions
