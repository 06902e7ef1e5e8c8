"""Which parts of a mesh lie beyond the border of an image."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .mesh import OUTSIDE, Mesh


class ImageGrid(Protocol):
    """Anything that says where the voxels of an image lie (um), such as a ``Grid``."""

    @property
    def extent(self) -> tuple[NDArray, NDArray]:
        """The centres of the first and the last voxel, (3,) um each."""


def beyond(mesh: Mesh, grid: ImageGrid) -> NDArray[np.bool_]:
    """Return (V,) bool: vertices at or beyond the centres of the outermost voxels.

    No voxel lies further out, so nothing tells whether a surface there is where a cell ends or
    where it is cut. A vertex further in has voxels on both sides, however near the border it is.
    Measured: membranes and insides 0.25 to 1.5 voxels further in were found to 0.2 voxel, and those
    of spheres that reached up to 3 voxels beyond ended beyond, too.
    """
    first, last = grid.extent
    places = mesh.vertices_numpy()
    return np.asarray(((places <= first) | (places >= last)).any(axis=1), np.bool_)


def cut_cells(mesh: Mesh, grid: ImageGrid) -> frozenset[int]:
    """Return the cells that the border of an image cuts: some of their surface lies beyond it."""
    faces = beyond(mesh, grid)[mesh.faces].any(axis=1)
    return frozenset(np.unique(mesh.regions[faces]).tolist()) - {OUTSIDE}
