"""The bending energy of cells as closed bodies: a weak prior for images without bright walls."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from .bending import BendingEnergy
from .mesh import OUTSIDE, FloatArray, Mesh


class CellBending:
    """The sum of :class:`~.bending.BendingEnergy` over the closed surface of each cell.

    A wall that two cells share counts once for each, and junctions bend like any other place.
    Where membranes shine that would be wrong: walls meet at angles, which the image shows. Where
    only insides shine, a wall between two equally bright cells does not show at all; left free at
    its junctions, it wandered through both.

    Parameters
    ----------
    mesh
        Only its connectivity and areas are used. Without walls between cells the energy is that of
        its surface.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._count = len(mesh.vertices)
        face, side = np.nonzero(mesh.regions != OUTSIDE)
        cell = np.unique(mesh.regions[face, side], return_inverse=True)[1]
        # A vertex of the mesh becomes one vertex for each cell that it belongs to.
        own = cell[:, None] * self._count + mesh.faces[face]
        used, corners = np.unique(own, return_inverse=True)
        self._vertices = used % self._count  # of the mesh, for each vertex of a cell
        places = mesh.vertices_numpy()[self._vertices]
        self._apart = BendingEnergy(Mesh(places, corners.reshape(-1, 3)))

    def __call__(self, vertices: FloatArray) -> tuple[float, FloatArray]:
        """The energy and its gradient (V, 3) 1/um, at vertices (V, 3) um."""
        energy, by_cells = self._apart(vertices[self._vertices])
        columns = (np.bincount(self._vertices, own, self._count) for own in by_cells.T)
        return energy, np.stack(list(columns), 1)

    def curvature(self, vertices: FloatArray, directions: FloatArray) -> sp.csr_matrix:
        """Return (V, V) Gauss-Newton second derivatives, 1/um^2, as `BendingEnergy` does.

        vertices : (V, 3) um. directions : (V, 3) unit vectors along which vertices move.
        """
        by_cells = self._apart.curvature(vertices[self._vertices], directions[self._vertices])
        copies = len(self._vertices)
        ones, each = np.ones(copies), np.arange(copies)
        gathered = sp.csr_matrix((ones, (self._vertices, each)), (self._count, copies))
        return sp.csr_matrix(gathered @ by_cells @ gathered.T)
