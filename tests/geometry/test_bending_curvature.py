"""The second derivatives of the bending energy along normals."""

import numpy as np

from napari_deltamic import Mesh
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.bending import BendingEnergy


def sheet(n=9):
    """A flat mesh of n x n vertices in the plane z = 0."""
    y, x = np.mgrid[:n, :n].reshape(2, -1).astype(float)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + n], 1)
    upper = np.stack([corner + 1, corner + n + 1, corner + n], 1)
    return Mesh(np.stack([np.zeros(n * n), y, x], 1), np.concatenate([lower, upper]))


def test_of_a_flat_sheet_it_is_exact():
    """There nothing bends yet, and the Gauss-Newton part is all there is."""
    mesh = sheet()
    bending = BendingEnergy(mesh)
    normals = np.tile([1.0, 0.0, 0.0], (len(mesh.vertices), 1))
    curvature = bending.curvature(mesh.vertices_numpy(), normals)
    height = 1e-4 * np.random.default_rng(0).normal(size=len(normals))
    energy, _ = bending(mesh.vertices_numpy() + height[:, None] * normals)
    np.testing.assert_allclose(0.5 * height @ curvature @ height, energy, rtol=1e-4)


def test_symmetric_and_nowhere_negative():
    mesh = sphere((0, 0, 0), 2.0, subdivisions=2)
    normals = mesh.vertices_numpy() / 2.0
    matrix = BendingEnergy(mesh).curvature(mesh.vertices_numpy(), normals).toarray()
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
    assert np.linalg.eigvalsh(matrix).min() > -1e-9
