"""Where the cells come from: ticked layers, what they hold at the time shown, what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from napari.layers import Labels, Points
from numpy.typing import NDArray

from ...errors import InputError
from ...geometry import Mesh
from ...runs.seed_checks import PointSet, Remark, all_remarks
from ...runs.seed_preview import Problem
from ...runs.seeds import PointSeeds, Seeds, mixed
from ..image_source import ImageSource
from ..layer_choice import LayerTicks
from ..viewing.frame import FloatArray, Frame, stack_of
from .seed_kinds import at_time, is_empty, is_seeds, seeds_from_layer, without_place


@dataclass(frozen=True)
class Wanted:
    """What a preview is of: points, um in the frame of an image layer, and when.

    image : gives the voxels; only asked when the preview is computed.
    """

    points: FloatArray
    image: Callable[[], NDArray[Any]]
    layer: Any
    frame: Frame
    time: tuple[int, ...] = ()

    def key(self) -> tuple[Any, ...]:
        """Equal where the preview is the same."""
        return self.points.tobytes(), id(self.layer), self.frame, self.time


class CellSource(LayerTicks):
    """The layers that the cells of an image are taken from, and what they hold.

    spheres : whether points are to be spheres.
    preview_mesh : the surfaces that are shown of the cells, where they are.
    """

    def __init__(self, viewer: Any, image: ImageSource) -> None:
        self._image = image
        self.spheres = False
        self.preview_mesh: Mesh | None = None
        super().__init__(viewer, is_seeds)

    def take_preview(self, mesh: Mesh | None) -> None:
        """Other surfaces are shown of the cells."""
        self.preview_mesh = mesh

    def be_spheres(self, on: bool) -> None:
        """Whether points are to be spheres."""
        self.spheres = on

    def seeds(self, frame: Frame, *, copied: bool = True) -> Seeds:
        """The seeds. InputError where there are none, or they cannot be used."""
        if not self.ticked:
            raise InputError(
                "no cells yet: press 'Find cells', or 'Click cells' and click inside each"
            )
        point = self._point()
        filled = [layer for layer in self.ticked if not is_empty(layer, point)]
        # Where all are empty, the first of them says so itself.
        chosen = filled or self.ticked[:1]
        return mixed([self._of(layer, frame, self.spheres, copied=copied) for layer in chosen])

    def points_layers(self) -> list[Any]:
        return [layer for layer in self.ticked if isinstance(layer, Points)]

    def shape(self) -> tuple[int, ...] | None:
        """Of the 3D image; None where there is none that can be used: its panel says why."""
        if self._frame() is None:
            return None
        return self._image.shape()

    def wanted(self) -> Wanted | None:
        """What a preview of the points is made of; None where there is nothing to show."""
        frame = self._frame()
        sets = self._point_sets(frame, spheres=False) if frame is not None else []
        if frame is None or not sets:
            return None
        points = np.concatenate([one.points for one in sets])
        time = tuple(int(k) for k in self._viewer.dims.current_step[:-3])
        return Wanted(points, self._image.stack, self._image.layer, frame, time)

    def remarks(self, problems: tuple[Problem, ...]) -> list[Remark]:
        """What may be wrong with the seeds; ``problems`` are those of a preview."""
        frame, shape = self._frame(), self.shape()
        if frame is None or shape is None:
            return []
        step = tuple(self._viewer.dims.current_step)
        labels = []
        for layer in self.ticked:
            if isinstance(layer, Labels):
                voxels = stack_of(layer, step)
                region = frame.region(layer, voxels.shape) if voxels.ndim == 3 else None
                labels.append((layer, voxels if region is None else voxels[region]))
        sets = self._point_sets(frame, self.spheres)
        known = all_remarks(sets, labels, shape, frame.voxel_size, problems)
        return self._placeless() + known

    def _placeless(self) -> list[Remark]:
        """Points that lie nowhere; their layers cannot be used before these are gone."""
        found = []
        for layer in self.points_layers():
            rows = without_place(layer, self._point()).tolist()
            if rows:
                named = ", ".join(str(row + 1) for row in rows[:6])
                found.append(Remark(f"Point {named} of '{layer.name}' has no place: delete it"))
        return found

    def _point_sets(self, frame: Frame, spheres: bool) -> list[PointSet]:
        """The points of each layer; layers that cannot be used are told when a fit starts."""
        point = self._point()
        layers = [layer for layer in self.points_layers() if not is_empty(layer, point)]
        sets = []
        for layer in layers:
            try:
                seeds = self._of(layer, frame, spheres)
            except InputError:
                continue
            assert isinstance(seeds, PointSeeds)
            rows = np.flatnonzero(at_time(layer, layer.data, point))
            sets.append(PointSet(layer, seeds.points, seeds.radii, rows, len(layers) > 1))
        return sets

    def _of(self, layer: Any, frame: Frame, spheres: bool, *, copied: bool = True) -> Seeds:
        step, point = tuple(self._viewer.dims.current_step), self._point()
        return seeds_from_layer(layer, frame, step, spheres=spheres, point=point, copied=copied)

    def _point(self) -> tuple[float, ...]:
        return tuple(float(p) for p in self._viewer.dims.point)

    def _frame(self) -> Frame | None:
        try:
            return self._image.frame()
        except InputError:
            return None
