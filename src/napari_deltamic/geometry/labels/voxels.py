"""Which region each voxel lies in: a mesh as a label image."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from ..distance_transform import VoxelSize, distance_transform
from ..mesh import OUTSIDE, FloatArray, Mesh
from ..windings import right_side_out

# Voxels: lines through their centres would meet vertices and edges of meshes that were made on the
# same grid, so they are drawn this much aside, unlike along the two axes.
_ASIDE = np.array([1.3e-6, 2.1e-6])


def voxel_labels(
    mesh: Mesh,
    shape: Sequence[int],
    voxel_size: Sequence[float],
    origin: Sequence[float] = (0.0, 0.0, 0.0),
) -> NDArray[np.signedinteger]:
    """Return (Z, Y, X) the region number at the centre of each voxel; 0 outside.

    Along each line of voxels in X, a face that the line crosses says which region comes next: the
    region on the far side of the last face that was crossed.

    Parameters
    ----------
    mesh : closed regions, um; where they overlap, the one whose face was crossed last wins. Those
        that are inside out are turned, with a RepairWarning.
    shape : voxels, Z Y X.
    voxel_size, origin : um, Z Y X; the origin is the centre of the first voxel.
    """
    nz, ny, nx = (int(n) for n in shape)
    size, start = np.asarray(voxel_size, float), np.asarray(origin, float)
    mesh = right_side_out(mesh)
    places = (mesh.vertices_numpy() - start) / size
    line, at, after = _crossings(places[mesh.faces], mesh.regions, nz, ny)
    kind: Any = np.int32 if mesh.regions.max() <= np.iinfo(np.int32).max else np.int64
    labels = np.zeros(nz * ny * nx, kind)
    order = np.lexsort((at, line))
    line, at, after = line[order], at[order], after[order]
    # Beyond its last face a line is outside, whatever rounding makes of faces that it grazes.
    after[np.append(line[1:] != line[:-1], True)[: len(line)]] = OUTSIDE
    # The first voxel beyond each crossing; of several in one gap the last one counts.
    voxel = np.ceil(at).clip(0, None).astype(np.int64)
    seen = voxel < nx
    index, after = (line * nx + voxel)[seen], after[seen]
    marks = np.full(len(labels), -1, np.int64)
    marks[index] = np.arange(len(index))  # numpy keeps the last of equal indices
    marks = np.maximum.accumulate(marks.reshape(-1, nx), axis=1).reshape(-1)
    known = marks >= 0
    labels[known] = after[marks[known]]
    return labels.reshape(nz, ny, nx)


def region_windings(
    mesh: Mesh,
    regions: Iterable[int],
    shape: Sequence[int],
    voxel_size: Sequence[float],
    origin: Sequence[float] = (0.0, 0.0, 0.0),
) -> Iterator[tuple[int, tuple[slice, ...], NDArray[np.int32]]]:
    """Yield how often the surface of each region winds around the centres of voxels.

    That is 1 inside, 0 outside, and 2 where the region overlaps itself.

    Parameters
    ----------
    mesh : with the surfaces of the regions closed, um.
    regions : their numbers.
    shape, voxel_size, origin : as in :func:`voxel_labels`.

    Yields
    ------
    For each region that reaches into the voxels: its number, the box of voxels that holds it, and
    the winding numbers in that box.
    """
    size, start = np.asarray(voxel_size, float), np.asarray(origin, float)
    places = (mesh.vertices_numpy() - start) / size
    side = mesh.regions.T.reshape(-1)
    order = np.argsort(side, kind="stable")
    side = side[order]
    for region in regions:
        first, last = np.searchsorted(side, [region, region + 1])
        own = order[first:last]
        outer = own >= len(mesh.faces)
        rows = np.where(outer, own - len(mesh.faces), own)
        corners = places[mesh.faces[rows]]
        low = np.floor(corners.min((0, 1))).astype(int).clip(0)
        high = np.minimum(np.ceil(corners.max((0, 1))).astype(int) + 1, shape)
        if (low >= high).any():
            continue
        nz, ny, nx = (high - low).tolist()
        sides = np.where(outer[:, None], [0, 1], [1, 0])  # what lies behind, and in front
        line, at, inside = _crossings(corners - low, sides, nz, ny)
        voxel = np.ceil(at).clip(0, None).astype(np.int64)
        seen = voxel < nx
        turns = np.zeros(nz * ny * nx, np.int32)
        np.add.at(turns, (line * nx + voxel)[seen], np.where(inside[seen] > 0, 1, -1))
        wound = turns.reshape(nz, ny, nx).cumsum(axis=2, dtype=np.int32)
        box = tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
        yield int(region), box, wound


def _crossings(
    corners: FloatArray, regions: NDArray[Any], nz: int, ny: int
) -> tuple[NDArray[np.int64], FloatArray, NDArray[np.int64]]:
    """Return line (z * ny + y), place along X (voxels) and region beyond of every crossing."""
    flat = corners[:, :, :2] - _ASIDE
    low = np.ceil(flat.min(axis=1)).clip(0, None).astype(np.int64)
    high = np.minimum(np.floor(flat.max(axis=1)).astype(np.int64), [nz - 1, ny - 1])
    extent = (high - low + 1).clip(0, None)
    counts = extent.prod(axis=1)
    face = np.repeat(np.arange(len(corners)), counts)
    place = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    z = low[face, 0] + place // extent[face, 1]
    y = low[face, 1] + place % extent[face, 1]
    a, b, c = (flat[face, k] for k in range(3))
    point = np.stack([z, y], axis=1).astype(np.float64)
    weights = np.stack([_twice(b, c, point), _twice(c, a, point), _twice(a, b, point)], axis=1)
    area = weights.sum(axis=1)
    inside = ((weights >= 0).all(axis=1) | (weights <= 0).all(axis=1)) & (area != 0)
    face, weights, area = face[inside], weights[inside], area[inside]
    at = (weights * corners[face, :, 2]).sum(axis=1) / area
    # The normal is minus the cross product in Z, Y, X: positive area, normal towards smaller x.
    after = np.where(area > 0, regions[face, 0], regions[face, 1])
    return z[inside] * ny + y[inside], at, after


def _twice(p: FloatArray, q: FloatArray, r: FloatArray) -> FloatArray:
    """Return signed double areas of flat triangles, from their corners, (n, 2) each."""
    left, right = q - p, r - p
    area: FloatArray = left[:, 0] * right[:, 1] - left[:, 1] * right[:, 0]
    return area


def highest(values: NDArray[Any], parts: NDArray[Any], count: int) -> NDArray[Any]:
    """Return (count,) the highest value in each part, from number 1 on; SciPy sorts all voxels.

    Parameters
    ----------
    values : (Z, Y, X).
    parts : (Z, Y, X) numbers up to ``count``, 0 is in no part.
    """
    there = parts > 0
    found = np.full(count, -np.inf, values.dtype)
    np.maximum.at(found, parts[there] - 1, values[there])
    return found


def largest_part(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the largest of the parts whose voxels share faces."""
    parts, count = ndimage.label(mask)
    return mask if count < 2 else parts == 1 + np.bincount(parts.ravel())[1:].argmax()


