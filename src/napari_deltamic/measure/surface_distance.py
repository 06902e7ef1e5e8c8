"""Distances between two surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..errors import InputError
from ..geometry.mesh import FloatArray, IntArray, Mesh

# Point-triangle pairs at a time, and parts of triangles: each takes some 100 bytes, and more would
# not be faster.
_MAX_PAIRS, _MAX_PARTS = 2_000_000, 500_000
_PATIENCE = 256  # nearest sites looked at before 0.1 % is good enough


@dataclass(frozen=True)
class SurfaceDistance:
    """Distances between two surfaces, all in um.

    mean : mean distance from a point of either surface to the nearest point of the other one; both
        surfaces count alike
    p95 : 95 % of the points of both surfaces are nearer to the other one than this
    max : the largest distance found, over points and vertices of both (an estimate, from below,
        of the Hausdorff distance)
    """

    mean: float
    max: float
    p95: float


def surface_distance(mesh_a: Mesh, mesh_b: Mesh, samples: int = 20_000) -> SurfaceDistance:
    """Measure the distances between the surfaces of two meshes, both ways.

    Points are drawn evenly over the area of each surface, the same ones each time; the distance of
    each to the other surface is to its triangles, not to points on it (``distance_to_surface``).
    Walls count once; regions do not matter.

    Parameters
    ----------
    mesh_a, mesh_b : Mesh
    samples : number of points on each surface

    Raises InputError if a mesh has no area or samples is less than 1.
    """
    if samples < 1:
        raise InputError("samples must be 1 or more")
    rng = np.random.default_rng(0)
    ways, farthest = [], 0.0
    for source, target in ((mesh_a, mesh_b), (mesh_b, mesh_a)):
        points = _random_points(source, samples, rng)
        corners = source.vertices_numpy()[np.unique(source.faces)]
        distance = distance_to_surface(np.concatenate([points, corners]), target)
        ways.append(distance[:samples])
        farthest = max(farthest, float(distance.max()))
    both = np.concatenate(ways)
    return SurfaceDistance(float(both.mean()), farthest, float(np.percentile(both, 95)))


def distance_to_surface(points: FloatArray, mesh: Mesh) -> FloatArray:
    """Return the distance of points (N, 3) um Z, Y, X to the nearest triangle, (N,) um.

    Exact, but for points almost equally far from hundreds of places (the centre of a sphere),
    where the search may stop once the answer is certain to 0.1 %.
    """
    triangles = mesh.vertices_numpy()[mesh.faces]
    sites, radius, owner = _sites(mesh)
    tree = cKDTree(sites)
    best = np.full(len(points), np.inf)
    left = np.arange(len(points))
    n_near = 16
    # The nearest point of the surface lies within a face, within an edge, or at a vertex. Seen
    # from it, the query is at a right angle to that face or edge, and a site of the same face or
    # edge is at most radius away: so the site is at most sqrt(best**2 + radius**2) from the query.
    while len(left):
        n_near = min(n_near, len(sites))
        slack = 1.0 if n_near < _PATIENCE else 0.999  # good enough then
        unresolved = []
        for chunk in np.array_split(left, max(1, len(left) * n_near // _MAX_PAIRS)):
            reach, near = tree.query(points[chunk], k=np.arange(1, n_near + 1))
            # The nearest site first: it rules out most of the others.
            first = _point_triangle(points[chunk], triangles[owner[near[:, 0]]])
            best[chunk] = np.minimum(best[chunk], first)
            row, column = np.nonzero(reach <= np.hypot(best[chunk], radius)[:, None])
            distance = _point_triangle(points[chunk[row]], triangles[owner[near[row, column]]])
            np.minimum.at(best, chunk[row], distance)
            unresolved.append(chunk[reach[:, -1] <= np.hypot(slack * best[chunk], radius)])
        if n_near == len(sites):
            break
        left = np.concatenate(unresolved)
        n_near *= 4
    return best


def _random_points(mesh: Mesh, n: int, rng: np.random.Generator) -> FloatArray:
    areas = mesh.areas()
    total = areas.sum()
    if not total > 0:
        raise InputError("the mesh has no area, so it has no distance to another surface")
    corners = mesh.vertices_numpy()[mesh.faces[rng.choice(len(areas), n, p=areas / total)]]
    u, v = np.sqrt(rng.random(n)), rng.random(n)
    weights = np.stack([1 - u, u * (1 - v), u * v], axis=1)
    return np.einsum("nc,nci->ni", weights, corners)


def _sites(mesh: Mesh) -> tuple[FloatArray, float, IntArray]:
    """Return points for the search: sites (P, 3), their largest radius, a triangle of each (P,).

    Every vertex, the middle of every part of an edge, the middle of every part of a face; parts
    are about equally large, since the largest radius of a part bounds the search.
    """
    vertices, edges = mesh.vertices_numpy(), mesh.edges()
    triangles = vertices[mesh.faces]
    limit = 2.0 * np.sqrt(mesh.areas().sum() / max(len(triangles), 2000))
    limit = max(float(limit), float(_edges(triangles).max()) / 1000)

    corners, first_corner = np.unique(mesh.faces, return_index=True)
    _, first_edge = np.unique(mesh.face_edges(), return_index=True)
    start, along = vertices[edges[:, 0]], vertices[edges[:, 1]] - vertices[edges[:, 0]]
    length = np.linalg.norm(along, axis=1)
    n_parts = np.maximum(1, np.ceil(length / limit)).astype(np.int64)
    edge = np.repeat(np.arange(len(edges)), n_parts)
    place = np.arange(len(edge)) - np.repeat(np.cumsum(n_parts) - n_parts, n_parts)
    middles = start[edge] + along[edge] * ((place + 0.5) / n_parts[edge])[:, None]

    centers, radius, owner = _parts(triangles, limit)
    return (
        np.concatenate([vertices[corners], middles, centers]),
        # Rounding must not exclude a site.
        max(radius, float((length / n_parts).max()) / 2) * (1 + 1e-9),  # rounding
        np.concatenate([first_corner // 3, first_edge[edge] // 3, owner]),
    )


def _parts(triangles: FloatArray, limit: float) -> tuple[FloatArray, float, IntArray]:
    """Cut triangles until no edge is over the limit: centres, largest radius, triangle of each."""
    owner = np.arange(len(triangles))
    while len(triangles) < _MAX_PARTS:
        edges = _edges(triangles)
        large = edges.max(axis=1) > limit
        if not large.any():
            break
        # Halve at the middle of the longest edge, which is opposite corner k.
        part, k, rows = triangles[large], edges[large].argmax(axis=1), np.arange(large.sum())
        middle = (part[rows, (k + 1) % 3] + part[rows, (k + 2) % 3]) / 2
        halves = [part.copy(), part.copy()]
        for half, end in zip(halves, (1, 2), strict=True):
            half[rows, (k + end) % 3] = middle
        triangles = np.concatenate([triangles[~large], *halves])
        owner = np.concatenate([owner[~large], owner[large], owner[large]])
    centers = triangles.mean(axis=1)
    radius = np.linalg.norm(triangles - centers[:, None], axis=2).max()
    return centers, float(radius), owner


def _edges(triangles: FloatArray) -> FloatArray:
    """Return edge lengths, (T, 3), each opposite its corner."""
    return np.linalg.norm(np.roll(triangles, -1, axis=1) - np.roll(triangles, -2, axis=1), axis=2)


def _point_triangle(points: FloatArray, triangles: FloatArray) -> FloatArray:
    """Return the distance of point n to triangle n; triangles (N, 3, 3) may be degenerate."""
    arms = points[:, None] - triangles
    edges = np.roll(triangles, -1, axis=1) - triangles
    # To the three edges, as segments.
    squared = np.einsum("nci,nci->nc", edges, edges)
    along = np.einsum("nci,nci->nc", arms, edges)
    t = np.divide(along, squared, out=np.zeros_like(along), where=squared > 0).clip(0, 1)
    distance = np.linalg.norm(arms - t[..., None] * edges, axis=2).min(axis=1)
    # To the plane, where the foot of the perpendicular is inside.
    normal = np.cross(edges[:, 0], edges[:, 1])
    length = np.linalg.norm(normal, axis=1)
    side = np.einsum("nci,ni->nc", np.cross(edges, arms), normal)
    inside = (side >= 0).all(axis=1) & (length > 0)
    height = np.abs(np.einsum("ni,ni->n", arms[:, 0], normal))
    return np.where(inside, height / np.where(length > 0, length, 1), distance)
