"""Seeds: what layers and files say about where a fit starts, in um of the image's frame."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, get_args

import numpy as np
from napari.layers import Labels, Points, Surface
from numpy.typing import NDArray

from ...common.writing import write_atomically
from ...errors import InputError
from ...fitting.job import SeedKind
from ...geometry import Mesh, mesh_from_labels, save_mesh, seeds_from_points
from ...images.missing import filled
from ...images.stacks import write_image
from ...scene import Grid
from ..viewing.frame import OWN, FloatArray, Frame, stack_of
from ..viewing.mesh_layer import unchanged_file
from ..viewing.walls import joined

SEED_LAYERS = (Points, Labels, Surface)


class Seeds(Protocol):
    """Where a fit starts."""

    @property
    def kind(self) -> SeedKind:
        """How near to the membranes the surfaces lie."""

    @property
    def path(self) -> str:
        """The file that they are, or '' if they only live in the viewer."""

    def mesh(self, image: NDArray[Any], grid: Grid) -> Mesh:
        """The starting surfaces; may take seconds. InputError if they cannot be used."""

    def save(self, folder: Path, image: NDArray[Any], grid: Grid) -> Path:
        """Write what the command line takes as ``--seeds``."""


@dataclass(frozen=True)
class PointSeeds:
    """A point inside each cell: a sphere where its radius (um) is known, else (nan, or without
    radii) the surface that the image gives.
    """

    points: FloatArray
    radii: FloatArray | None
    path: str = ""

    @property
    def kind(self) -> SeedKind:
        """See ``Seeds``."""
        spheres = self.radii is not None and bool((np.nan_to_num(self.radii) > 0).any())
        return "rough" if spheres else "image"

    def mesh(self, image: NDArray[Any], grid: Grid) -> Mesh:
        """See ``Seeds``."""
        whole = filled(image)
        return seeds_from_points(whole, grid.voxel_size, self.points, self.radii, grid.origin)

    def save(self, folder: Path, image: NDArray[Any], grid: Grid) -> Path:
        """See ``Seeds``."""
        rows = self.points if self.radii is None else np.column_stack([self.points, self.radii])
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["z", "y", "x", "radius"][: rows.shape[1]])
        # An empty radius is one that is not known.
        writer.writerows([[repr(float(v)) if v == v else "" for v in row] for row in rows])
        path = folder / "seeds.csv"
        write_atomically(path, text.getvalue().encode())
        return path


@dataclass(frozen=True)
class LabelSeeds:
    """A label image on the same voxels."""

    labels: NDArray[Any]
    path: str = ""
    kind: SeedKind = "labels"

    def mesh(self, image: NDArray[Any], grid: Grid) -> Mesh:
        """See ``Seeds``."""
        if self.labels.shape != grid.shape:
            raise InputError(
                f"the labels have shape {self.labels.shape}, the image {grid.shape}: "
                "they must cover the same voxels"
            )
        return mesh_from_labels(self.labels, grid.voxel_size, grid.origin)

    def save(self, folder: Path, image: NDArray[Any], grid: Grid) -> Path:
        """See ``Seeds``."""
        path = folder / "seeds.tif"
        high = int(self.labels.max(initial=0))
        if high > np.iinfo(np.uint16).max:
            raise InputError(f"label {high} is too large for a label image file")
        write_image(path, self.labels.astype(np.uint16), grid.voxel_size)
        return path


@dataclass(frozen=True)
class MeshSeeds:
    """Surfaces as they are."""

    surface: Mesh
    path: str = ""
    kind: SeedKind = "rough"

    def mesh(self, image: NDArray[Any], grid: Grid) -> Mesh:
        """See ``Seeds``."""
        return self.surface

    def save(self, folder: Path, image: NDArray[Any], grid: Grid) -> Path:
        """See ``Seeds``."""
        path = folder / "seeds.ply"
        save_mesh(self.surface, path)
        return path


@dataclass(frozen=True)
class MixedSeeds:
    """Seeds of several kinds; the surfaces of all, each with regions of its own."""

    parts: tuple[Seeds, ...]
    path: str = ""

    @property
    def kind(self) -> SeedKind:
        """See ``Seeds``: as far from the membranes as any part."""
        kinds = {part.kind for part in self.parts}
        return next(kind for kind in get_args(SeedKind) if kind in kinds)

    def mesh(self, image: NDArray[Any], grid: Grid) -> Mesh:
        """See ``Seeds``."""
        return Mesh.merge([part.mesh(image, grid) for part in self.parts])

    def save(self, folder: Path, image: NDArray[Any], grid: Grid) -> Path:
        """See ``Seeds``: a mesh file, which holds any mixture; may take seconds."""
        return MeshSeeds(self.mesh(image, grid)).save(folder, image, grid)


def mixed(parts: Sequence[Seeds]) -> Seeds:
    """One seeds object of several.

    Points go together, so that two in one cell are seen even if they are in two layers.
    """
    points = [part for part in parts if isinstance(part, PointSeeds)]
    others = [part for part in parts if not isinstance(part, PointSeeds)]
    together = [_joined(points), *others] if points else others
    return together[0] if len(together) == 1 else MixedSeeds(tuple(together))


def _joined(parts: Sequence[PointSeeds]) -> PointSeeds:
    if len(parts) == 1:
        return parts[0]
    radii = None
    if any(part.radii is not None for part in parts):
        unknown = [np.full(len(part.points), np.nan) for part in parts]
        radii = np.concatenate(
            [
                u if part.radii is None else part.radii
                for u, part in zip(unknown, parts, strict=True)
            ]
        )
    return PointSeeds(np.concatenate([part.points for part in parts]), radii)


def seeds_from_layer(
    layer: Any,
    frame: Frame,
    step: tuple[int, ...],
    *,
    spheres: bool,
    point: tuple[float, ...] = (),
) -> Seeds:
    """The seeds that a Points, Labels or Surface layer holds, copied.

    Parameters
    ----------
    step, point : of the viewer's dims: of layers of a series, the time shown is taken.
    spheres : points are spheres as large as they are drawn.
    """
    if isinstance(layer, Points):
        return _points(layer, frame, point, spheres=spheres)
    if isinstance(layer, Labels):
        return _labels(layer, frame, step)
    if isinstance(layer, Surface):
        surface = mesh_of_surface(layer, frame, point)
        return MeshSeeds(surface, unchanged_file(layer, frame))
    raise InputError(f"'{layer.name}' is no Points, Labels or Surface layer")


def is_empty(layer: Any, point: tuple[float, ...] = ()) -> bool:
    """Whether a layer holds no seeds (at the time shown): one that was only just made, say."""
    if isinstance(layer, Points):
        return not at_time(layer, layer.data, point).any()
    return isinstance(layer, Labels) and not np.any(layer.data)


def at_time(layer: Any, data: NDArray[Any], point: tuple[float, ...]) -> NDArray[np.bool_]:
    """(n,) which rows of coordinates lie at the viewer's point along the axes before Z, Y, X."""
    kept = np.ones(len(data), bool)
    for axis in range(-4, -layer.ndim - 1, -1):
        if data.shape[1] >= -axis and len(point) >= -axis:
            own = (point[axis] - layer.translate[axis]) / layer.scale[axis]
            kept &= np.abs(data[:, axis] - own) <= 0.5
    return kept


