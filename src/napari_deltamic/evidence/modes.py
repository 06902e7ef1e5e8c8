"""Smooth changes of shape, for which an effect that was left out could be mistaken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh

from ..common.choices import DensityModel
from ..geometry.connected import adjacency
from ..geometry.mesh import Mesh
from ..geometry.outwards import out_of
from .evidence_rules import MODES

# Vertices up to which a dense solver is faster, measured on a sphere: 0.005 against 0.014 s at 362,
# 0.032 against 0.022 s at 642, 0.060 against 0.031 s at 812. It also blocks all other threads of
# Python (SciPy's LAPACK keeps the interpreter's lock): with 1500, a window froze for half a second.
_DENSE = 500
_BELOW_ALL = -1e-3  # where eigenvalues are sought: 0 is one, whose matrix could not be inverted


@dataclass(frozen=True)
class ShapeModes:
    """Displacements of the vertices, smooth over each region's surface.

    Attributes
    ----------
    fields
        (K, V, 3) displacements for a coefficient of 1, um; the root mean square of each along the
        normals is 1 um.
    gram
        (K, K) means over the surface of the products of their normal displacements, um^2.
    """

    fields: np.ndarray
    gram: np.ndarray

    def __len__(self) -> int:
        return len(self.fields)

    def displaced(self, vertices: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """(V, 3) vertices displaced by the modes with these coefficients (K,)."""
        return vertices + np.tensordot(coefficients, self.fields, axes=1)

    def size(self, coefficients: np.ndarray) -> float:
        """Root mean square displacement along the normals over the whole surface, um."""
        return float(np.sqrt(max(coefficients @ self.gram @ coefficients, 0.0)))


def shape_modes(
    mesh: Mesh, regions: np.ndarray | None = None, count: int | None = None
) -> ShapeModes:
    """The smoothest displacements of each region's surface along its normals.

    They belong to the lowest eigenvalues of the Laplacian: on a sphere, these are the spherical
    harmonics of lowest degree, that is size, position, stretch, and so on. Shifts and stretches
    along the axes are added explicitly, since on other shapes they are not among them.

    Parameters
    ----------
    mesh
        Closed surfaces.
    regions
        Regions whose modes are wanted; all by default.
    count
        Number of Laplacian modes per region; by default fewer, the more regions there are.
    """
    wanted = mesh.region_ids() if regions is None else regions
    if count is None:
        count = next((n for most, n in MODES.per_region if len(wanted) <= most), MODES.many)
    laplacian = adjacency(mesh)
    fields = [f for r in wanted for f in _of_region(mesh, int(r), laplacian, count)]
    return _normalised(mesh, np.array(fields).reshape(-1, len(mesh.vertices), 3))


def density_fields(mesh: Mesh, model: DensityModel, regions: np.ndarray) -> np.ndarray:
    """(M, F) smooth or piecewise changes of the logarithm of a density; none if it is uniform.

    Parameters
    ----------
    model
        ``"interface"``: one field for each interface; ``"smooth"``: the smoothest fields on the
        surface of each region.
    regions
        Regions whose surfaces may change.
    """
    own = np.isin(mesh.regions, regions).any(1)
    if model == "uniform":
        return np.zeros((0, len(mesh.faces)))
    if model == "interface":
        numbers = mesh.interfaces()[1]
        kept = np.unique(numbers[own])
        # One of them is left out, as the amplitude stands for it.
        return (numbers[None] == kept[1:, None]).astype(float)
    links = adjacency(mesh)
    fields = []
    for region in regions:
        faces = (mesh.regions == region).any(1)
        where = np.unique(mesh.faces[faces])
        scalars = _smoothest(links[where][:, where], min(MODES.density, len(where) - 2))
        for scalar in scalars.T:
            values = np.zeros(len(mesh.vertices))
            values[where] = scalar / max(float(np.abs(scalar).max()), 1e-12)
            fields.append(np.where(faces, values[mesh.faces].mean(1), 0.0))
    # The amplitude stands for the first one.
    return np.array(fields[1:]).reshape(-1, len(mesh.faces))


def _of_region(mesh: Mesh, region: int, links: sp.csr_matrix, count: int) -> list[np.ndarray]:
    """(V, 3) fields that move one region's surface."""
    vertices, where = mesh.vertices_numpy(), np.unique(mesh.faces[mesh.faces_by_region()[region]])
    normal = -out_of(mesh, region)[where]
    scalars = _smoothest(links[where][:, where], min(count, len(where) - 2))
    middle = vertices[where].mean(0)
    fields = []
    for axis in range(3):
        for moved in (np.ones(len(where)), vertices[where, axis] - middle[axis]):
            field = np.zeros_like(vertices)
            field[where, axis] = moved
            fields.append(field)
    for scalar in scalars.T:
        field = np.zeros_like(vertices)
        field[where] = scalar[:, None] * normal
        fields.append(field)
    return fields


def _smoothest(links: sp.csr_matrix, count: int) -> np.ndarray:
    """(n, count) eigenvectors of the graph Laplacian with the lowest eigenvalues."""
    n = links.shape[0]
    laplacian = sp.diags(np.asarray(links.sum(1)).ravel()) - links
    if n <= _DENSE:
        return np.asarray(eigh(laplacian.toarray(), subset_by_index=[0, count - 1])[1])
    start = np.random.default_rng(0).standard_normal(n)  # the same on every run
    values, vectors = eigsh(laplacian.tocsc(), count, sigma=_BELOW_ALL, v0=start)
    return np.asarray(vectors[:, np.argsort(values)])


def _normalised(mesh: Mesh, fields: np.ndarray) -> ShapeModes:
    """Modes from fields, each of size 1, leaving out those that are combinations of others."""
    area = mesh.areas()
    along = np.einsum("kfcd,fd->kf", fields[:, mesh.faces], mesh.normals()) / 3
    along = along * np.sqrt(area / area.sum())
    size = np.linalg.norm(along, axis=1)
    kept: list[int] = []
    basis = np.zeros((0, along.shape[1]))
    for k in range(len(fields)):
        if not size[k] > 0:
            continue
        left = along[k] / size[k]
        left = left - basis.T @ (basis @ left)
        rest = float(np.linalg.norm(left))
        if rest > MODES.alike:
            kept.append(k)
            basis = np.vstack([basis, left / rest])
    fields = fields[kept] / size[kept, None, None]
    along = along[kept] / size[kept, None]
    return ShapeModes(fields, along @ along.T)
