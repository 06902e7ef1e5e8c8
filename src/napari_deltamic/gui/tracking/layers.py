"""The layers that show tracked cells: one surface over time, their paths, contours of the slice."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...geometry import Mesh
from ...measure import measure_cells
from ...results.colouring import PALETTE, colour_indices, plain_index
from ...tracking import FrameResult, lineage, surface_4d
from ..viewing.colours import PALETTE_RGBA, in_steps, region_colours
from ..viewing.frame import MADE_BY_FIT, OWN, Frame
from ..viewing.mesh_layers import MeshLayers
from ..viewing.own_layers import Tracks

_COLOUR = "colour"  # the feature by which paths have the colours of their cells


class TrackLayers(MeshLayers):
    """Shows frames in a viewer until it is closed; the surface has all of them, over time.

    Parameters
    ----------
    image_layer : the series (T, Z, Y, X).
    frame : of the image layer.
    """

    names = ("tracked surfaces", "tracked contours")
    at_time = True  # whatever is shown

    def __init__(self, viewer: Any, image_layer: Any, frame: Frame) -> None:
        super().__init__(viewer, image_layer, frame)
        self.results: dict[int, FrameResult] = {}
        self.tracks: Tracks | None = None
        self._coloured: Mapping[int, int] = {}  # colours that the surface has

    @property
    def number(self) -> int:
        """Number of the frame that the viewer shows, from 0."""
        steps = tuple(self.viewer.dims.current_step)
        return int(steps[-4]) if len(steps) > 3 else 0

    @property
    def result(self) -> FrameResult | None:
        return self.results.get(self.number)

    @property
    def shown(self) -> Mesh | None:
        return None if self.result is None else self.result.mesh

    def show(self, results: Sequence[FrameResult]) -> None:
        """Show these frames; move on to a new one if the one before it was shown."""
        news = [r.frame for r in results if r.frame not in self.results]
        self.results = {r.frame: r for r in results}
        meshes = [r for r in results if r.mesh is not None]
        if not meshes:
            return
        # A cell keeps its colour over time, so that neighbours at any time count.
        self.contours.colours = colour_indices(*(r.mesh for r in meshes if r.mesh is not None))
        self._show_surface(meshes)
        self._show_tracks(meshes)
        if len(news) == 1 and self.number == news[0] - 1:
            self.go_to_frame(news[0])
        self.slice_changed()

    def go_to_frame(self, number: int, center: Sequence[float] | None = None) -> None:
        """Move the time slider to a frame, and if one is given, the view to a place in it, um."""
        self.take_time((number,))
        self.go_to_time()
        if center is not None:
            self.go_to(center)

    def made(self) -> list[Any]:
        return [self.tracks, *super().made()]

    def _show_surface(self, results: Sequence[FrameResult]) -> None:
        vertices, faces, cells = surface_4d(results)
        data = vertices.astype(np.float32), faces, cells.astype(np.float32)
        last = int(cells.max())
        layer = self.surface
        if layer is None:
            layer = self._make_surface(data, shading="smooth", **self._options())
            self.add(layer)
            self.add(self.contours.layer)
        elif layer in self.viewer.layers:
            layer.data = data
        if layer.contrast_limits[1] != last + 0.5 or self._coloured != self.contours.colours:
            self._coloured = self.contours.colours
            colours = region_colours(np.arange(1, last + 1), (), self._coloured)
            layer.colormap = in_steps(colours, "deltamic cells")
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
                colormaps_dict={_COLOUR: in_steps(PALETTE_RGBA, "deltamic cells")},
                name=f"{self.image_layer.name}: tracks",
                tail_width=3,
                metadata={OWN: dict(MADE_BY_FIT)},
                **self._options(),
            ).lie_on(self.image_layer)
            self.add(self.tracks)
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
