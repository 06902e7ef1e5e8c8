"""A smooth surface through a coarse mesh: Loop's subdivision, walls and junctions kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from .connected import adjacency
from .mesh import FloatArray, IntArray, Mesh


@dataclass(frozen=True, eq=False)
class Subdivided:
    """A mesh with four times the triangles.

    Attributes
    ----------
    mesh
        The fine one.
    weights
        (fine, coarse) sparse: each fine vertex is a weighted mean of coarse ones, so the same
        matrix carries a displacement of the coarse mesh.
    """

    mesh: Mesh
    weights: sp.csr_matrix

    def again(self) -> Subdivided:
        """Subdivide once more, to four times the triangles."""
        finer = subdivided(self.mesh)
        return Subdivided(finer.mesh, (finer.weights @ self.weights).tocsr())

    def moved(self, coarse: FloatArray) -> Mesh:
        """Return the fine mesh for other positions (V, 3) um of the coarse vertices."""
        return self.mesh.with_vertices(self.weights @ coarse)


def subdivided(mesh: Mesh) -> Subdivided:
    """Apply one step of Loop's scheme.

    Inside a wall the masks are those of C. Loop ("Smooth subdivision surfaces based on triangles",
    1987); along junctions and borders, those of cubic splines, as for creases (H. Hoppe et al.,
    "Piecewise smooth surface reconstruction", 1994); where junctions meet, vertices stay.
    """
    edges, by_face = mesh.edges(), mesh.face_edges()
    inner = mesh.edge_uses() == 2
    weights = sp.vstack([_old(mesh, edges, inner), _new(mesh, edges, by_face, inner)]).tocsr()
    n = len(mesh.vertices)
    a, b, c = mesh.faces.T
    bc, ca, ab = n + by_face.T
    faces = np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])
    faces = faces.transpose(2, 0, 1).reshape(-1, 3)
    regions = np.repeat(mesh.regions, 4, axis=0)
    return Subdivided(Mesh(weights @ mesh.vertices_numpy(), faces, regions), weights)


def _new(mesh: Mesh, edges: IntArray, by_face: IntArray, inner: np.ndarray) -> sp.csr_matrix:
    """Return (E, V) weights of edge points: 3/8 for ends, 1/8 for opposite corners; or 1/2."""
    shape = len(edges), len(mesh.vertices)
    ends = np.where(inner, 3 / 8, 1 / 2)
    rows, columns, values = [], [], []
    for k in range(2):
        rows.append(np.arange(len(edges)))
        columns.append(edges[:, k])
        values.append(ends)
    of_inner = inner[by_face].ravel()
    rows.append(by_face.ravel()[of_inner])
    columns.append(mesh.faces.ravel()[of_inner])
    values.append(np.full(int(of_inner.sum()), 1 / 8))
    flat = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return sp.coo_matrix(flat, shape).tocsr()


def _old(mesh: Mesh, edges: IntArray, inner: np.ndarray) -> sp.csr_matrix:
    """Return (V, V) weights of the vertices that were there before."""
    n = len(mesh.vertices)
    lines = edges[~inner]
    on_lines = np.bincount(lines.ravel(), minlength=n)
    free = on_lines == 0
    around = adjacency(mesh)
    degree = np.maximum(np.asarray(around.sum(1)).ravel(), 1)
    # Warren's simpler weights ("Subdivision methods for geometric design", 1995).
    beta = np.where(degree == 3, 3 / 16, 3 / (8 * degree))
    smooth = sp.diags(free * (1 - degree * beta)) + sp.diags(free * beta) @ around
    along = adjacency(mesh, lines)
    middle = on_lines == 2
    crease = sp.diags(middle * 3 / 4.0) + sp.diags(middle / 8.0) @ along
    return (smooth + crease + sp.diags((~free & ~middle).astype(float))).tocsr()