def ranked(labels: NDArray[np.integer]) -> tuple[NDArray[np.integer], NDArray[np.int32]]:
    """Return the numbers of labels, 0 and rising, and the labels by their place among these.

    What is below 0 counts as 0. Numbers may be huge.
    """
    labels = labels.clip(0)
    if labels.max(initial=0) > labels.size:
        names, ranks = np.unique(np.append(labels.dtype.type(0), labels), return_inverse=True)
        return names, ranks[1:].reshape(labels.shape).astype(np.int32)
    there = np.bincount(labels.ravel(), minlength=1) > 0
    there[0] = True
    return np.flatnonzero(there), (np.cumsum(there) - 1).astype(np.int32)[labels]


def renumbered(labels: NDArray[np.integer], kept: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Keep some of the labels from 1 and number them from 1 again; the others become 0."""
    numbers = np.append(0, np.where(kept, np.cumsum(kept), 0)).astype(np.int32)
    return numbers[labels]


def depths(mask: NDArray[np.bool_], size: VoxelSize = 1.0) -> FloatArray:
    """Return (Z, Y, X) how deep each voxel lies in a mask, which ends where the array does.

    size : um of a voxel, Z Y X; 1: counted in voxels.
    """
    deep = distance_transform(np.pad(mask, 1), size)
    return np.asarray(deep[1:-1, 1:-1, 1:-1])


def box_around(*boxes: tuple[slice, ...]) -> tuple[slice, ...]:
    """Return the box of voxels that holds all given boxes."""
    sides = zip(*boxes, strict=True)
    return tuple(slice(min(s.start for s in x), max(s.stop for s in x)) for x in sides)


def widened(box: tuple[slice, ...], by: ArrayLike, shape: Sequence[int]) -> tuple[slice, ...]:
    """Widen a box by this many voxels, rounded up, on each side, as far as the image goes.

    by : one number, or one along each axis.
    """
    room = np.broadcast_to(np.ceil(by).astype(int), len(box)).tolist()
    sides = zip(box, room, shape, strict=True)
    return tuple(slice(max(s.start - r, 0), min(s.stop + r, n)) for s, r, n in sides)
