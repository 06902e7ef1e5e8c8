"""Where the cells come from: ticked layers, what they hold at the time shown, what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from napari.layers import Labels, Points, Surface
from numpy.typing import NDArray
from scipy.ndimage import affine_transform

from ..errors import InputError
from ..geometry import Mesh
from ..runs.seed_checks import (
    PointSet,
    Remark,
    all_remarks,
    beside_region,
    labels_beside_region,
)
from ..runs.seed_preview import Problem
from ..runs.seeds import LabelSeeds, MeshSeeds, PointSeeds, Seeds, mixed
from .image_source import ImageSource
from .layer_choice import LayerTicks
from .viewing.cell_layers import unchanged_file
from .viewing.frame import OWN, FloatArray, Frame, stack_of, um_per_unit
from .viewing.viewer_link import PINS
from .viewing.walls import joined

SEED_LAYERS = (Points, Labels, Surface)
PREVIEW = "preview"  # key under OWN: layers that only show what seeds would give


def is_seeds(layer: Any) -> bool:
    """Whether a layer can give seeds."""
    kept = isinstance(layer, SEED_LAYERS) and layer.ndim >= 3
    own = layer.metadata.get(OWN, {})
    tracked = bool(own) and isinstance(layer, Surface) and layer.ndim > 3
    return kept and not (own.get(PREVIEW) or own.get(PINS) or tracked)


def seed_kind(layer: Any) -> type:
    """The class in ``SEED_LAYERS`` to which a layer belongs; subclasses count as their base."""
    return next(kind for kind in SEED_LAYERS if isinstance(layer, kind))


def seeds_from_layer(
    layer: Any,
    frame: Frame,
    step: tuple[int, ...],
    *,
    spheres: bool,
    point: tuple[float, ...] = (),
    copied: bool = True,
    shape: tuple[int, ...] | None = None,
) -> Seeds:
    """The seeds that a Points, Labels or Surface layer holds. InputError if it cannot be used.

    Parameters
    ----------
    shape : of the image, (Z, Y, X): labels on other voxels are resampled; None: refused.
    step, point : of the viewer's dims: of layers of a series, the time shown is taken.
    spheres : points are spheres as large as they are drawn.
    copied : so that they stay as they are, whatever becomes of the layer.
    """
    if isinstance(layer, Points):
        return _points(layer, frame, point, spheres=spheres)
    if isinstance(layer, Labels):
        return _labels(layer, frame, step, shape, copied=copied)
    return MeshSeeds(mesh_of_surface(layer, frame, point), unchanged_file(layer, frame))


def is_empty(layer: Any, point: tuple[float, ...] = ()) -> bool:
    """Whether a layer holds no seeds at the time shown, as when it was only just made."""
    if isinstance(layer, Points):
        return not at_time(layer, layer.data, point).any()
    return isinstance(layer, Labels) and not np.any(layer.data)


def at_time(layer: Any, data: NDArray[Any], point: tuple[float, ...]) -> NDArray[np.bool_]:
    """(n,) bool: which rows of coordinates lie at the viewer's point on the axes before Z, Y, X."""
    kept = np.ones(len(data), bool)
    for axis in range(-4, -layer.ndim - 1, -1):
        if data.shape[1] >= -axis and len(point) >= -axis:
            own = (point[axis] - layer.translate[axis]) / layer.scale[axis]
            kept &= np.abs(data[:, axis] - own) <= 0.5
    return kept


def without_place(layer: Any, point: tuple[float, ...] = ()) -> str:
    """Numbers of points, at the time shown, with a coordinate that is not finite; '' for none."""
    data = np.asarray(layer.data, float)
    rows = np.flatnonzero(at_time(layer, data, point) & ~np.isfinite(data[:, -3:]).all(axis=1))
    return ", ".join(str(row + 1) for row in rows[:6].tolist())


def mesh_of_surface(layer: Any, frame: Frame, point: tuple[float, ...] = ()) -> Mesh:
    """A Surface layer as a mesh, um in a frame, with the regions that a fit stored in it."""
    if np.shape(layer.data[0])[1] < 3 or not len(layer.data[1]):
        raise InputError(f"layer '{layer.name}' holds no surface")
    vertices, faces, regions, _ = shown_surface(layer, point)
    if not len(faces):
        raise InputError(f"layer '{layer.name}' holds no surface at this time point")
    scale, shift = frame.data_to_um(layer)
    if np.prod(scale) < 0:  # a mirrored layer, in which what was outside is inside
        faces = faces[:, ::-1]
    mesh = Mesh(vertices.astype(float) * scale + shift, faces, regions)
    if mesh.is_closed() and regions is None and mesh.region_volume(1) < 0:
        return Mesh(mesh.vertices, mesh.faces[:, ::-1])  # wound the other way
    return mesh


