"""What is known of a shape besides its mesh, and what follows for errors and borders."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.mesh import FloatArray, Mesh
from napari_deltamic.measure.sides import Sides

Deviation = Callable[[FloatArray], float]  # of a number, from its gradient by vertices (V, 3)


class ImageGrid(Protocol):
    """Where the voxels of an image lie, um; a ``Grid`` is one."""

    @property
    def extent(self) -> tuple[NDArray, NDArray]:
        """Centres of the first and the last voxel."""


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of a shape besides its mesh; None or empty for what is not.

    grid : of the image that it was fitted to.
    density : (F,) fluorophores per um^2 of each membrane, relative to their mean or not.
    resolution : um; the PSF's standard deviation, the geometric mean of the three axes.
    deviation : the standard error of a number, from its gradient by vertices.
    explained : for a region, the share of what varies around it that the fit explains.
    doubts : for a region, why its shape is in doubt.
    """

    grid: ImageGrid | None = None
    density: FloatArray | None = None
    resolution: float = 0.0
    deviation: Deviation | None = None
    explained: Mapping[int, float] = field(default_factory=dict)
    doubts: Mapping[int, str] = field(default_factory=dict)

    def checked(self, mesh: Mesh) -> Known:
        """Itself; InputError if the densities are those of another mesh, or no numbers."""
        if self.density is not None and np.shape(self.density) != (len(mesh.faces),):
            raise InputError(
                f"there are {np.size(self.density)} densities for {len(mesh.faces)} faces"
            )
        if self.density is not None and not np.isfinite(self.density).all():
            raise InputError("densities must be finite numbers")
        if not 0 <= self.resolution < np.inf:
            raise InputError(f"the resolution must be a length (um), not {self.resolution}")
        return self

    def error(self, gradient: Callable[[], FloatArray]) -> float | None:
        """The standard error of a number; None where errors are not known."""
        return None if self.deviation is None else self.deviation(gradient())

    def beyond(self, mesh: Mesh) -> NDArray[np.bool_] | None:
        """(V,) vertices at or beyond the centres of the outermost voxels; None without a grid."""
        if self.grid is None:
            return None
        first, last = self.grid.extent
        v = mesh.vertices_numpy()
        return np.asarray(((v <= first) | (v >= last)).any(axis=1), np.bool_)

    def cut(self, sides: Sides) -> NDArray[np.bool_] | None:
        """(C,) whether a cell reaches beyond the centres of the outermost voxels."""
        beyond = self.beyond(sides.mesh)
        if beyond is None:
            return None
        touched = beyond[sides.mesh.faces[sides.face]].any(1)
        found: NDArray[np.bool_] = sides.total(touched.astype(float)) > 0
        return found


def area_gradient(mesh: Mesh, faces: NDArray[np.bool_]) -> FloatArray:
    """(V, 3) um: change of the area of some faces (F,) by the vertices."""
    corners = mesh.vertices_numpy()[mesh.faces[faces]]
    opposite = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)
    # Z, Y, X components are left-handed: hence the sign.
    each = -0.5 * np.cross(mesh.normals()[faces][:, None], opposite)
    return _at_vertices(mesh, mesh.faces[faces], each)


def volume_gradient(sides: Sides, cell: int) -> FloatArray:
    """(V, 3) um^2: change of the volume of a cell, by its index, by the vertices."""
    mesh, own = sides.mesh, sides.cell == cell
    face = sides.face[own]
    # A third of the area vector of each face belongs to each of its corners.
    each = (sides.sign[own] * mesh.areas()[face] / 3)[:, None] * mesh.normals()[face]
    return _at_vertices(mesh, mesh.faces[face], np.repeat(each[:, None], 3, 1))


def _at_vertices(mesh: Mesh, faces: NDArray[np.int64], each: FloatArray) -> FloatArray:
    columns = np.moveaxis(each, 2, 0)
    flat = faces.reshape(-1)
    return np.stack([np.bincount(flat, c.reshape(-1), len(mesh.vertices)) for c in columns], 1)
