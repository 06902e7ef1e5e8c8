"""Marks on the vertices that the fit leaves where they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from .frame import OWN
from .mesh_layers import MeshLayers
from .own_layers import Points, cut_by_slices

PINS = "pins"  # key under OWN
_COLOUR = "white"


class Pins:
    """A layer of points on pinned vertices, made when the first is pinned."""

    def __init__(self, shown_in: MeshLayers, name: str) -> None:
        self._in, self._name = shown_in, name
        self._pinned: NDArray[np.bool_] = np.zeros(0, bool)
        self._removed = False  # by the user, who does not want to see them
        self.layer: Points | None = None

    def choose(self, pinned: NDArray[np.bool_] | None) -> None:
        """Which vertices are pinned, (V,); None for none."""
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
        a, b = mesh.vertices_numpy()[mesh.edges()[:200]].transpose(1, 0, 2)
        size = 0.6 * float(np.median(np.linalg.norm(a - b, axis=1)))
        self.layer = Points(
            places,
            ndim=3,
            name=self._name,
            size=max(size, max(self._in.frame.voxel_size)),
            face_color=_COLOUR,
            border_width=0,
            shading="spherical",
            **cut_by_slices(),  # a slice shows what lies near it
            metadata={OWN: {"fit": True, PINS: True}},
            **self._in.frame.layer_options(),
        ).lie_on(self._in.image_layer)
        self._in.add(self.layer)
