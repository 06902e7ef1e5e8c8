"""Angles at which walls meet along junctions: what surface tensions are read from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..errors import InputError
from ..geometry.contacts import junction_edges
from ..geometry.mesh import FloatArray, IntArray, Mesh

_FLAT = 1e-14  # share of the largest moment of points that is only rounding
# Inverse of the quadratic form B^2 + C^2 - 4 A D.
_PRATT = np.array([[0, 0, 0, -0.5], [0, 1, 0, 0], [0, 0, 1, 0], [-0.5, 0, 0, 0]])


@dataclass(frozen=True)
class JunctionRules:
    """Where the angles at a junction are measured; lengths are in median edges of the mesh.

    Measured on three double bubbles with edges of 0.4 and 0.6 um, without noise and with 20 nm of
    it in the vertices: the largest error is 0.17 and 1.15 degrees.

    Attributes
    ----------
    reach
        How far into a wall its shape is used: with 2.5 the errors are 1.4 and 3.5 degrees, with
        3.5 still 0.35 and 2.4, with 10 only 0.27 and 0.75, on walls as even as these.
    strip
        How far along the junction, to either side: half and twice as much change the errors by at
        most 0.4 degrees.
    line
        Length over which a junction's direction is averaged: half and twice change errors by 0.04.
    fewest
        Least number of points for an arc: it has three parameters, so that as many are left over.
    """

    reach: float = 5.0
    strip: float = 0.75
    line: float = 2.0
    fewest: int = 6


RULES = JunctionRules()


@dataclass(frozen=True)
class Junction:
    """The lines along which three walls meet between the same three regions.

    Attributes
    ----------
    regions : (3,) increasing; 0 is the outside.
    angles : (3,) degrees: the opening of each region at the junction; the mean along it.
    spread : (3,) degrees: standard deviation along the junction.
    length : um, of the part whose angles could be measured.
    correlation : um along it, over which angles are read from the same triangles.
    """

    regions: tuple[int, int, int]
    angles: FloatArray
    spread: FloatArray
    length: float
    correlation: float

    def errors(self, resolution: float = 0.0) -> FloatArray:
        """Return (3,) standard errors of the mean angles, degrees.

        Angles count as one for each stretch within which they are correlated: the length of
        ``correlation`` or of the image's resolution (um), whichever is longer. The spread includes
        real variation of angles along a junction.
        """
        stretches = max(1.0, self.length / max(self.correlation, resolution))
        found: FloatArray = self.spread / np.sqrt(stretches)
        return found


def junction_lengths(mesh: Mesh) -> dict[tuple[int, int, int], float]:
    """Return the whole length (um) along which three regions meet, by their increasing numbers."""
    edges, triples = junction_edges(mesh)
    if not len(edges):
        return {}
    found, index = np.unique(triples, axis=0, return_inverse=True)
    sums = np.bincount(index.reshape(-1), mesh.edge_lengths()[edges])
    return {(a, b, c): s for (a, b, c), s in zip(found.tolist(), sums.tolist(), strict=True)}


def junction_angles(
    mesh: Mesh, reach: float | None = None, avoid: FloatArray | None = None
) -> list[Junction]:
    """Measure the angles between the walls along each junction of three regions.

    Across every edge in which three walls meet, an arc is drawn through each wall, out to
    ``reach``, and its tangent taken at the edge. The triangles beside the edge alone would be off
    by half the angle that they span on a curved wall, and by more where vertices are noisy: a tenth
    of a voxel over three voxels is two degrees.

    Parameters
    ----------
    mesh : closed regions that share walls, um.
    reach : um; how far into a wall its shape is used. By default five edges of the mesh.
    avoid : (N, 3) um: places that the reach must not include, such as faces that close a cell at
        the border of an image, which are no membranes.

    Returns
    -------
    One junction for every three regions that meet and whose angles can be measured, by regions.

    Raises
    ------
    InputError
        If the reach is not positive.
    """
    ends = mesh.vertices_numpy()[mesh.edges()]
    edge = mesh.median_edge()
    reach = angle_reach(mesh) if reach is None else reach
    if not reach > 0:
        raise InputError(f"the reach of junction angles must be positive (um), not {reach}")
    edges, triples = junction_edges(mesh)
    if avoid is not None and len(avoid) and len(edges):
        far = cKDTree(avoid).query(ends[edges].mean(1))[0] > reach
        edges, triples = edges[far], triples[far]
    if not len(edges):
        return []
    walls = _Walls(mesh, reach, RULES.strip * edge)
    found = []
    for triple in np.unique(triples, axis=0):
        line = ends[edges[(triples == triple).all(1)]]
        along = _directions(line, RULES.line * edge)
        openings = _openings(walls, line.mean(1), along, triple)
        known = np.isfinite(openings).all(1)
        length = np.linalg.norm(line[known, 1] - line[known, 0], axis=1)
        if not known.any():
            continue
        weight = length / length.sum()
        mean = weight @ openings[known]
        spread = np.sqrt(weight @ (openings[known] - mean) ** 2)
        a, b, c = (int(r) for r in triple)
        found.append(Junction((a, b, c), mean, spread, float(length.sum()), 2 * RULES.strip * edge))
    return found


def angle_reach(mesh: Mesh) -> float:
    """Return how far (um) into a wall its shape is used by default."""
    return RULES.reach * mesh.median_edge()


def _directions(line: FloatArray, reach: float) -> FloatArray:
    """Return (E, 3) the direction of a junction at each of its edges (E, 2, 3), averaged nearby."""
    middles = line.mean(1)
    step = line[:, 1] - line[:, 0]
    step = step / np.linalg.norm(step, axis=1)[:, None]
    # Edges have no sense of direction; their outer products need none.
    products = step[:, :, None] * step[:, None, :]
    near = cKDTree(middles).query_ball_point(middles, reach)
    directions: FloatArray = np.linalg.eigh([products[k].sum(0) for k in near])[1][..., -1]
    return directions


class _Walls:
    """Points on each wall, and a search for those near a place."""

    def __init__(self, mesh: Mesh, reach: float, strip: float) -> None:
        self.reach, self.strip = reach, strip
        pairs, index = mesh.interfaces()
        corners = mesh.vertices_numpy()[mesh.faces]
        # Corners lie outside a convex wall and middles inside: together they lie on it.
        points = np.concatenate(
            [corners.mean(1), (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3) / 2]
        )
        wall = np.concatenate([index, np.repeat(index, 3)])
        self._points = {
            (int(low), int(high)): points[wall == i] for i, (high, low) in enumerate(pairs)
        }
        self._trees = {pair: cKDTree(points) for pair, points in self._points.items()}

    def near(self, pair: tuple[int, int], places: FloatArray) -> tuple[FloatArray, IntArray]:
        """Find points (N, 3) of the wall between two regions within reach of places (E, 3).

        Also return which place each point belongs to (N,), sorted by place.
        """
        rows = self._trees[pair].query_ball_point(places, self.reach)
        count = [len(each) for each in rows]
        found = np.concatenate(rows).astype(np.int64)
        return self._points[pair][found], np.repeat(np.arange(len(places)), count)


def _openings(
    walls: _Walls, middles: FloatArray, along: FloatArray, triple: IntArray
) -> FloatArray:
    """Return (E, 3) the angle of each region at each edge, degrees; NaN where a wall is too small.

    middles, along : (E, 3) middles of a junction's edges, and its direction there.
    """
    across = np.linalg.svd(along[:, None])[2][:, 1:]  # two directions at right angles to it
    angle = np.empty_like(middles)  # of the wall opposite each region, in the plane across
    for k in range(3):
        low, high = (int(triple[j]) for j in range(3) if j != k)
        p, edge = walls.near((low, high), middles)
        p -= middles[edge]
        beside = np.abs((p * along[edge]).sum(1)) < walls.strip
        p, edge = p[beside], edge[beside]
        tangents = _tangents((across[edge] @ p[:, :, None])[..., 0], edge, len(middles))
        angle[:, k] = np.degrees(np.arctan2(tangents[:, 1], tangents[:, 0]))
    # A region lies between the walls opposite the two others.
    gap = np.abs(angle[:, [1, 2, 0]] - angle[:, [2, 0, 1]]) % 360
    gap = np.minimum(gap, 360 - gap)
    # Where one region opens by more than half a turn, the two others add up to its smaller side.
    wide = gap.sum(1) < 359.9  # rounding: the smaller sides of all three make a full turn otherwise
    widest = gap[wide].argmax(1)
    gap[wide, widest] = 360 - gap[wide, widest]
    gap[~np.isfinite(angle).all(1)] = np.nan
    return gap


def _tangents(points: FloatArray, arc: IntArray, count: int) -> FloatArray:
    """Return (count, 2) directions in which arcs leave the origin, towards their points.

    NaN if an arc has too few points, or all in one place. points : (N, 2). arc : (N,) index of
    the arc that each point belongs to.

    The circle ``A (x^2 + y^2) + B x + C y + D = 0`` of least squares with ``B^2 + C^2 - 4 A D = 1``
    (V. Pratt, "Direct least-squares fitting of algebraic surfaces", 1987), which may be a line
    and hardly bends with noise on short arcs. Its gradient at the origin is (B, C), whether the
    origin lies on it or beside it.
    """
    tangents = np.full((count, 2), np.nan)
    many = np.bincount(arc, minlength=count)
    scale = np.sqrt(np.bincount(arc, (points**2).sum(1), count) / np.maximum(many, 1))
    known = (many >= RULES.fewest) & (scale > 0)
    p = points / np.where(known, scale, 1.0)[arc, None]
    table = np.column_stack([(p**2).sum(1), p, np.ones(len(p))])
    moments = np.empty((count, 4, 4))
    for i, j in np.ndindex(4, 4):
        moments[:, i, j] = np.bincount(arc, table[:, i] * table[:, j], count)
    moments = moments[known] / many[known, None, None]
    middle = moments[:, 1:3, 3]
    values, vectors = np.linalg.eigh(moments)
    # The least of Z'Z under the constraint: an eigenvector of its inverse times the constraint's.
    root = vectors * np.sqrt(np.maximum(values, _FLAT * values[:, 3:]))[:, None]
    inner = root.transpose(0, 2, 1) @ _PRATT @ root
    least, found = np.linalg.eigh((inner + inner.transpose(0, 2, 1)) / 2)
    chosen = found[np.arange(len(found)), :, (least > 0).argmax(1)]
    b, c = ((_PRATT @ root @ chosen[:, :, None])[:, k, 0] for k in (1, 2))
    tangent = np.stack([-c, b], 1) / np.maximum(np.hypot(b, c), _FLAT)[:, None]
    tangent *= np.where((tangent * middle).sum(1) > 0, 1.0, -1.0)[:, None]
    # Points in one point have no direction.
    tangent[(values[:, 1] <= _FLAT * values[:, 3]) | ~(least > 0).any(1)] = np.nan
    tangents[known] = tangent
    return tangents
