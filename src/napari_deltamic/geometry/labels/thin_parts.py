"""Thin parts of labels, such as arms, that a mesh with too long edges cuts off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from ...common.doing import doing
from ..distance_transform import distance_transform
from ..mesh import FloatArray, IntArray, Mesh
from .voxels import box_around, region_windings

# Edges, or along an axis two voxels where that is more. A part begins half of that outside of the
# mesh, as all of a surface may be moved so far, and ends beyond the second number. Measured on some
# 35 label images: in usual cells, also flat and very noisy ones, parts of an edge cubed end within
# 2.2, but for tails of cells in three crowds, up to 18 % of the cell; lost arms end beyond 2.3, but
# for one at 2.2, which a fit found again.
_BEGINS, _ENDS = 0.5, 2.25


def cut_off(
    numbers: IntArray,
    boxes: Sequence[tuple[slice, ...]],
    mesh: Mesh,
    names: IntArray,
    size: FloatArray,
    origin: FloatArray,
    edge: float,
) -> dict[int, float]:
    """Return, for each label that lacks parts worth a finer mesh, the volume of these, um^3.

    Such a part is connected, at least as large as a cube of an edge, and ends far from the mesh:
    where edges are longer than it is thick nothing is left of it, while smoothing moves the surface
    of a round cell by less than an edge.

    Parameters
    ----------
    numbers : (Z, Y, X) label numbers from 1. boxes : where each of them lies.
    mesh : of some of them. names : the region of each number from 1 on in the mesh, increasing.
    size, origin : um, of voxels, and the centre of the first one.
    edge : um.
    """
    scale = np.maximum(edge, 2 * size)
    voxel, least = float(size.prod()), float(scale.prod())
    # A box of voxels, all of them nearer than where a part ends: most labels lie within it.
    around = 2 * np.floor(_ENDS * scale / np.sqrt(3) / size).astype(int) + 1
    found: dict[int, float] = {}
    for name, box, wound in region_windings(
        mesh, mesh.region_ids(), numbers.shape, size.tolist(), origin.tolist()
    ):
        doing()
        number = int(np.searchsorted(names, name)) + 1
        both = box_around(box, boxes[number - 1])
        own = numbers[both] == number
        held = np.zeros(own.shape, bool)
        held[_within(box, both)] = wound != 0
        if np.count_nonzero(own & ~held) * voxel < least:
            continue
        if not (own & ~ndimage.maximum_filter(held, tuple(around), mode="constant")).any():
            continue
        away = distance_transform(~held, size / scale)
        parts, count = ndimage.label(own & (away > _BEGINS), np.ones((3, 3, 3)))
        each = np.arange(1, count + 1)
        volume = np.bincount(parts.ravel(), minlength=count + 1)[1:] * voxel
        farthest = np.asarray(ndimage.maximum(away, parts, each))
        lost = float(volume[(volume >= least) & (farthest > _ENDS)].sum())
        if lost:
            found[int(name)] = lost
    return found


def _within(box: tuple[slice, ...], outer: tuple[slice, ...]) -> tuple[slice, ...]:
    pairs = zip(box, outer, strict=True)
    return tuple(slice(a.start - b.start, a.stop - b.start) for a, b in pairs)
