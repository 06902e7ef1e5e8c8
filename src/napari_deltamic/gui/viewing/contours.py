"""The contours of a mesh on the slice that the viewer shows, as a Vectors layer."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ...geometry.mesh import OUTSIDE
from ...measure import section
from .colours import ByValue, region_colours
from .frame import MADE_BY_FIT, OWN, Frame, camera_of
from .own_layers import Vectors

_PIXELS = 2.0  # of the canvas that a line is wide, until the user chooses another width
_OFF = 1.1  # a width is set anew where it is off by this factor: that takes as long as drawing


class Contours:
    """A layer with the section of a mesh by the present slice; empty in 3D.

    napari itself draws only the faces that lie wholly in a slice: for a fine mesh, none.
    """

    def __init__(self, frame: Frame, name: str, image_layer: Any = None) -> None:
        self.frame = frame
        self.layer = Vectors(
            np.zeros((0, 2, 3), np.float32),
            ndim=3,
            name=name,
            vector_style="line",
            opacity=1.0,
            blending="translucent_no_depth",
            metadata={OWN: dict(MADE_BY_FIT)},
            **frame.layer_options(),
        )
        if image_layer is not None:
            self.layer.lie_on(image_layer)
        # The thumbnail would take most of the time of an update. A private name: where napari has
        # no such method, nothing happens.
        self.layer._update_thumbnail = lambda: None
        self.colours: Mapping[int, int] = {}  # see ``colour_indices``
        self.chosen: frozenset[int] = frozenset()  # cells that are not dimmed; none: no cell is
        self.by: ByValue | None = None  # instead of a colour for each
        self._pixels = _PIXELS
        self._um_of_pixel = 1.0  # where the width was last looked at
        self.layer.events.edge_width.connect(self._width_chosen)

    def update(self, mesh: Mesh | None, viewer: Any) -> None:
        """Show the section by the slice that a viewer, or its model, shows."""
        dims = viewer.dims
        axis = sliced_axis(dims)
        if mesh is None or axis is None:
            if len(self.layer.data):
                self.layer.data = np.zeros((0, 2, 3), np.float32)
            return
        width = self._width(viewer)
        if _is_off(width, self.layer):
            with self.layer.events.edge_width.blocker(self._width_chosen):
                self.layer.edge_width = width
        position = self.position(dims, axis)
        segments, faces = section(mesh, axis, position)
        vectors = np.zeros((len(segments), 2, 3), np.float32)
        others = [k for k in range(3) if k != axis]
        # Where the viewer is, or else napari, which shows what lies within half a um of that, would
        # drop them: its slider stands between voxels once surfaces reach beyond the image.
        vectors[:, 0, axis] = self._point(dims, axis)
        vectors[:, 0, others] = segments[:, 0]
        vectors[:, 1, others] = segments[:, 1] - segments[:, 0]
        self._set(*self._two_coloured(vectors, mesh, faces, others))

    def off_width(self, viewer: Any) -> bool:
        """Whether lines are shown whose width on the screen is no longer right."""
        return len(self.layer.data) > 0 and _is_off(self._width(viewer), self.layer)

    def _width(self, viewer: Any) -> float:
        """Width that lines need in a viewer, um."""
        self._um_of_pixel = float(np.mean(self.frame.um)) / float(camera_of(viewer).zoom)
        return self._pixels * self._um_of_pixel

    def _width_chosen(self, event: Any = None) -> None:
        """Keep a width that the user has chosen."""
        self._pixels = float(self.layer.edge_width) / self._um_of_pixel

    def position(self, dims: Any, axis: int) -> float:
        """Position of the slice across an axis that the viewer's dims show, um."""
        # The slice that napari shows of the image is that of the nearest voxel.
        size = self.frame.voxel_size[axis]
        return float(round(self._point(dims, axis) / size) * size)

    def _point(self, dims: Any, axis: int) -> float:
        """Position of the viewer along an axis, um."""
        return float((dims.point[axis - 3] - self.frame.translate[axis]) * self.frame.um[axis])

    def _two_coloured(
        self, vectors: NDArray[np.float32], mesh: Mesh, faces: NDArray[Any], others: list[int]
    ) -> tuple[NDArray[np.float32], NDArray[Any]]:
        """Segments and the region of each; a wall is drawn on both of its sides.

        So the contour of each cell is closed, in its own colour.
        """
        sides = mesh.regions[faces]
        walls = np.flatnonzero((sides != OUTSIDE).all(axis=1))
        if not len(walls):
            return vectors, sides.max(axis=1)
        a, b, c = mesh.vertices_numpy()[mesh.faces[faces[walls]]].transpose(1, 0, 2)
        # From the first side to the second, as in Mesh.normals: in Z, Y, X a cross product turns.
        normal = np.cross(c - a, b - a)[:, others]
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        half = 0.5 * float(self.layer.edge_width)
        shift = np.zeros((len(walls), 3), np.float32)
        shift[:, others] = half * normal / np.maximum(length, 1e-300)
        second = vectors[walls]
        second[:, 0] += shift
        vectors[walls, 0] -= shift
        regions = sides.max(axis=1)
        regions[walls] = sides[walls, 0]
        return np.concatenate([vectors, second]), np.concatenate([regions, sides[walls, 1]])

    def _set(self, vectors: NDArray[np.float32], regions: NDArray[Any]) -> None:
        layer = self.layer
        layer.data = vectors
        if len(vectors):
            # The name of one colour is much cheaper to set than an array of them.
            shown = regions if (regions != regions[0]).any() else regions[0]
            layer.edge_color = self.colours_of(shown, self.chosen)

    def colours_of(self, regions: Any, chosen: Collection[int] = ()) -> NDArray[np.float64]:
        """Colours of regions, (n, 4) RGBA; if some are chosen, the others are dimmed."""
        if self.by is not None:
            return self.by.rgba(regions, chosen)
        return region_colours(regions, chosen, self.colours)


def _is_off(width: float, layer: Vectors) -> bool:
    return not 1 / _OFF < width / float(layer.edge_width) < _OFF


def sliced_axis(dims: Any) -> int | None:
    """The axis (0 to 2: Z, Y, X) across the slice that is shown; None in 3D."""
    hidden = [axis - dims.ndim + 3 for axis in dims.not_displayed]
    hidden = [axis for axis in hidden if axis >= 0]
    return hidden[0] if dims.ndisplay == 2 and len(hidden) == 1 else None