def shown_surface(layer: Any, point: tuple[float, ...]) -> tuple[Any, Any, Any, Any]:
    """Vertices (V, 3), faces, stored regions and vertex indices of a Surface layer at a point.

    Regions are None where the layer stores none; the indices tell which of its vertices these are.
    """
    vertices, faces = joined(np.asarray(layer.data[0]), np.asarray(layer.data[1]), layer.metadata)
    used, regions = np.arange(len(vertices)), layer.metadata.get(OWN, {}).get("regions")
    if regions is not None and len(regions) != len(faces):
        regions = None
    shown = at_time(layer, vertices, point)[faces].all(axis=1)
    if not shown.all():
        faces, regions = faces[shown], None if regions is None else np.asarray(regions)[shown]
        used, faces = np.unique(faces, return_inverse=True)
    return vertices[used, -3:], faces.reshape(-1, 3), regions, used


def _points(layer: Any, frame: Frame, point: tuple[float, ...], *, spheres: bool) -> PointSeeds:
    data = np.asarray(layer.data, float)
    if not len(data):
        raise InputError(f"layer '{layer.name}' has no points yet: click inside each cell")
    shown = at_time(layer, data, point)
    if not shown.any():
        raise InputError(f"layer '{layer.name}' has no points at this time point")
    lost = without_place(layer, point)
    if lost:
        raise InputError(f"layer '{layer.name}': point {lost} has no position (nan): delete it")
    scale, shift = frame.data_to_um(layer)
    shown &= in_region(layer, data, frame)  # points beside it belong to other cells
    if not shown.any():
        raise InputError(f"layer '{layer.name}' has no points in the region that is fitted")
    points, radii = data[shown, -3:] * scale + shift, None
    if spheres:
        radii = np.asarray(layer.size, float)[shown] / 2 * float(np.mean(np.abs(scale)))
    return PointSeeds(points, radii)


def in_region(layer: Any, data: NDArray[Any], frame: Frame) -> NDArray[np.bool_]:
    """(n,) bool: which rows of a layer's coordinates lie in the region of a frame, if any."""
    if frame.shape is None:
        return np.ones(len(data), bool)
    scale, shift = frame.data_to_um(layer)
    places = np.floor((data[:, -3:] * scale + shift) / frame.voxel_size + 0.5)
    return np.asarray(((places >= 0) & (places < frame.shape)).all(axis=1))


def _labels(
    layer: Any, frame: Frame, step: tuple[int, ...], shape: tuple[int, ...] | None, *, copied: bool
) -> LabelSeeds:
    labels = stack_of(layer, step)
    if labels.ndim != 3:
        raise InputError(f"layer '{layer.name}' is not 3D")
    region = frame.region(layer, labels.shape)
    if region is not None:
        found = labels[region]
        if shape is not None and found.shape != shape:
            own, image = (" x ".join(map(str, one)) for one in (found.shape, shape))
            raise InputError(
                f"layer '{layer.name}' has {own} voxels, the image {image}: untick it under "
                "Cells, or choose the image that it belongs to"
            )
        return LabelSeeds(found.copy() if copied else found)
    # Labels of as many voxels are meant to lie on them; and the scale may be missing.
    unscaled = um_per_unit(layer) is None and np.all(layer.scale[-3:] == 1)
    if shape is None or labels.shape == shape or unscaled:
        raise InputError(
            f"layer '{layer.name}' does not lie on the voxels of the image: give both layers the "
            "same scale and translation"
        )
    # The nearest label at each voxel of the image, 0 beside all.
    scale, shift = frame.data_to_um(layer)
    places = np.diag(np.divide(frame.voxel_size, scale)), -shift / scale
    how: Any = {"output": labels.dtype, "order": 0, "mode": "grid-constant"}
    return LabelSeeds(affine_transform(labels, *places, output_shape=shape, **how))


@dataclass(frozen=True)
class Wanted:
    """What a preview is made from: points, um in the frame of an image layer, and the time.

    read : gives the voxels, in any thread.
    """

    points: FloatArray
    read: Callable[[], NDArray[Any]]
    layer: Any
    frame: Frame
    time: tuple[int, ...] = ()

    def key(self) -> tuple[Any, ...]:
        """A key that is equal as long as the preview is the same."""
        return self.points.tobytes(), id(self.layer), self.frame, self.time


