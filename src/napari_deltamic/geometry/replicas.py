"""A fitted surface and displacements that are as likely as it is."""

from __future__ import annotations

from dataclasses import dataclass

from .mesh import FloatArray, Mesh


@dataclass(frozen=True, eq=False)
class Replicas:
    """Surfaces from which the errors of measurements on a fitted surface are estimated.

    Attributes
    ----------
    mesh
        The fitted surface.
    settled
        (V, 3) um: its vertices where the fit would have ended with more iterations.
    smooth
        A smooth surface with the same image, of ``finer`` triangles for each of the mesh.
    refitted
        (V, 3) vertices where a fit of the image of ``smooth`` would end, without noise and prior.
    pulled
        (V, 3) um: the same with the prior.
    scatter
        (K, V, 3) displacements by draws of the noise; each is as likely as its opposite.
    finer
        Triangles of ``smooth`` for one of the mesh.
    """

    mesh: Mesh
    settled: FloatArray
    smooth: Mesh
    refitted: FloatArray
    pulled: FloatArray
    scatter: FloatArray
    finer: int

    def pairs(self) -> list[tuple[Mesh, Mesh]]:
        """Return the mesh with each displacement, paired with its opposite."""
        v, move = self.mesh.vertices_numpy(), self.mesh.with_vertices
        return [(move(v + one), move(v - one)) for one in self.scatter]
