"""The layers that show tracked cells: one surface over time, their paths, contours of the slice."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from napari.utils import Colormap
from numpy.typing import NDArray

from ...measure import measure_cells
from ...results.colouring import PALETTE, colour_indices, plain_index
from ...tracking import FrameResult, lineage, surface_4d
from ..viewing.colours import PALETTE_RGBA, region_colours
from ..viewing.connections import Connections
from ..viewing.contours import Contours
from ..viewing.frame import OWN, Frame, camera_of
from ..viewing.own_layers import Surface, Tracks

_COLOUR = "colour"  # the feature by which paths have the colours of their cells


class TrackLayers:
    """Shows frames in a viewer until it is closed; then it leaves no connection.

    Parameters
    ----------
    viewer : a napari viewer or its model.
    image_layer : the series (T, Z, Y, X).
    frame : of the image layer.
    on_time : called when another time, or slice, is shown.
    """

    def __init__(
        self, viewer: Any, image_layer: Any, frame: Frame, on_time: Callable[[], None]
    ) -> None:
        self.viewer, self.image_layer, self.frame = viewer, image_layer, frame
        self.results: dict[int, FrameResult] = {}
        self.surface: Surface | None = None
        self.tracks: Tracks | None = None
        self.contours = Contours(frame, f"{image_layer.name}: tracked contours", image_layer)
        self._coloured: Mapping[int, int] = {}  # colours that the surface has
        self._on_time: Callable[[], None] | None = on_time
        self._connections = Connections()
        dims = viewer.dims.events
        for emitter in (dims.point, dims.order, dims.ndisplay):
            self._connections.connect(emitter, self._moved)
        self._connections.connect(camera_of(viewer).events.zoom, self._zoomed)

    @property
    def shown(self) -> int:
        """The frame that the viewer shows."""
        steps = tuple(self.viewer.dims.current_step)
        return int(steps[-4]) if len(steps) > 3 else 0

    def show(self, results: Sequence[FrameResult]) -> None:
        """Show these frames; one that is new is moved to if the one before it was looked at."""
        news = [r.frame for r in results if r.frame not in self.results]
        self.results = {r.frame: r for r in results}
        meshes = [r for r in results if r.mesh is not None]
        if not meshes:
            return
        # A cell keeps its colour over time, so that neighbours at any time count.
        self.contours.colours = colour_indices(*(r.mesh for r in meshes if r.mesh is not None))
        self._show_surface(meshes)
        self._show_tracks(meshes)
        if len(news) == 1 and self.shown == news[0] - 1:
            self.viewer.dims.set_current_step(self.viewer.dims.ndim - 4, news[0])
        self._moved()

    def close(self) -> None:
        """Undo every connection; the layers stay."""
        self._connections.undo()
        self._on_time = None

    def _show_surface(self, results: Sequence[FrameResult]) -> None:
        vertices, faces, cells = surface_4d(results)
        last = int(cells.max())
        layer = self.surface
        if layer is None:
            layer = self.surface = Surface(
                (vertices.astype(np.float32), faces, cells.astype(np.float32)),
                name=f"{self.image_layer.name}: tracked surfaces",
                shading="smooth",
                visible=self.viewer.dims.ndisplay == 3,
                metadata={OWN: {"fit": True}},
                **self._options(),
            ).lie_on(self.image_layer)
            self._add(layer)
            self._add(self.contours.layer)
        elif layer in self.viewer.layers:
            layer.data = (vertices.astype(np.float32), faces, cells.astype(np.float32))
        if layer.contrast_limits[1] != last + 0.5 or self._coloured != self.contours.colours:
            self._coloured = self.contours.colours
            layer.colormap = _colours(region_colours(np.arange(1, last + 1), (), self._coloured))
            layer.contrast_limits = (0.5, last + 0.5)
        # The identity of each vertex, for whoever goes on with the layer.
        layer.metadata[OWN]["cells"] = cells

    def _show_tracks(self, results: Sequence[FrameResult]) -> None:
        """The paths of the cells' centres; a daughter's path begins at its mother's end."""
        rows = [
            (c["region"], r.frame, *(c[f"centroid_{axis}_um"] for axis in "zyx"))
            for r in results
            if r.mesh is not None
            for c in measure_cells(r.mesh)
        ]
        data = np.array([row for row in rows if np.isfinite(row).all()], float)
        if len(np.unique(data[:, 1])) < 2:
            return  # a point is no path
        graph = {c.cell: [c.parent] for c in lineage(results) if c.parent}
        present = set(data[:, 0].astype(int))
        graph = {c: p for c, p in graph.items() if {c, *p} <= present}
        data = data[np.lexsort((data[:, 1], data[:, 0]))]
        known = self.contours.colours
        places = [known.get(cell, plain_index(cell)) for cell in data[:, 0].astype(int).tolist()]
        colour = {_COLOUR: (np.array(places) + 0.5) / len(PALETTE)}
        if self.tracks is None:
            self.tracks = Tracks(
                data,
                graph=graph,
                features=colour,
                color_by=_COLOUR,
                colormaps_dict={_COLOUR: _colours(PALETTE_RGBA)},
                name=f"{self.image_layer.name}: tracks",
                tail_width=3,
                metadata={OWN: {"fit": True}},
                **self._options(),
            ).lie_on(self.image_layer)
            self._add(self.tracks)
        elif self.tracks in self.viewer.layers:
            with warnings.catch_warnings():
                # Between new data and their features there is nothing to colour by.
                warnings.simplefilter("ignore")
                self.tracks.data = data
            self.tracks.features = colour
            self.tracks.color_by = _COLOUR
            self.tracks.graph = graph

    def _options(self) -> dict[str, Any]:
        """Scale, translation and units of layers over time whose data are frames and um."""
        options = self.frame.layer_options()
        layer = self.image_layer
        return {
            "scale": (float(layer.scale[-4]), *options["scale"]),
            "translate": (float(layer.translate[-4]), *options["translate"]),
            "units": (str(layer.units[-4]), *options["units"]),
        }

    def _add(self, layer: Any) -> None:
        """Add a layer, and leave the selection as it is."""
        selected = set(self.viewer.layers.selection)
        self.viewer.add_layer(layer)
        self.viewer.layers.selection = selected or {layer}

    def _moved(self, event: Any = None) -> None:
        if event is not None and event.type == "ndisplay" and self.surface is not None:
            # In 2D napari draws a few faces of a surface, which look like dirt on its contours.
            self.surface.visible = self.viewer.dims.ndisplay == 3
        result = self.results.get(self.shown)
        if self.contours.layer in self.viewer.layers:
            mesh = None if result is None else result.mesh
            self.contours.update(mesh, self.viewer)
        if self._on_time is not None:
            self._on_time()

    def _zoomed(self, event: Any = None) -> None:
        result = self.results.get(self.shown)
        if result is not None and self.contours.off_width(self.viewer):
            self.contours.update(result.mesh, self.viewer)


def _colours(table: NDArray[np.float64]) -> Colormap:
    """Colours (n, 4) as a map, over limits of half a number around n whole ones."""
    controls = np.linspace(0, 1, len(table) + 1)
    return Colormap(table, name="deltamic cells", controls=controls, interpolation="zero")
