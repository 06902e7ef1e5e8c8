"""Where a fit starts: kinds of seeds, each of which makes surfaces; for commands and the window."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from ..common.choices import AUTO, IMAGE_FILES, is_auto
from ..common.writing import write_atomically
from ..errors import InputError, NoCellsFound
from ..geometry import (
    Mesh,
    load_mesh,
    mesh_from_labels,
    read_napari_points,
    read_points_csv,
    save_mesh,
    seeds_from_points,
)
from ..geometry.formats import MESH_FILES
from ..geometry.mesh import FloatArray
from ..images.missing import filled, finite_or_nan
from ..images.padding import without_padding
from ..images.stacks import read_image, write_image
from ..scene import Grid

POINTS_FILE = ".csv"
# How near to the membranes starting surfaces lie: "rough" for meshes and spheres, "labels", or
# "image" where all are found in the image from points alone (neighbours without a point would
# attract surfaces that start further away).
SeedKind = Literal["rough", "labels", "image"]


class Seeds(Protocol):
    """Where a fit starts."""

    @property
    def kind(self) -> SeedKind:
        """How near to the membranes the surfaces lie."""

    @property
    def path(self) -> str:
        """The file that holds them, or '' if they exist only in the viewer."""

    def make(self, image: NDArray[Any], grid: Grid) -> Mesh:
        """The starting surfaces; may take seconds. InputError if they cannot be used."""

    def save(self, folder: Path, image: NDArray[Any], grid: Grid) -> Path:
        """Write a file that the command line takes as ``--seeds``, and return its path."""


@dataclass(frozen=True)
class PointSeeds:
    """A point inside each cell: the start is a sphere where its radius (um) is known, else (NaN, or
    without radii) the surface that the image gives.

    Points are in um, or with ``in_voxels`` in voxels.
    """

    points: FloatArray
    radii: FloatArray | None
    path: str = ""
    in_voxels: bool = False

    @property
    def kind(self) -> SeedKind:
        """See ``Seeds``."""
        spheres = self.radii is not None and bool((np.nan_to_num(self.radii) > 0).any())
        return "rough" if spheres else "image"

    def make(self, image: NDArray[Any], grid: Grid) -> Mesh:
        """See ``Seeds``."""
        points, whole = self.places(grid), filled(image)
        return seeds_from_points(whole, grid.voxel_size, points, self.radii, grid.origin)

    def places(self, grid: Grid) -> FloatArray:
        """The points in um, (n, 3)."""
        if not self.in_voxels:
            return self.points
        return np.asarray(grid.origin) + self.points * np.asarray(grid.voxel_size)

    def save(self, folder: Path, image: NDArray[Any], grid: Grid) -> Path:
        """See ``Seeds``."""
        points = self.places(grid)
        rows = points if self.radii is None else np.column_stack([points, self.radii])
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["z", "y", "x", "radius"][: rows.shape[1]])
        # Unknown radii are left empty.
        writer.writerows([[repr(float(v)) if v == v else "" for v in row] for row in rows])
        path = folder / "seeds.csv"
        write_atomically(path, text.getvalue().encode())
        return path


@dataclass(frozen=True)
class LabelSeeds:
    """A label image on the same voxels.

    Attributes
    ----------
    marks
        Whether labels may just mark the cells that the image shows, as labels of nuclei do.
    """

    labels: NDArray[Any]
    path: str = ""
    kind: SeedKind = "labels"
    marks: bool = True

    def make(self, image: NDArray[Any], grid: Grid) -> Mesh:
        """See ``Seeds``."""
        if self.labels.shape != grid.shape:
            raise InputError(
                f"the labels have shape {self.labels.shape}, the image {grid.shape}: "
                "they must cover the same voxels"
            )
        seen = filled(image) if self.marks else None
        return mesh_from_labels(self.labels, grid.voxel_size, grid.origin, image=seen)

    def save(self, folder: Path, image: NDArray[Any], grid: Grid) -> Path:
        """See ``Seeds``."""
        path = folder / "seeds.tif"
        least, most = self.labels.min(initial=0), self.labels.max(initial=0)
        small = least == 0 and most <= np.iinfo(np.uint16).max
        labels = self.labels.astype(np.uint16) if small else self.labels
        write_image(path, labels, grid.voxel_size)
        return path


@dataclass(frozen=True)
class MeshSeeds:
    """A mesh, used as it is."""

    surface: Mesh
    path: str = ""
    kind: SeedKind = "rough"

    def make(self, image: NDArray[Any], grid: Grid) -> Mesh:
        """See ``Seeds``. InputError where the whole mesh is smaller than a voxel."""
        low, high = self.surface.bounds()
        sides = np.asarray(high) - np.asarray(low)
        if sides.max() < min(grid.voxel_size):
            raise InputError(
                f"the mesh is {sides.max():.3g} um wide, less than a voxel: its numbers must be um"
            )
        return self.surface

    def save(self, folder: Path, image: NDArray[Any], grid: Grid) -> Path:
        """See ``Seeds``."""
        path = folder / "seeds.ply"
        save_mesh(self.surface, path)
        return path


@dataclass(frozen=True)
class MixedSeeds:
    """Seeds of several kinds: the surfaces of all parts, with distinct regions."""

    parts: tuple[Seeds, ...]
    path: str = ""

    @property
    def kind(self) -> SeedKind:
        """See ``Seeds``: as far from the membranes as any part."""
        kinds = {part.kind for part in self.parts}
        return next(kind for kind in get_args(SeedKind) if kind in kinds)

    def make(self, image: NDArray[Any], grid: Grid) -> Mesh:
        """See ``Seeds``."""
        return Mesh.merge([part.make(image, grid) for part in self.parts])

    def save(self, folder: Path, image: NDArray[Any], grid: Grid) -> Path:
        """See ``Seeds``: a mesh file, which holds any mixture; may take seconds."""
        return MeshSeeds(self.make(image, grid)).save(folder, image, grid)


def mixed(parts: Sequence[Seeds]) -> Seeds:
    """Several seeds objects as one.

    Points are joined, so that two in one cell are noticed even if they are in two layers.
    """
    points = [part for part in parts if isinstance(part, PointSeeds) and not part.in_voxels]
    others = [part for part in parts if not isinstance(part, PointSeeds) or part.in_voxels]
    # Labels that mark cells would take up the place of other parts, which they know nothing of.
    others = (
        [replace(part, marks=False) if isinstance(part, LabelSeeds) else part for part in others]
        if len(parts) > 1
        else others
    )
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


@dataclass(frozen=True)
class FoundSeeds:
    """The cells of an image of membranes, or of nuclei, found without a click.

    Attributes
    ----------
    size
        Diameter of a typical cell, um; None: estimated.
    path
        The text from which :func:`seeds_of` makes the same object.
    nuclei
        File and channel that show nuclei, which mark the cells; None: found in the image itself.
    """

    size: float | None = None
    path: str = AUTO
    nuclei: tuple[str, str] | None = None
    kind: SeedKind = "labels"

    def make(self, image: NDArray[Any], grid: Grid) -> Mesh:
        """See ``Seeds``."""
        return LabelSeeds(self.labels(image, grid)).make(image, grid)

    def save(self, folder: Path, image: NDArray[Any], grid: Grid) -> Path:
        """See ``Seeds``."""
        return LabelSeeds(self.labels(image, grid)).save(folder, image, grid)

    def labels(self, image: NDArray[Any], grid: Grid) -> NDArray[np.int32]:
        """The cells as a (Z, Y, X) label image. InputError if none are found."""
        # Imported only here, as that takes a while.
        from ..geometry.labels.bright_cells import cells_of

        if self.nuclei is None:
            return cells_of(image, grid.voxel_size, self.size).labels
        file, channel = self.nuclei
        seen = finite_or_nan(read_image(file, channel, f"--seeds {AUTO}@")[0])
        if seen.shape != grid.shape:
            raise InputError(f"the nuclei have shape {seen.shape}, the image {grid.shape}")
        try:
            return cells_of(without_padding(seen)[0], grid.voxel_size, self.size).labels
        except NoCellsFound:
            raise
        except InputError as error:
            raise InputError(f"channel {channel}: {error}") from None


def _found(path: str, image: str) -> FoundSeeds:
    """Seeds for "auto", "auto:12" (um), "auto@2" (a channel of the image) or "auto@2:12"."""
    place, colon, told = path[len(AUTO) :].partition(":")
    if place and not (place[1:] and image):
        raise InputError(f"{path}: say which channel of the image shows the nuclei, as in {AUTO}@2")
    try:
        size = float(told) if colon else None
    except ValueError:
        raise InputError(
            f"{path}: {told!r} is not a cell size in um; write {AUTO}:12, say"
        ) from None
    return FoundSeeds(size, path, (image, place[1:]) if place else None)


def read_points(path: str) -> PointSeeds:
    """Points of a CSV file, in um or as napari saves a layer.

    Raises
    ------
    InputError
        If the file cannot be read as such.
    """
    voxels = read_napari_points(path)
    if voxels is not None:
        return PointSeeds(voxels, None, path, in_voxels=True)
    return PointSeeds(*read_points_csv(path), path)


def seeds_of(path: str, image: str = "") -> Seeds:
    """Seeds from a file, by its extension: mesh, label image, or points; or from "auto", or
    "auto:12" for cells of about 12 um; or "auto@2", where nuclei in another channel mark them.

    image : path of the image, if it has one.

    Raises
    ------
    InputError
        If the extension is unknown, or the file cannot be read.
    """
    if is_auto(path):
        return _found(path, image)
    kind = Path(path).suffix.lower()
    if kind in MESH_FILES:
        return MeshSeeds(load_mesh(path), path)
    if kind in IMAGE_FILES:
        return LabelSeeds(read_image(path)[0], path)
    if kind == POINTS_FILE:
        return read_points(path)
    known = ", ".join((*MESH_FILES, *IMAGE_FILES, POINTS_FILE))
    raise InputError(f"{path}: unknown extension '{kind}' for seeds; known are {known}, or {AUTO}")
