"""Make the windings of a mesh agree, region by region."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import (
    breadth_first_order,
    connected_components,
)

from ..errors import RepairWarning
from .mesh import OUTSIDE, FloatArray, IntArray, Mesh

BoolArray = NDArray[np.bool_]
Links = tuple[IntArray, IntArray, IntArray]  # first, second, +1: turn both or neither; -1: one
Meeting = tuple[IntArray, IntArray, IntArray]  # faces, directions, edge


def fix_windings(mesh: Mesh) -> tuple[Mesh, list[str]]:
    """Turn faces so that each region has one consistently oriented, outward surface.

    Across an edge that two faces of a region share, both must run through it in opposite
    directions; this is propagated over all regions, thus also through the junctions where walls
    meet. Pieces that end where more faces of a region meet are then joined there: as they are if
    their directions balance, else in turns by the angle around the edge. Each closed piece is
    turned outward by its signed volume; one that lies inside another and points inward is a
    cavity, and stays. A piece that is not closed follows the majority of its faces.

    Parameters
    ----------
    mesh : Mesh
        With the larger region number first in each row of its regions (as ``repair`` makes it).

    Returns
    -------
    mesh : Mesh
        The same object if nothing had to be turned.
    messages : list of str
        What was changed, and what could not be.
    """
    # By rank: a region number may be anything.
    numbers = np.unique(np.append(mesh.regions.ravel(), OUTSIDE))
    if numbers[-1] >= len(numbers):
        ranked = Mesh(mesh.vertices, mesh.faces, np.searchsorted(numbers, mesh.regions))
        fixed, messages = fix_windings(ranked)
        same = fixed is ranked
        return mesh if same else Mesh(fixed.vertices, fixed.faces, mesh.regions), messages
    two, _ = _meetings(mesh)
    sign, piece = _propagate(len(mesh.faces), *two)
    n_left = int((sign[two[0]] * sign[two[1]] != two[2]).sum())
    sign = _as_most(sign, piece)
    unclosed = ~_closed(mesh, piece)[piece]
    if unclosed.any():
        joined = _turned(mesh, sign)
        piece_sign, group = _propagate(int(piece.max()) + 1, *_joints(joined, piece, unclosed))
        sign, piece = sign * piece_sign[piece], group[piece]
        sign = _as_most(sign, piece)
    n_wrong = int((sign < 0).sum())
    inside_out = _inside_out(mesh, sign, piece)
    result = _turned(mesh, np.where(inside_out[piece], -sign, sign))

    messages = []
    if n_wrong:
        messages.append(f"turned {n_wrong} wrongly wound face{'s' * (n_wrong > 1)}")
    if inside_out.any():
        n, n_faces = int(inside_out.sum()), int(inside_out[piece].sum())
        messages.append(f"turned {n} inside-out surface{'s' * (n > 1)} ({n_faces} faces)")
    if n_left:
        messages.append(
            f"windings still disagree at {n_left} edge{'s' * (n_left > 1)}: the surface is "
            "one-sided there, or its regions are wrongly named"
        )
    return result, messages


def right_side_out(mesh: Mesh) -> Mesh:
    """Turn closed regions that are inside out; a RepairWarning says what was done.

    Returns the same object if nothing had to be turned. Faces keep their order.
    """
    negative = [region for region, volume in mesh.volumes().items() if volume < 0]
    if not any(mesh.is_closed(region) for region in negative):
        return mesh
    larger_second = mesh.regions[:, 0] < mesh.regions[:, 1]
    ordered = Mesh(
        mesh.vertices,
        np.where(larger_second[:, None], mesh.faces[:, ::-1], mesh.faces),
        np.where(larger_second[:, None], mesh.regions[:, ::-1], mesh.regions),
    )
    fixed, messages = fix_windings(ordered)
    if fixed is ordered:
        return mesh
    for message in messages:
        warnings.warn(f"the mesh: {message}", RepairWarning, stacklevel=3)
    return fixed


def _turned(mesh: Mesh, sign: IntArray) -> Mesh:
    if (sign > 0).all():
        return mesh
    faces = np.where((sign < 0)[:, None], mesh.faces[:, ::-1], mesh.faces)
    return Mesh(mesh.vertices, faces, mesh.regions)


def _as_most(sign: IntArray, piece: IntArray) -> IntArray:
    """Turn each piece as most of its faces are wound in the file."""
    opposed = 2 * np.bincount(piece, sign < 0) > np.bincount(piece)
    return np.where(opposed[piece], -sign, sign)


# ---- which faces constrain each other -----------------------------------------------------------


def _meetings(mesh: Mesh, among: BoolArray | None = None) -> tuple[Links, list[Meeting]]:
    """Find where faces of one region meet in an edge, among all faces or some.

    Returns links for the edges where two meet, and (faces, directions, edge) where a larger even
    number does. A direction is +1 or -1: which way the face runs through the edge, seen from
    outside the region.
    """
    n_faces, n_edges = mesh.faces.shape[0], len(mesh.edges())
    face = np.tile(np.repeat(np.arange(n_faces), 3), 2)
    ends = mesh.faces[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2)
    along = np.where(ends[:, 0] < ends[:, 1], 1, -1)
    direction = np.concatenate([along, -along])  # seen from side b, a face runs the other way
    region = np.repeat(mesh.regions.T.reshape(-1), 3)
    key = region * n_edges + np.tile(mesh.face_edges().reshape(-1), 2)
    keep = region != OUTSIDE
    if among is not None:
        keep &= among[face]
    order = np.nonzero(keep)[0]
    order = order[np.argsort(key[order], kind="stable")]
    key, face, direction = key[order], face[order], direction[order]
    start = np.nonzero(np.r_[True, key[1:] != key[:-1]])[0]
    count = np.diff(np.r_[start, len(key)])

    two = start[count == 2]
    links = (face[two], face[two + 1], -direction[two] * direction[two + 1])
    many = (count > 2) & (count % 2 == 0)
    meetings = []
    for begin, n in zip(start[many].tolist(), count[many].tolist(), strict=True):
        rows = slice(begin, begin + n)
        meetings.append((face[rows], direction[rows], mesh.edges()[key[begin] % n_edges]))
    return links, meetings


def _joints(mesh: Mesh, piece: IntArray, among: BoolArray) -> Links:
    """Return how pieces constrain each other, by a vote of the edges in which they meet."""
    links, meetings = _meetings(mesh, among)
    first, second, agree = [links[0]], [links[1]], [links[2]]
    for faces, direction, edge in meetings:
        if direction.sum() == 0:
            relation = np.ones(len(faces) - 1, dtype=np.int64)
        else:
            order = np.argsort(_angles(mesh, faces, edge), kind="stable")
            faces, direction = faces[order], direction[order]
            relation = -direction[:-1] * direction[1:]
        first.append(faces[:-1])
        second.append(faces[1:])
        agree.append(relation)
    a, b = piece[np.concatenate(first)], piece[np.concatenate(second)]
    size = int(piece.max()) + 1
    votes = coo_matrix(
        (np.concatenate(agree), (np.minimum(a, b), np.maximum(a, b))), shape=(size, size)
    ).tocsr()  # sums the votes of a pair
    votes = votes.tocoo()
    use = (votes.row != votes.col) & (votes.data != 0)
    return votes.row[use], votes.col[use], np.sign(votes.data[use])


def _angles(mesh: Mesh, faces: IntArray, edge: IntArray) -> FloatArray:
    """Return the angle of each face around an edge that they share, from the first face on."""
    vertices = mesh.vertices_numpy()
    corners = mesh.faces[faces]
    apex = corners[~np.isin(corners, edge)]
    axis = vertices[edge[1]] - vertices[edge[0]]
    axis /= np.linalg.norm(axis)
    arms = vertices[apex] - vertices[edge[0]]
    arms -= (arms @ axis)[:, None] * axis
    other = np.cross(axis, arms[0])
    return np.arctan2(arms @ other, arms @ arms[0]) % (2 * np.pi)


def _propagate(
    n_nodes: int, first: IntArray, second: IntArray, agree: IntArray
) -> tuple[IntArray, IntArray]:
    """Return a sign for each node that obeys the links of a spanning tree, and its group."""
    root = n_nodes  # one more node, joined to each group, so that a single search reaches all
    low, high = np.minimum(first, second).astype(np.int64), np.maximum(first, second)
    keys, where = np.unique(low * (n_nodes + 1) + high, return_index=True)
    low, high, agree = low[where], high[where], agree[where]
    graph = coo_matrix((np.ones(len(low)), (low, high)), shape=(n_nodes, n_nodes))
    n_groups, group = connected_components(graph, directed=False)
    _, heads = np.unique(group, return_index=True)
    rows, columns = np.r_[low, heads], np.r_[high, np.full(n_groups, root)]
    search = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(root + 1, root + 1))
    _, parent = breadth_first_order(search.tocsr(), root, directed=False)
    parent = parent.astype(np.int64)
    parent[root] = root
    child = np.nonzero(parent != root)[0]
    above = parent[child]
    sign = np.ones(root + 1, dtype=np.int64)
    wanted = np.minimum(child, above) * (n_nodes + 1) + np.maximum(child, above)
    sign[child] = agree[np.searchsorted(keys, wanted)]
    while (parent != root).any():  # each round doubles how far a node looks up the tree
        sign, parent = sign * sign[parent], parent[parent]
    return sign[:-1], group.astype(np.int64)


# ---- which pieces point inward ------------------------------------------------------------------


def _inside_out(mesh: Mesh, sign: IntArray, piece: IntArray) -> BoolArray:
    """Return (P,) which closed pieces point inward without being a cavity."""
    n_pieces = int(piece.max()) + 1
    n_regions = int(mesh.regions.max()) + 1
    per_face = _volumes_about_pieces(mesh, piece) * sign
    inner, outer = (piece * n_regions + mesh.regions[:, side] for side in (0, 1))
    n_slots = n_pieces * n_regions
    volume = np.bincount(inner, per_face, n_slots) - np.bincount(outer, per_face, n_slots)
    volume = volume.reshape(n_pieces, -1)
    present = (np.bincount(inner, minlength=n_slots) + np.bincount(outer, minlength=n_slots)) > 0
    present = present.reshape(n_pieces, -1)
    container = np.where(present[:, OUTSIDE], OUTSIDE, -1)
    if (container < 0).any():
        # A piece that bounds only cells lies in the region that reaches farthest.
        extent = np.where(present, _extents(mesh, n_regions), -1)
        container = np.where(container < 0, extent.argmax(axis=1), container)
    # What surrounds a piece has a negative volume in it. Rounding of a flat one is no volume.
    noise = 1e-12 * np.bincount(piece, np.abs(per_face), n_pieces)
    wrong = volume[np.arange(n_pieces), container] > noise
    wrong &= _closed(mesh, piece)
    for p in np.nonzero(wrong & (container == OUTSIDE))[0]:
        wrong[p] = not _is_cavity(mesh, sign, piece, int(p))
    return wrong


def _volumes_about_pieces(mesh: Mesh, piece: IntArray) -> FloatArray:
    """Return the volume between each face and a point of its piece; exact far from the origin."""
    corners = mesh.vertices_numpy()[mesh.faces]
    _, heads = np.unique(piece, return_index=True)
    corners = corners - corners[heads, :1][piece]
    return -np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0


def _extents(mesh: Mesh, n_regions: int) -> FloatArray:
    """Return (R,) the diagonal (um) of the box around each region; -1 if it has no face."""
    corners = mesh.vertices_numpy()[mesh.faces]
    low, high = np.full((n_regions, 3), np.inf), np.full((n_regions, 3), -np.inf)
    for side in (0, 1):
        np.minimum.at(low, mesh.regions[:, side], corners.min(1))
        np.maximum.at(high, mesh.regions[:, side], corners.max(1))
    there = low[:, 0] <= high[:, 0]
    return np.where(there, np.linalg.norm(np.where(there[:, None], high - low, 0), axis=1), -1)


def _closed(mesh: Mesh, piece: IntArray) -> BoolArray:
    """Return (P,) which pieces have an even number of faces of each region at each edge."""
    n_pieces = int(piece.max()) + 1
    n_edges = len(mesh.edges())
    n_regions = int(mesh.regions.max()) + 1
    keys = [
        (piece * n_regions + mesh.regions[:, side])[:, None] * n_edges + mesh.face_edges()
        for side in (0, 1)
    ]
    key, count = np.unique(np.concatenate(keys), return_counts=True)
    closed = np.ones(n_pieces, dtype=bool)
    closed[key[count % 2 == 1] // n_edges // n_regions] = False
    return closed


def _is_cavity(mesh: Mesh, sign: IntArray, piece: IntArray, p: int) -> bool:
    """True if piece p lies inside another piece that bounds the same region."""
    own = piece == p
    vertices = mesh.vertices_numpy()
    shared = np.isin(mesh.regions, np.setdiff1d(mesh.regions[own], [OUTSIDE])).any(axis=1)
    others = shared & ~own
    point = vertices[mesh.faces[own][0, 0]]
    arms = vertices[mesh.faces[others]] - point
    lengths = np.linalg.norm(arms, axis=2)
    a, b, c = arms[:, 0], arms[:, 1], arms[:, 2]
    # The solid angle of each triangle; a closed surface around the point adds up to 4 pi.
    above = np.einsum("fi,fi->f", a, np.cross(b, c))
    below = lengths.prod(axis=1)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        below = below + np.einsum("fi,fi->f", arms[:, i], arms[:, j]) * lengths[:, k]
    angle = 2 * np.arctan2(above, below) * sign[others]
    turns = np.bincount(piece[others], angle, int(piece.max()) + 1) / (4 * np.pi)
    return bool((np.abs(turns) > 0.5).any())
