"""Regions that points name: the dark inside of a membrane, found by flooding.

A point names an object by the *basin* of the smoothed image that it lies in: the dark inside of
a membrane. The basin is found by flooding: water rising from the point fills the object first and
leaks, at one level, into everything else. The leap in flooded volume at that level is so much
larger than any within the object that it needs no threshold on intensity, so dim and bright
membranes are treated alike, and every point of one object gives the same basin.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha1
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.measure import block_reduce
from skimage.segmentation import watershed

from ...common.kept import Kept
from ..mesh import FloatArray, IntArray
from ..refused import Refused
from .cell_rules import BASINS
from .flood_tree import Ranks, flood_tree
from .voxels import widened

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class _Tree:
    """Component tree of the sub-level sets of an image: how its dark parts join."""

    level: IntArray
    parent: IntArray
    volume: FloatArray  # voxels
    border: FloatArray  # um^2 on the faces of the image
    lowest: IntArray


@dataclass(frozen=True)
class _Basin:
    """The part of a tree that a point names; ``path`` runs from its lowest voxel to the root."""

    path: IntArray
    node: int  # position in path of the last component before the leak


@dataclass(frozen=True)
class _NoBasin:
    """What is wrong with a point; closed : whether its region is only too small."""

    text: str
    closed: bool = False


def label_basins(
    data: FloatArray, size: FloatArray, voxels: IntArray, names: list[int]
) -> tuple[NDArray[np.int32], list[Refused]]:
    """Label the basin of each voxel in `voxels` (n, 3) with its name; 0 elsewhere.

    Does the work of `labels_from_points`; also returns the points without a region of their own.
    """
    sigma = float(size.min())  # of the smallest Gaussian that removes the noise of single voxels
    smooth = ndimage.gaussian_filter(data, sigma / size, mode="nearest")
    noise = noise_after(data, sigma / size)
    # Steps of a fraction of the noise lose nothing and make the tree faster.
    step = max(float(np.ptp(smooth)) / 65535, noise / 4)
    ranked = np.round((smooth - smooth.min()) / step).astype(np.uint16)
    least = BASINS.noise_rise * noise / step
    for block in _blocks(ranked, size):
        heights = _highest(ranked, block)
        tree = _component_tree(heights, size * block)
        found, refused = _basins(tree, heights, voxels // block, names, size * block, least)
        basins, same = _separate(tree, found)
        if not refused and not same and _large(tree, basins, block):
            break
    cores = {name: _each(_core(heights, tree, b), block, ranked) for name, b in basins.items()}
    levels = {name: int(tree.level[b.path[b.node]]) for name, b in basins.items()}
    labels, cut = _grow(ranked, _each(heights, block, ranked), levels, cores, size)
    return labels, refused + same + cut


def _blocks(ranked: Ranks, size: FloatArray) -> list[IntArray]:
    """Return block sizes (3,) in voxels, largest first: the highest value of each block is flooded.

    Nothing leaks between such blocks that would not leak between voxels; small regions may be lost.
    """
    fine = size < 2 * size.min()
    sides = [n for n in BASINS.sides if ranked.size >= BASINS.many * (n // 2) ** 3]
    return [np.where(fine, n, 1) for n in (*sides, 1)]


def _highest(ranked: Ranks, block: IntArray) -> Ranks:
    """Return the highest value of each block; blocks at the far borders may be smaller."""
    if (block == 1).all():
        return ranked
    room = [(0, -n % b) for n, b in zip(ranked.shape, block.tolist(), strict=True)]
    return block_reduce(np.pad(ranked, room, mode="edge"), tuple(block.tolist()), np.max)


def _each(blocks: NDArray[Any], block: IntArray, image: Ranks) -> NDArray[Any]:
    """Return for each voxel of an image the value of its block."""
    for axis, n in enumerate(block.tolist()):
        blocks = blocks if n == 1 else blocks.repeat(n, axis=axis)
    return blocks[tuple(slice(n) for n in image.shape)]


def _large(tree: _Tree, basins: dict[int, _Basin], block: IntArray) -> bool:
    """Whether all basins are so large that blocks cannot have changed them."""
    fewest = BASINS.blocks * np.prod(np.maximum(block // 2, 1))
    return all(tree.volume[b.path[b.node]] >= fewest for b in basins.values())


def _basins(
    tree: _Tree,
    ranked: Ranks,
    voxels: IntArray,
    names: list[int],
    size: FloatArray,
    least: float,
) -> tuple[dict[int, _Basin], list[Refused]]:
    """Return the basin of each point, and the points that have none."""
    found: dict[int, _Basin] = {}
    refused = []
    for voxel, name in zip(voxels, names, strict=True):
        basin = _find_basin(tree, _descend(ranked, voxel), size, least)
        if isinstance(basin, _NoBasin):
            refused.append(Refused(f"point {name} {basin.text}", (name,), basin.closed))
        else:
            found[name] = basin
    return found, refused


def noise_after(data: FloatArray, sigma: FloatArray, known: Mask | None = None) -> float:
    """Standard deviation of the noise that smoothing with Gaussians (sigma in voxels) leaves."""
    return pixel_noise(data, known) * noise_gain(sigma)


def noise_gain(sigma: FloatArray) -> float:
    """Share of the standard deviation of white noise that Gaussians (sigma in voxels) leave."""
    pulse = np.zeros(2 * int(4 * sigma.max() + 1) + 1)
    pulse[len(pulse) // 2] = 1
    return float(np.prod([np.linalg.norm(ndimage.gaussian_filter1d(pulse, s)) for s in sigma]))


def pixel_noise(data: FloatArray, known: Mask | None = None) -> float:
    """Standard deviation of the noise in single voxels; 0 for an image too narrow to tell.

    known : where the image is not missing; None: everywhere.

    From second differences along X: membranes hardly change them, and their median even less. The
    median magnitude of a normal deviate is 0.6745 (as in ``common.normal``); the squares of the
    weights 1, -2, 1 sum to 6.
    """
    if data.shape[2] < 3:
        return 0.0
    second = np.abs(np.diff(data, 2, axis=2))
    if known is not None:
        second = second[known[..., 2:] & known[..., 1:-1] & known[..., :-2]]
    return float(np.median(second)) / 0.6745 / 6**0.5 if second.size else 0.0  # by definition


def border_area(shape: tuple[int, ...], size: FloatArray, known: Mask | None = None) -> FloatArray:
    """Area (um^2) of each voxel's share of the border of the image, or of its known part.

    The border of a known part is mostly slanted, and the faces of its voxels have up to 1.7 times
    its area. So it is twice the slope of a smoothed mask, as half of that lies on the other side.
    """
    area = np.zeros(shape)
    for axis in range(3):
        sides = np.moveaxis(area, axis, 0)
        face = float(np.prod(size) / size[axis])
        sides[0] += face
        sides[-1] += face
    if known is not None and not known.all():
        smooth = ndimage.gaussian_filter(known.astype(np.float32), 1.0, mode="nearest")
        slopes = [np.gradient(smooth, d, axis=k) for k, d in enumerate(size) if shape[k] > 1]
        area += 2 * np.sqrt(sum(s * s for s in slopes)) * np.prod(size)
    return area


# The trees of the last image, of its blocks and of its voxels: they take nearly all of the time,
# and every click of a user needs them again.
_TREES = Kept[_Tree](2)


def content_of(image: NDArray[Any], size: FloatArray) -> bytes:
    """Return a hash of an image and its voxel size, by which results kept for it are found."""
    content = sha1(image.tobytes(), usedforsecurity=False)
    content.update(repr((image.shape, size.tolist())).encode())
    return content.digest()


def _component_tree(ranked: Ranks, size: FloatArray) -> _Tree:
    return _TREES.get(content_of(ranked, size), lambda: _new_tree(ranked, size))


def _new_tree(ranked: Ranks, size: FloatArray) -> _Tree:
    parent, order = flood_tree(ranked)
    level = ranked.ravel().astype(np.int64)
    # Most voxels are leaves at the level of their parent, and join it at once.
    leaf = level[parent] == level
    leaf[order[0]] = False  # its own parent
    n, border = level.size, border_area(ranked.shape, size).ravel()
    volume = np.ones(n)
    volume += np.bincount(parent[leaf], minlength=n)
    border += np.bincount(parent[leaf], border[leaf], minlength=n)
    nodes = order[~leaf[order]]
    row = np.empty(n, np.int64)
    row[nodes] = np.arange(len(nodes))
    # Plain lists: one pass over them is several times faster than with array elements.
    up, low = row[parent[nodes]].tolist(), level[nodes].tolist()
    voxels, faces = volume[nodes].tolist(), border[nodes].tolist()
    for child in range(len(nodes) - 1, 0, -1):
        above = up[child]
        voxels[above] += voxels[child]
        faces[above] += faces[child]
        low[above] = min(low[above], low[child])
    lowest = level.copy()
    volume[nodes], border[nodes], lowest[nodes] = voxels, faces, low
    return _Tree(level, parent, volume, border, lowest)


def _descend(ranked: Ranks, voxel: IntArray) -> int:
    """Return the flat index of the local minimum where steepest descent from a voxel ends."""
    here = tuple(int(i) for i in voxel)
    while True:
        corner = [max(i - 1, 0) for i in here]
        near = ranked[tuple(slice(c, i + 2) for c, i in zip(corner, here, strict=True))]
        if near.min() >= ranked[here]:
            return int(np.ravel_multi_index(here, ranked.shape))
        step = np.unravel_index(int(near.argmin()), near.shape)
        here = tuple(c + int(s) for c, s in zip(corner, step, strict=True))


def _find_basin(tree: _Tree, low: int, size: FloatArray, least: float) -> _Basin | _NoBasin:
    """Follow the flood from a minimum and stop it before the leap that is the leak.

    There may be no such leap, or only one of few voxels.
    """
    path = [low]
    while tree.parent[path[-1]] != path[-1]:
        path.append(int(tree.parent[path[-1]]))
    nodes = np.array(path)
    volume, level = tree.volume[nodes], tree.level[nodes]
    rise = level[1:] - tree.lowest[nodes[:-1]]
    leap = np.where(rise > least, np.diff(volume), 0)
    ball = np.cbrt(36 * np.pi * (volume * np.prod(size)) ** 2)
    opened = (tree.border[nodes] > BASINS.border * ball)[:-1]
    node = int(leap.argmax()) if len(leap) else 0
    if len(leap) and opened[node]:
        # The outside may itself be in parts that join later, with a larger leap than the leak.
        fair = ~opened & (leap > volume[:-1]) & (rise > BASINS.lower_leap * rise[node])
        fair[node:] = False
        leap = np.where(fair, leap, 0)
        node = int(leap.argmax())
    if not leap.any():
        return _NoBasin("lies in no closed region of the image: give it a radius, or move it")
    if volume[node] < BASINS.fewest:
        return _NoBasin(
            f"lies in no closed region of the image (only {volume[node]:.0f} voxels around it): it "
            "may be on a membrane or in the background",
            closed=True,
        )
    return _Basin(nodes, node)


_SAME = -1  # instead of where a basin ends: no pass stands out


def _separate(tree: _Tree, basins: dict[int, _Basin]) -> tuple[dict[int, _Basin], list[Refused]]:
    """Cut basins that points share at the pass between them, if that stands out.

    Otherwise the first of the points gets the basin, and the others are refused.
    """
    above = {name: set(basin.path.tolist()) for name, basin in basins.items()}
    ends = {
        (i, j): _end_before(tree, one, other)
        for i, one in basins.items()
        for j, other in basins.items()
        if i != j and int(one.path[one.node]) in above[j]
    }
    kept: list[int] = []
    refused = []
    for name in basins:
        same = [k for k in kept if _SAME in (ends.get((k, name)), ends.get((name, k)))]
        if same:
            first, second = sorted((same[0], name))
            text = f"points {first} and {second} lie in the same region"
            refused.append(Refused(text, (first, second)))
        else:
            kept.append(name)
    found = {}
    for name in kept:
        cuts = [end for (i, j), end in ends.items() if i == name and j in kept]
        found[name] = _Basin(basins[name].path, min([basins[name].node, *cuts]))
    return found, refused


def _end_before(tree: _Tree, one: _Basin, other: _Basin) -> int:
    """Return the position in the path of ``one`` where it ends before the other, or _SAME."""
    # First node on the way up that floods the other point too.
    meet = int(np.isin(one.path[: one.node + 1], other.path).argmax())
    height, leak = tree.level[one.path[[meet, one.node + 1]]]
    meet_other = int(np.flatnonzero(other.path == one.path[meet])[0])
    floor = height
    if meet and meet_other:
        sides = [one.path[meet - 1], other.path[meet_other - 1]]
        floor = tree.lowest[sides].max()
    if height == floor or height - floor < BASINS.same_object * (leak - floor):
        return _SAME
    return meet - 1


def _core(ranked: Ranks, tree: _Tree, basin: _Basin) -> Mask:
    parts, _ = ndimage.label(ranked <= tree.level[basin.path[basin.node]])
    mask: Mask = parts == parts.flat[basin.path[0]]
    return mask


def _grow(
    ranked: Ranks,
    heights: Ranks,
    levels: dict[int, int],
    cores: dict[int, Mask],
    size: FloatArray,
) -> tuple[NDArray[np.int32], list[Refused]]:
    """Flood from each core up to the crest, in competition with all else that is dark at its level.

    heights : highest values of the blocks in which cores and levels were found.
    """
    labels = np.zeros(ranked.shape, np.int32)
    refused = []
    every_core = np.logical_or.reduce([np.zeros(ranked.shape, bool), *cores.values()])
    for k, core in cores.items():
        box = _box_around(core)
        inside = core[box]
        markers = np.where(inside, 1, 2 * ((heights[box] <= levels[k]) | every_core[box]))
        _mark_cuts(markers, box, ranked.shape)
        region = ndimage.binary_fill_holes(watershed(ranked[box], markers) == 1)
        region &= inside | (~every_core[box] & (labels[box] == 0))
        border = float(border_area(ranked.shape, size)[box][region].sum())
        ball = np.cbrt(36 * np.pi * (region.sum() * np.prod(size)) ** 2)
        if border > BASINS.border * ball:
            text = f"the region of point {k} lies mostly on the border of the image"
            refused.append(Refused(text, (k,)))
        else:
            labels[box][region] = k
    return labels, refused


def _box_around(mask: Mask) -> tuple[slice, ...]:
    """Return the bounding box of a mask with room for the membrane and what lies beyond it."""
    box = ndimage.find_objects(mask.astype(np.int8))[0]
    room = [5 + (s.stop - s.start) // 4 for s in box]
    return widened(box, room, mask.shape)


def _mark_cuts(markers: NDArray[np.int_], box: tuple[slice, ...], shape: tuple[int, ...]) -> None:
    """Mark the sides where the box cuts the image as outside of objects, so that none leaks."""
    for axis in range(3):
        sides = np.moveaxis(markers, axis, 0)
        for side, cut in ((0, box[axis].start > 0), (-1, box[axis].stop < shape[axis])):
            if cut:
                sides[side][sides[side] != 1] = 2
