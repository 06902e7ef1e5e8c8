"""How far a surface still is from where the objective is least, at its worst place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ...common.normal import SIGMA_PER_MEDIAN_DEVIATION
from ...geometry.connected import adjacency
from ...geometry.mesh import FloatArray, IntArray, Mesh
from ...geometry.vectors import crossed, lengths

_MOST_RINGS = 4  # of vertices around one that make a patch: finer meshes than that are rare


@dataclass(frozen=True)
class Remaining:
    """What is still to come at one place.

    Attributes
    ----------
    move
        um: displacement of the patch, in the mean.
    gain
        Nats.
    vertex
        In its middle.
    share
        Of all patches: those that would move and gain more than asked.
    drift
        um: how far the surface has moved along its normals over the last few steps: standard
        deviation, from the median.
    """

    move: float
    gain: float
    vertex: int
    share: float = 1.0
    drift: float = 0.0

    def moves(self, tolerance: float, gain: float) -> bool:
        """Whether that is more than um and nats that count as rest."""
        return self.move > tolerance and self.gain > gain and np.isfinite(self.move)


class Patches:
    """Pieces of a surface about as wide as the PSF, one around each vertex.

    Single vertices are no unit: neighbours are nearer to each other than the PSF is wide.
    """

    def __init__(self, mesh: Mesh, width: float) -> None:
        rings = width / max(mesh.median_edge(), 1e-300)
        self._rings = int(np.clip(round(rings), 1, _MOST_RINGS))
        n = len(mesh.vertices)
        self._around: sp.csr_matrix = sp.eye(n, format="csr") + adjacency(mesh)
        self._walks = np.ones(n)
        for _ in range(self._rings):
            self._walks = self._around @ self._walks

    def worst(
        self,
        normals: FloatArray,
        step: FloatArray,
        gradient: FloatArray,
        width: float,
        least: float,
    ) -> Remaining:
        """The patch with most to gain among those that would move by more than ``width`` um.

        Parameters
        ----------
        normals, step, gradient
            (V, 3): of the surface, the step to where the objective is thought to be least, and its
            gradient.
        width
            um.
        least
            Nats that count as a gain.
        """
        each = np.stack([(step * normals).sum(1), -0.5 * (gradient * step).sum(1)], 1)
        # Sums over rings count a vertex several times: as many as there are walks to it.
        along, gain = self.means(each).T
        move, gain = np.abs(along), gain * self._size()
        far = np.where(move > width, gain, -np.inf)
        at = int(np.argmax(far if np.isfinite(far).any() else move))
        share = float(((move > width) & (gain > least)).mean())
        return Remaining(float(move[at]), float(max(gain[at], 0.0)), at, share)

    def means(self, values: FloatArray) -> FloatArray:
        """(V,) or (V, K) means of numbers of each vertex over the patch around it."""
        for _ in range(self._rings):
            values = self._around @ values
        found: FloatArray = (values.T / self._walks).T
        return found

    def _size(self) -> float:
        """Vertices of a patch, about."""
        r = self._rings
        return float(1 + 3 * r * (r + 1))


def vertex_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(V, 3) means of the normals of the faces around each vertex, by area; 0 where there is none.

    At a junction they depend on how its walls are oriented.
    """
    first, second, third = (vertices.T[:, corner] for corner in faces.T)
    rows, n = np.concatenate(faces.T), len(vertices)
    each = crossed(second - first, third - first)
    found: FloatArray = np.stack([np.bincount(rows, np.tile(one, 3), n) for one in each], 1)
    length = lengths(found)[:, None]
    return np.divide(found, length, out=np.zeros_like(found), where=length > 0)


def drifted(moved: FloatArray, normals: FloatArray, mesh: Mesh) -> float:
    """Standard deviation of displacements (V, 3) along normals, from the median of each cell.

    Of the cell that drifts most: a few places of a cell where the image tells little, which wander,
    hardly count. mesh : with these vertices.
    """
    along = np.abs((moved * normals).sum(1))
    cells = list[float]()
    for own in mesh.faces_by_region().values():
        used = np.zeros(len(along), bool)
        used[mesh.faces[own]] = True
        cells.append(float(np.median(along[used])))
    return SIGMA_PER_MEDIAN_DEVIATION * float(max(cells, default=0.0))


def strayed_off(before: Mesh, after: Mesh) -> bool:
    """Whether the bounding box of some cell no longer overlaps with the one it had before.

    A cell overlaps with its start. In a haze, a cell that had left the image explained more of it
    at a blurred level, by its light cone.
    """
    for region in np.intersect1d(before.region_ids(), after.region_ids()).tolist():
        (low, high), (first, last) = (m.region_surface(region).bounds() for m in (before, after))
        if ((first > high) | (last < low)).any():
            return True
    return False
