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
            return self._in_numpy(vertices)
        given = np.ascontiguousarray(vertices, dtype=np.float64)
        energy, gradient = library.bending(
            given, self._faces, self._smooth, self._wall, self._side, self._walls, self._own
        )
        return energy, gradient

    def _in_numpy(self, vertices: FloatArray) -> tuple[float, FloatArray]:
        """Compute the same as the compiled loops (``csrc/bending.h``)."""
        corners = vertices[self._faces]
        # Edge vectors opposite each corner; the angle at corner p lies between the two others.
        edges = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)
        normal = np.cross(edges[:, 0], edges[:, 1])
        doubled = np.linalg.norm(normal, axis=1)
        if not doubled.sum() > _POINT:
            return 0.0, np.zeros_like(vertices)
        doubled = np.maximum(doubled, _NO_AREA * float(doubled.mean()))
        dots = -np.einsum("fpi,fpi->fp", np.roll(edges, -1, axis=1), np.roll(edges, 1, axis=1))
        raw = dots / doubled[:, None]
        cotangents = np.clip(raw, _LEAST, _LARGEST)

        area = self._at_vertices(np.repeat(doubled / 6, 3).reshape(-1, 3))
        area = np.where(area > 0, area, 1.0)
        half = 0.5 * cotangents[:, :, None] * edges  # of the edge from corner p + 1 to p + 2
        # K of a corner: the edges that end there, each towards the corner.
        own = np.roll(half, -1, axis=1) - np.roll(half, 1, axis=1)
        bend = np.stack([self._at_vertices(own[:, :, i]) for i in range(3)], 1)
        weight = self._smooth / area
        energy = 0.5 * float((weight * (bend**2).sum(1)).sum())

        pull = weight[:, None] * bend
        density = 0.5 * weight / area * (bend**2).sum(1)
        # A third of the area vectors around each vertex, and the mean curvature of its wall.
        vectors = (self._side / 6)[:, None] * normal
        vectors = np.stack(
            [self._at_vertices(np.repeat(v, 3).reshape(-1, 3)) for v in vectors.T], 1
        )
        along = (bend * vectors).sum(1)
        within = self._wall >= 0
        of = self._wall[within]
        whole = np.bincount(of, (weight * along)[within], self._walls)
        held = self._own + np.bincount(of, (self._smooth * area)[within], self._walls)
        mean = whole / np.maximum(held, _POINT)
        energy -= 0.5 * float((whole * mean).sum())
        curved = np.zeros(self._count)
        curved[within] = mean[of]
        pull -= (weight * curved)[:, None] * vectors
        density -= self._smooth * (curved * along / area**2 + 0.5 * curved**2)
        by_vector = -(weight * curved)[:, None] * bend
        at = pull[self._faces]
        # Towards the second end of each edge minus the first, as ``edges`` themselves.
        difference = np.roll(at, 1, axis=1) - np.roll(at, -1, axis=1)
        gradient = 0.5 * cotangents[:, :, None] * difference
        gradient = np.roll(gradient, -1, axis=1) - np.roll(gradient, 1, axis=1)
        free = (raw > _LEAST) & (raw < _LARGEST)
        by_cotangent = 0.5 * free * np.einsum("fpi,fpi->fp", difference, edges)
        gradient += _through_cotangents(by_cotangent, doubled, edges)
        by_area = -density[self._faces].sum(1) / 6 - (by_cotangent * dots).sum(1) / doubled**2
        # d |N| by a corner is the edge opposite it, turned about the normal.
        turned = np.cross((normal / doubled[:, None])[:, None], edges)
        gradient += by_area[:, None, None] * turned
        by_normal = (self._side / 6)[:, None] * by_vector[self._faces].sum(1)
        gradient += np.cross(by_normal[:, None], edges)
        return energy, np.stack([self._at_vertices(gradient[:, :, i]) for i in range(3)], 1)

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


def _through_cotangents(
    by_cotangent: FloatArray, doubled: FloatArray, edges: FloatArray
) -> FloatArray:
    """Return (F, 3, 3) the gradient through the cotangents' dot products, areas held fixed."""
    by_dot = by_cotangent / doubled[:, None]
    # The dot product at corner p is minus that of the edges p + 1 and p + 2.
    to_edges = -(
        np.roll(by_dot, 1, axis=1)[:, :, None] * np.roll(edges, -1, axis=1)
        + np.roll(by_dot, -1, axis=1)[:, :, None] * np.roll(edges, 1, axis=1)
    )
    return np.roll(to_edges, -1, axis=1) - np.roll(to_edges, 1, axis=1)