def without_place(layer: Any, point: tuple[float, ...] = ()) -> NDArray[np.int64]:
    """Rows of a Points layer (at the time shown) whose coordinates are not all numbers."""
    data = np.asarray(layer.data, float)
    return np.flatnonzero(at_time(layer, data, point) & ~np.isfinite(data[:, -3:]).all(axis=1))


def mesh_of_surface(layer: Any, frame: Frame, point: tuple[float, ...] = ()) -> Mesh:
    """A Surface layer as a mesh, um in a frame; with the regions that a fit has noted in it."""
    vertices, faces = np.asarray(layer.data[0], float), np.asarray(layer.data[1])
    if vertices.ndim != 2 or vertices.shape[1] < 3 or not len(faces):
        raise InputError(f"layer '{layer.name}' holds no surface")
    vertices, faces = joined(vertices, faces, layer.metadata)
    scale, shift = frame.data_to_um(layer)
    if np.prod(scale) < 0:  # a mirrored layer, in which what was outside is inside
        faces = faces[:, ::-1]
    regions = layer.metadata.get(OWN, {}).get("regions")
    if regions is not None and len(regions) != len(faces):
        regions = None
    shown = at_time(layer, vertices, point)[faces].all(axis=1)
    if not shown.any():
        raise InputError(f"layer '{layer.name}' holds no surface at this time point")
    if not shown.all():
        faces, regions = faces[shown], None if regions is None else regions[shown]
        used, faces = np.unique(faces, return_inverse=True)
        vertices, faces = vertices[used], faces.reshape(-1, 3)
    mesh = Mesh(vertices[:, -3:] * scale + shift, faces, regions)
    if mesh.is_closed() and regions is None and mesh.region_volume(1) < 0:
        return Mesh(mesh.vertices, mesh.faces[:, ::-1])  # wound the other way
    return mesh


def _points(layer: Any, frame: Frame, point: tuple[float, ...], *, spheres: bool) -> PointSeeds:
    data = np.asarray(layer.data, float)
    if not len(data):
        raise InputError(f"layer '{layer.name}' has no points yet: click inside each cell")
    if data.shape[1] < 3:
        raise InputError(f"layer '{layer.name}' is 2D; seeds need three coordinates")
    shown = at_time(layer, data, point)
    if not shown.any():
        raise InputError(f"layer '{layer.name}' has no points at this time point")
    placeless = without_place(layer, point)
    if len(placeless):
        named = ", ".join(str(row + 1) for row in placeless[:6].tolist())
        raise InputError(f"layer '{layer.name}': point {named} has no place (nan): delete it")
    scale, shift = frame.data_to_um(layer)
    points = data[shown, -3:] * scale + shift
    radii = None
    if spheres:
        radii = np.asarray(layer.size, float)[shown] / 2 * float(np.mean(np.abs(scale)))
    return PointSeeds(points, radii)


def _labels(layer: Any, frame: Frame, step: tuple[int, ...]) -> LabelSeeds:
    scale, shift = frame.data_to_um(layer)
    size = np.asarray(frame.voxel_size)
    if not np.allclose(scale, size, rtol=1e-3) or (np.abs(shift) > 0.01 * size).any():
        raise InputError(
            f"layer '{layer.name}' does not lie on the voxels of the image: give both layers the "
            "same scale and translation"
        )
    labels = stack_of(layer, step)
    if labels.ndim != 3:
        raise InputError(f"layer '{layer.name}' is not 3D")
    return LabelSeeds(labels.copy())
