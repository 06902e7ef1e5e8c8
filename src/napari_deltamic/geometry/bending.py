"""The bending energy of a surface: a weak prior on shape, the same on coarse and fine meshes."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from .compiled import native
from .connected import connected
from .mesh import FloatArray, IntArray, Mesh

# Cotangents beyond these belong to slivers, whose curvature says nothing about the surface.
_LEAST, _LARGEST = -2.0, 4.0
# Share of the mean area per vertex. The energy divides by a vertex's area: without a bound,
# vertices among slivers would be held hardest, where the curvature tells least about the surface.
_SMALL = 0.25
# Area, in squares of the PSF's width, at which a wall's own mean curvature counts half; chosen: the
# area within two widths, as a smaller piece of surface cannot be told from its blur.
_OWN = 4 * np.pi
_POINT = 1e-100  # um^2: a surface without area has no curvature
_NO_AREA = 1e-12  # of the mean area: a face without area has no cotangents


class BendingEnergy:
    """``1/2 integral of |2 H|^2 dA`` over the walls of a mesh; blind at junctions and borders.

    It has no unit and no scale (8 pi for any sphere), so that its weight is a pure number. With
    ``K_i = 1/2 sum over edges of (cot a + cot b) (x_i - x_j)`` and A_i a third of the area around a
    vertex it is ``1/2 sum over vertices of |K_i|^2 / A_i`` (M. Meyer et al., "Discrete
    differential-geometry operators for triangulated 2-manifolds", 2003).

    For a wall that ends at junctions, only the deviation of its curvature from its own mean counts:
    ``1/2 integral of |2 H - c|^2 dA + 1/2 own c^2``, at the c that minimises it, is the energy less
    ``1/2 M^2 / (S + own)``, with M the integral of 2 H and S the area. Tension and pressure make
    walls of even curvature; if that were penalised, a cap would grow at the cost of its rim.

    Parameters
    ----------
    mesh
        Only its connectivity and areas are used. A vertex counts if all its edges belong to exactly
        two faces, and less where it has hardly any area.
    width
        um, of the PSF: walls much smaller than that have no mean curvature of their own. None: no
        wall has one.
    """

    def __init__(self, mesh: Mesh, width: float | None = None) -> None:
        self._faces: IntArray = np.ascontiguousarray(mesh.faces)
        self._count = len(mesh.vertices)
        uses = mesh.edge_uses()
        smooth = np.zeros(self._count)
        smooth[mesh.faces.ravel()] = 1.0
        smooth[mesh.edges()[uses != 2].ravel()] = 0.0
        share = self._at_vertices(np.repeat(mesh.areas() / 3, 3).reshape(-1, 3))
        least = _SMALL * float(mesh.areas().sum()) / max(int(np.count_nonzero(share)), 1)
        self._smooth = smooth * np.minimum(1.0, share / max(least, 1e-300)) ** 2
        self._own = 0.0 if width is None else _OWN * width**2
        self._wall, self._side, self._walls = self._bounded_walls(mesh, uses, width is not None)

    def _bounded_walls(
        self, mesh: Mesh, uses: IntArray, asked: bool
    ) -> tuple[IntArray, FloatArray, int]:
        """Number the walls that end at junctions or borders.

        Return (V,) the number of the wall that each vertex lies within, -1 for none or a closed
        one; (F,) the sign of each face's normal, the same throughout a wall; and their number.
        """
        none: IntArray = np.full(self._count, -1, np.int64)
        side = np.where(mesh.regions[:, 0] <= mesh.regions[:, 1], 1.0, -1.0)
        if not asked or (uses == 2).all():
            return none, side, 0
        by_edge, count = mesh.face_edges(), len(self._faces)
        links = np.stack([np.repeat(np.arange(count), 3), count + by_edge.ravel()], 1)
        group = connected(links[uses[by_edge.ravel()] == 2], count + len(uses))[:count]
        bounded, number = np.unique(group[(uses[by_edge] != 2).any(1)]), none
        rank = np.searchsorted(bounded, group).clip(0, len(bounded) - 1)
        number[self._faces.ravel()] = np.where(bounded[rank] == group, rank, -1).repeat(3)
        number[self._smooth == 0] = -1
        return number, side, len(bounded)

    def __call__(self, vertices: FloatArray) -> tuple[float, FloatArray]:
        """The energy and its gradient (V, 3) 1/um, at vertices (V, 3) um."""
        library = native()
        if library is None:
            return self._in_torch(vertices)
        given = np.ascontiguousarray(vertices, dtype=np.float64)
        energy, gradient = library.bending(
            given, self._faces, self._smooth, self._wall, self._side, self._walls, self._own
        )
        return energy, gradient

    def _in_torch(self, vertices: FloatArray) -> tuple[float, FloatArray]:
        """Compute the same as the compiled loops (``csrc/bending.h``)."""
        import torch  # only where it is needed, as it takes a second

        x = torch.tensor(vertices, dtype=torch.float64, requires_grad=True)
        faces, smooth, side = map(torch.from_numpy, (self._faces, self._smooth, self._side))
        corners = x[faces]
        # Edge vectors opposite each corner; the angle at corner p lies between the two others.
        edges = corners.roll(1, 1) - corners.roll(-1, 1)
        normal = torch.linalg.cross(edges[:, 0], edges[:, 1])
        doubled = torch.linalg.vector_norm(normal, dim=1)
        if not doubled.sum().item() > _POINT:
            return 0.0, np.zeros_like(vertices)
        doubled = doubled.clamp(min=_NO_AREA * doubled.mean().item())
        dots = -(edges.roll(-1, 1) * edges.roll(1, 1)).sum(2)
        half = 0.5 * (dots / doubled[:, None]).clamp(_LEAST, _LARGEST)[..., None] * edges

        def at_vertices(of_corners: torch.Tensor) -> torch.Tensor:
            whole = of_corners.new_zeros(self._count, of_corners.shape[2])
            return whole.index_add(0, faces.reshape(-1), of_corners.flatten(0, 1))

        area = at_vertices((doubled / 6)[:, None, None].expand(-1, 3, 1))[:, 0]
        area = torch.where(area > 0, area, 1.0)
        # K of a corner: the edges that end there, each towards the corner.
        bend = at_vertices(half.roll(-1, 1) - half.roll(1, 1))
        weight = smooth / area
        energy = 0.5 * (weight * (bend**2).sum(1)).sum()
        # A third of the area vectors around each vertex, and the mean curvature of its wall.
        vectors = at_vertices(((side / 6)[:, None] * normal)[:, None].expand(-1, 3, 3))
        within = torch.from_numpy(self._wall >= 0)
        of, none = torch.from_numpy(self._wall)[within], x.new_zeros(self._walls)
        whole = none.index_add(0, of, (weight * (bend * vectors).sum(1))[within])
        held = self._own + none.index_add(0, of, (smooth * area)[within])
        energy = energy - 0.5 * (whole**2 / held.clamp(min=_POINT)).sum()
        (gradient,) = torch.autograd.grad(energy, x)
        return energy.item(), gradient.numpy()

    def curvature(self, vertices: FloatArray, directions: FloatArray) -> sp.csr_matrix:
        """Return (V, V) Gauss-Newton second derivatives, 1/um^2, for one displacement a vertex.

        ``sum over z, y, x of Q' Q`` with ``Q = A^-1/2 L diag(direction)``, L the matrix of
        cotangents: areas and cotangents are held fixed. Symmetric and positive semidefinite. The
        term of a wall's own mean curvature is not subtracted: errors were the same either way.

        Parameters
        ----------
        vertices
            (V, 3) um.
        directions
            (V, 3) unit vectors along which vertices move.
        """
        corners = vertices[self._faces]
        edges = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)
        doubled = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
        doubled = np.maximum(doubled, max(_NO_AREA * float(doubled.mean()), 1e-300))
        dots = -np.einsum("fpi,fpi->fp", np.roll(edges, -1, axis=1), np.roll(edges, 1, axis=1))
        half = 0.5 * np.clip(dots / doubled[:, None], _LEAST, _LARGEST).ravel()
        # Ends of the edge opposite each corner.
        first = np.roll(self._faces, -1, axis=1).ravel()
        second = np.roll(self._faces, 1, axis=1).ravel()
        shape = self._count, self._count
        across = sp.coo_matrix((half, (first, second)), shape).tocsr()
        across = across + across.T
        stiff = sp.diags(np.asarray(across.sum(1)).ravel()) - across
        area = self._at_vertices(np.repeat(doubled / 6, 3).reshape(-1, 3))
        weight = self._smooth / np.where(area > 0, area, 1.0)
        bend = (stiff.T @ sp.diags(weight) @ stiff).tocoo()
        along = (directions[bend.row] * directions[bend.col]).sum(1)
        return sp.coo_matrix((bend.data * along, (bend.row, bend.col)), shape).tocsr()

    def _at_vertices(self, of_corners: FloatArray) -> FloatArray:
        summed = np.bincount(self._faces.ravel(), of_corners.ravel(), self._count)
        return np.asarray(summed, dtype=np.float64)
