"""Seeds: what layers and files say about where a fit starts, in um of the image's frame."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry import Mesh, load_mesh, mesh_from_labels, save_mesh, seeds_from_points
from ..geometry.files import write_atomically
from ..images import write_image
from ..job import SeedKind, filled
from ..scene import Grid
from .frame import OWN, FloatArray, Frame, stack_of

SEED_LAYERS = ("Points", "Labels", "Surface")


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

    def save(self, folder: Path, grid: Grid) -> Path:
        """Write what the command line takes as ``--seeds``."""


@dataclass(frozen=True)
class PointSeeds:
    """A point inside each cell; with radii (um), spheres, else surfaces that the image gives."""

    points: FloatArray
    radii: FloatArray | None
    path: str = ""

    @property
    def kind(self) -> SeedKind:
        """See ``Seeds``."""
        return "image" if self.radii is None else "rough"

    def mesh(self, image: NDArray[Any], grid: Grid) -> Mesh:
        """See ``Seeds``."""
        whole = filled(image)
        return seeds_from_points(whole, grid.voxel_size, self.points, self.radii, grid.origin)

    def save(self, folder: Path, grid: Grid) -> Path:
        """See ``Seeds``."""
        rows = self.points if self.radii is None else np.column_stack([self.points, self.radii])
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["z", "y", "x", "radius"][: rows.shape[1]])
        writer.writerows([[f"{value:.7g}" for value in row] for row in rows])
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

    def save(self, folder: Path, grid: Grid) -> Path:
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

    def save(self, folder: Path, grid: Grid) -> Path:
        """See ``Seeds``."""
        path = folder / "seeds.ply"
        save_mesh(self.surface, path)
        return path


@dataclass(frozen=True)
class FileSeeds:
    """A mesh file, um from the centre of the first voxel; read when the fit starts."""

    path: str
    kind: SeedKind = "rough"

    def mesh(self, image: NDArray[Any], grid: Grid) -> Mesh:
        """See ``Seeds``."""
        return load_mesh(self.path)

    def save(self, folder: Path, grid: Grid) -> Path:
        """See ``Seeds``."""
        return Path(self.path)


def seeds_from_layer(layer: Any, frame: Frame, step: tuple[int, ...], *, spheres: bool) -> Seeds:
    """The seeds that a Points, Labels or Surface layer holds, copied.

    ``spheres``: points are spheres as large as they are drawn.
    """
    kind = type(layer).__name__
    if kind == "Points":
        return _points(layer, frame, spheres=spheres)
    if kind == "Labels":
        return _labels(layer, frame, step)
    if kind == "Surface":
        return MeshSeeds(mesh_of_surface(layer, frame))
    raise InputError(f"'{layer.name}' is no Points, Labels or Surface layer")


def mesh_of_surface(layer: Any, frame: Frame) -> Mesh:
    """A Surface layer as a mesh, um in a frame; with the regions that a fit has noted in it."""
    vertices, faces = np.asarray(layer.data[0], float), np.asarray(layer.data[1])
    if vertices.ndim != 2 or vertices.shape[1] < 3 or not len(faces):
        raise InputError(f"layer '{layer.name}' holds no surface")
    scale, shift = frame.data_to_um(layer)
    regions = layer.metadata.get(OWN, {}).get("regions")
    if regions is not None and len(regions) != len(faces):
        regions = None
    mesh = Mesh(vertices[:, -3:] * scale + shift, faces, regions)
    if mesh.is_closed() and regions is None and mesh.region_volume(1) < 0:
        return Mesh(mesh.vertices, mesh.faces[:, ::-1])  # wound the other way
    return mesh


def _points(layer: Any, frame: Frame, *, spheres: bool) -> PointSeeds:
    data = np.asarray(layer.data, float)
    if not len(data):
        raise InputError(f"layer '{layer.name}' has no points yet: click inside each cell")
    if data.shape[1] < 3:
        raise InputError(f"layer '{layer.name}' is 2D; seeds need three coordinates")
    scale, shift = frame.data_to_um(layer)
    points = data[:, -3:] * scale + shift
    radii = None
    if spheres:
        radii = np.asarray(layer.size, float) / 2 * float(np.mean(scale))
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
