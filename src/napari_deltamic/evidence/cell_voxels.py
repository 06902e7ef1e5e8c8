"""The voxels of single cells, in which thin parts are looked for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry.labels.label_repair import label_boxes
from ..geometry.labels.voxels import voxel_labels
from ..geometry.mesh import Mesh
from ..scene import Grid


@dataclass(frozen=True, eq=False)
class CellVoxels:
    """A box of voxels around a cell.

    Attributes
    ----------
    region
        The cell.
    own
        (Z, Y, X) bool: voxels of the box that belong to the cell.
    first
        (3,) indices of the first voxel of the box in the grid; below 0 where it reaches beyond.
    grid
        Grid of the image.
    """

    region: int
    own: NDArray[np.bool_]
    first: NDArray[np.signedinteger]
    grid: Grid

    def at(
        self, values: NDArray[np.floating], places: NDArray[np.floating]
    ) -> NDArray[np.floating]:
        """(n,) values at the voxels nearest to places (n, 3) um; values : (Z, Y, X) of the box."""
        index = voxels_at(places, self.grid) - self.first
        found: NDArray[np.floating] = values[tuple(np.clip(index, 0, np.array(values.shape) - 1).T)]
        return found


def cell_voxels(mesh: Mesh, grid: Grid, around: int) -> Iterator[CellVoxels]:
    """Voxels of each cell that holds the centre of one, in a box with ``around`` more per side."""
    labels = voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin)
    for region, box in label_boxes(labels):
        own = np.pad(labels[box] == region, around)
        yield CellVoxels(region, own, np.array([side.start for side in box]) - around, grid)


def voxels_at(places: NDArray[np.floating], grid: Grid) -> NDArray[np.signedinteger]:
    """(n, 3) indices of the voxels nearest to places (n, 3) um, even beyond the image."""
    return np.rint((places - np.asarray(grid.origin)) / np.asarray(grid.voxel_size)).astype(int)
