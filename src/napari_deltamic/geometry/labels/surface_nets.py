"""A closed, smooth, even surface around a mask of voxels (surface nets on a grid of its own)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array

from ..distance_transform import distance_transform
from ..mesh import FloatArray, IntArray
from .dual_net import NETS, TRIANGLES, check_nodes, dual_net, field_smoothing
from .voxels import largest_part

Mask = NDArray[np.bool_]


def closed_surface(
    mask: Mask, size: FloatArray, origin: FloatArray, edge: float, thin: bool = False
) -> tuple[FloatArray, IntArray] | None:
    """Make the closed, outward surface of a mask's largest part; None if the grid misses it.

    thin : see :func:`~.dual_net.field_smoothing`.
    """
    spacing = NETS.spacing * edge
    sigma = field_smoothing(size, spacing, thin)
    extent = np.array(mask.shape) * size
    if extent.max() < spacing:
        return None
    check_nodes((extent + 6 * sigma) / spacing + 5, edge)
    room = np.ceil((3 * sigma + 2 * spacing) / size).astype(int) + 1
    solid = ndimage.binary_fill_holes(largest_part(np.pad(mask, [(int(r),) * 2 for r in room])))
    solid = _without_fins(solid, 0.5 * edge, size)
    corner = origin - room * size
    distance = distance_transform(solid, size)
    distance -= distance_transform(~solid, size)
    best = None
    for factor in NETS.smoother:
        field = ndimage.gaussian_filter(distance, factor * sigma / size)
        # Smoothing pulls convex surfaces in; the level that keeps the volume puts them back.
        field -= np.partition(field, -int(solid.sum()), axis=None)[-int(solid.sum())]
        surface = _surface_net(field, size, spacing)
        if surface is None:
            continue
        vertices, faces = surface
        best = best or (vertices + corner, faces)
        if 2 * len(vertices) - len(faces) == 4:  # closed triangles: Euler number 2
            return vertices + corner, faces
    return best


def _without_fins(solid: Mask, radius: float, size: FloatArray) -> Mask:
    """Take away parts too thin for the mesh (an opening by a ball), unless much would go."""
    kept = distance_transform(solid, size) > radius
    if kept.any():
        kept = largest_part(distance_transform(~kept, size) <= radius)
    return kept if kept.sum() > NETS.kept * solid.sum() else solid


def _surface_net(
    field: FloatArray, size: FloatArray, spacing: float
) -> tuple[FloatArray, IntArray] | None:
    """Draw the zero surface of a field (positive inside) by a dual grid of some spacing."""
    extent = (np.array(field.shape) - 1) * size
    axes = [np.arange(0, length + spacing, spacing) for length in extent]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"))
    values = _sample(field, nodes.reshape(3, -1).T, size).reshape(nodes.shape[1:])
    inside = _well_composed(largest_part(values > 0))
    if not inside.any():
        return None
    # The repair moved some signs: there the crossing is put next to the node that changed.
    beside = NETS.crossing * spacing
    values = np.where(inside == (values > 0), values, np.where(inside, beside, -beside))
    vertices, quads, _ = dual_net(inside.astype(np.int64), np.abs(values))
    vertices = _relax(vertices * spacing, quads, field, size, spacing)
    return vertices, _split(vertices, quads)


def _sample(field: FloatArray, points: FloatArray, size: FloatArray) -> FloatArray:
    values: FloatArray = ndimage.map_coordinates(field, (points / size).T, order=1, mode="nearest")
    return values


def _well_composed(inside: Mask) -> Mask:
    """Fill nodes until the surface between in and out is a manifold.

    Three kinds of contact break it: two opposite corners of a square, of a cube, and their
    complements. Filling always ends: at worst with the bounding box.
    """
    inside = inside.copy()
    while True:
        before = int(inside.sum())
        for axis in range(3):
            a = np.moveaxis(inside, axis, 0)
            p, q, r, s = a[:, :-1, :-1], a[:, 1:, 1:], a[:, :-1, 1:], a[:, 1:, :-1]
            one, two = p & q & ~r & ~s, r & s & ~p & ~q
            r |= one
            p |= two
        corners = [inside[_octant(c)] for c in np.ndindex(2, 2, 2)]
        count = np.sum(corners, axis=0)
        for c in range(4):
            first, last = corners[c], corners[7 - c]
            pair = (first == last) & (count == np.where(first, 2, 6))
            for corner in corners:
                corner |= pair
        if int(inside.sum()) == before:
            return inside


def _octant(corner: tuple[int, ...]) -> tuple[slice, ...]:
    return tuple(slice(c, None if c else -1) for c in corner)


def _relax(
    vertices: FloatArray, quads: IntArray, field: FloatArray, size: FloatArray, spacing: float
) -> FloatArray:
    """Even out the quads: towards the mean of the neighbours, then back onto the surface."""
    start, end = quads.ravel(), np.roll(quads, -1, axis=1).ravel()
    n = len(vertices)
    links = coo_array((np.ones(len(start)), (start, end)), shape=(n, n)).tocsr()
    valence = np.asarray(links.sum(axis=1)).reshape(-1, 1)
    slopes = [np.gradient(field, size[axis], axis=axis) for axis in range(3)]
    for step in range(NETS.rounds):
        if step:
            vertices = vertices + 0.5 * ((links @ vertices) / valence - vertices)
        slope = np.stack([_sample(s, vertices, size) for s in slopes], axis=1)
        steep = np.maximum((slope**2).sum(axis=1), NETS.steepness)
        move = _sample(field, vertices, size)[:, None] * slope / steep[:, None]
        length = np.linalg.norm(move, axis=1, keepdims=True)
        longest = NETS.step * spacing
        vertices = vertices - move * np.minimum(1, longest / np.maximum(length, 1e-12))
    return vertices


def _split(vertices: FloatArray, quads: IntArray) -> IntArray:
    """Two triangles for each quad, along the diagonal that cuts the wider pair of angles."""
    p = vertices[quads]
    after, before = np.roll(p, -1, axis=1) - p, np.roll(p, 1, axis=1) - p
    length = np.linalg.norm(after, axis=2) * np.linalg.norm(before, axis=2)
    angle = np.arccos(np.clip((after * before).sum(2) / np.maximum(length, 1e-300), -1, 1))
    other = angle[:, 1] + angle[:, 3] > angle[:, 0] + angle[:, 2]
    quads = np.where(other[:, None], np.roll(quads, -1, axis=1), quads)
    return quads[:, TRIANGLES].reshape(-1, 3)