class CellSource(LayerTicks):
    """The layers that the cells of an image are taken from, and what they hold.

    spheres : whether points are to be spheres.
    preview_mesh : the surfaces that are shown of the cells, where they are.
    told : what was said of the cells when they were made for a fit.
    """

    def __init__(self, viewer: Any, image: ImageSource) -> None:
        self._image = image
        self.spheres = self._awaited = False
        self._renewed: Any = None
        self.preview_mesh: Mesh | None = None
        self.told: tuple[str, ...] = ()
        super().__init__(viewer, is_seeds)

    def take_preview(self, mesh: Mesh | None) -> None:
        """Note the surfaces that are now shown of the cells."""
        self.preview_mesh = mesh

    def be_told(self, text: str = "") -> None:
        """Keep a message about the cells as made; '' forgets all messages, as the cells are new."""
        self.told = tuple(dict.fromkeys((*self.told, text))) if text else ()

    def be_spheres(self, on: bool) -> None:
        """Set whether points are spheres."""
        self.spheres = on

    def wait_for(self, awaited: bool, renewed: Any) -> None:
        """Note whether cells are being looked for, and which layer they will replace, if any."""
        self._awaited, self._renewed = awaited, renewed

    def seeds(self, frame: Frame, *, copied: bool = True) -> Seeds:
        """All seeds as one object. InputError if there are none, or they cannot be used."""
        if self._awaited and (not self.ticked or self._renewed in self.ticked):
            raise InputError("'Find cells' is still looking: wait until it has found them")
        if not self.ticked:
            raise InputError(
                "no cells yet: press 'Find cells', or 'Click cells' and click inside each"
            )
        point = self._point()
        filled = [layer for layer in self.ticked if not is_empty(layer, point)]
        # Where all are empty, the first of them says so itself.
        chosen = filled or self.ticked[:1]
        return mixed([self._of(layer, frame, copied=copied) for layer in chosen])

    def close_links(self) -> None:
        """Stop listening to the viewer, and release its layers."""
        super().close_links()
        self._renewed = None

    def points_layers(self) -> list[Any]:
        return [layer for layer in self.ticked if isinstance(layer, Points)]

    def wanted(self) -> Wanted | None:
        """What a preview of the points is made from; None if there is nothing to show."""
        frame = None if self.spheres else self._image.known_frame
        points = np.zeros((0, 3)) if frame is None else self.points(frame)
        if frame is None or not len(points):
            return None
        time = tuple(int(k) for k in self._viewer.dims.current_step[:-3])
        return Wanted(points, self._image.reader(), self._image.layer, frame, time)

    def points(self, frame: Frame) -> FloatArray:
        """All points in ticked layers, (n, 3) um."""
        return np.concatenate([np.zeros((0, 3)), *(x.points for x in self._point_sets(frame))])

    def remarks(self, problems: tuple[Problem, ...]) -> list[Remark]:
        """Remarks on what may be wrong with the seeds; ``problems`` come from a preview."""
        frame = self._image.known_frame
        if frame is None:
            return []
        labels = []
        for layer in self.ticked:
            if isinstance(layer, Labels):
                with suppress(InputError):  # said when the fit starts
                    seeds = self._of(layer, frame, copied=False)
                    assert isinstance(seeds, LabelSeeds)
                    labels.append((layer, seeds.labels))
        sets = self._point_sets(frame)
        known = all_remarks(sets, labels, self._image.shape(), frame.voxel_size, problems)
        made = [Remark(text[0].upper() + text[1:]) for text in self.told]
        return self._placeless() + self._beside(frame) + known + made

    def _beside(self, frame: Frame) -> list[Remark]:
        """Remarks on cells that are left out or cut because only a region is fitted."""
        found: list[Remark] = []
        for layer in self.ticked if frame.box is not None else ():
            with suppress(InputError):  # said when the fit starts
                found += self._layer_beside(layer, frame)
        return found

    def _layer_beside(self, layer: Any, frame: Frame) -> list[Remark]:
        if isinstance(layer, Labels):
            labels = stack_of(layer, tuple(self._viewer.dims.current_step))
            box = frame.region(layer, labels.shape) if labels.ndim == 3 else None
            return labels_beside_region(layer.name, labels, box) if box else []
        if not isinstance(layer, Points):
            return []
        points = np.asarray(layer.data, float)
        points = points[at_time(layer, points, self._point())]
        points = points[np.isfinite(points).all(axis=1)]  # else told for that
        beyond = int((~in_region(layer, points, frame)).sum())
        return beside_region("point", layer.name, len(points), beyond)

    def _placeless(self) -> list[Remark]:
        """Remarks on points without a position; their layers are of no use until these are gone."""
        layers, point = self.points_layers(), self._point()
        found = [(layer.name, without_place(layer, point)) for layer in layers]
        text = "Point {} of '{}' has no position: delete it"
        return [Remark(text.format(lost, name)) for name, lost in found if lost]

    def _point_sets(self, frame: Frame) -> list[PointSet]:
        """The points of each layer; errors in layers are reported when a fit starts."""
        point = self._point()
        layers = [layer for layer in self.points_layers() if not is_empty(layer, point)]
        sets = []
        for layer in layers:
            try:
                seeds = self._of(layer, frame)
            except InputError:
                continue
            assert isinstance(seeds, PointSeeds)
            rows = np.flatnonzero(at_time(layer, layer.data, point))
            sets.append(PointSet(layer, seeds.points, seeds.radii, rows, len(layers) > 1))
        return sets

    def _of(self, layer: Any, frame: Frame, *, copied: bool = True) -> Seeds:
        step, shape = tuple(self._viewer.dims.current_step), self._image.shape()
        more: Any = {"point": self._point(), "copied": copied, "shape": shape}
        return seeds_from_layer(layer, frame, step, spheres=self.spheres, **more)

    def _point(self) -> tuple[float, ...]:
        return tuple(float(p) for p in self._viewer.dims.point)
