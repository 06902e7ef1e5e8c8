"""The faces of a mesh as each of its cells sees them: outward, one row for each side."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..geometry.mesh import OUTSIDE, FloatArray, IntArray, Mesh


@dataclass(frozen=True, eq=False)
class Sides:
    """All sides of faces that belong to a cell; a wall between two cells has two.

    mesh : um.
    cells : (C,) region numbers, increasing.
    cell : (S,) index into ``cells``.
    face : (S,) index of the face.
    sign : (S,) 1 where the face's normal points out of the cell, -1 where it points into it.
    """

    mesh: Mesh
    cells: IntArray
    cell: IntArray
    face: IntArray
    sign: FloatArray

    @staticmethod
    def of(mesh: Mesh) -> Sides:
        """Collect the sides of a mesh."""
        cells = mesh.region_ids()
        owner = mesh.regions.T.reshape(-1)
        real = owner != OUTSIDE
        face = np.tile(np.arange(len(mesh.faces)), 2)
        sign = np.repeat([1.0, -1.0], len(mesh.faces))
        return Sides(mesh, cells, np.searchsorted(cells, owner[real]), face[real], sign[real])

    def total(self, values: FloatArray) -> FloatArray:
        """Sum values of sides, (S, ...), over each cell, (C, ...)."""
        flat = values.reshape(len(values), -1)
        sums = [np.bincount(self.cell, column, len(self.cells)) for column in flat.T]
        return np.stack(sums, 1).reshape(len(self.cells), *values.shape[1:]).astype(np.float64)

    def closed(self) -> NDArray[np.bool_]:
        """(C,) whether each cell's surface is closed: an even number of sides at each edge."""
        cell, _, count = self.edges
        odd = np.bincount(cell, count % 2, len(self.cells))
        found: NDArray[np.bool_] = odd == 0
        return found

    @cached_property
    def edges(self) -> tuple[IntArray, IntArray, IntArray]:
        """Cell, edge and number of sides there, for each edge of each cell."""
        keys, count = np.unique(self._keys, return_counts=True)
        cell, edge = np.divmod(keys, len(self.mesh.edges()))
        return cell, edge, count

    @cached_property
    def hinges(self) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        """Cell, edge and the two sides that meet there, if exactly two sides of the cell do."""
        order = np.argsort(self._keys, kind="stable")
        keys, first, count = np.unique(self._keys[order], return_index=True, return_counts=True)
        cell, edge = np.divmod(keys[count == 2], len(self.mesh.edges()))
        first = first[count == 2]
        # Each side has three edges.
        return cell, edge, order[first] // 3, order[first + 1] // 3

    @cached_property
    def _keys(self) -> IntArray:
        edges = self.mesh.face_edges()[self.face]
        return (self.cell[:, None] * len(self.mesh.edges()) + edges).reshape(-1)
