"""Joining the regions of a watershed that no wall divides.

A watershed of a noisy image cuts cells into pieces. Two neighbours are joined where the wall
between them is low, unless that would open the whole: a piece of the outside that leaks into a
cell through a dim membrane has low walls on all its sides, so the cell with the piece is less
enclosed than the cell alone, while two halves of one cell are together more enclosed than either.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..contacts import faces_of_voxels
from ..mesh import FloatArray
from .cell_rules import FINDING

Labels = NDArray[np.int32]
Image = NDArray[np.float32]

_NOTHING = 1e-6  # of an area: what sums and differences of areas leave by rounding


@dataclass(frozen=True)
class Regions:
    """Regions of an image; arrays are indexed by label, and 0 for unused labels.

    labels : (Z, Y, X) int32 from 1; 0 where the image is missing.
    volume : um^3.
    enclosed : the share of a region's surface that is on a wall; borders of the image, and of what
        is missing from it, are not counted.
    height : the mean over that surface of how far the image is above the region's level.
    """

    labels: Labels
    volume: FloatArray
    enclosed: FloatArray
    height: FloatArray


class _Graph:
    """Regions, and for each pair that touches sums over the contact.

    Of area, of area x height (bounded, so that where a contact ends in the bright walls around
    does not pass for a wall), of area that the one sees as wall, of area x height.
    """

    def __init__(self, labels: Labels, image: Image, size: FloatArray) -> None:
        self.n = int(labels.max()) + 1
        pairs, heights, areas = faces_between(labels, image, size)
        count, total = dark_half(labels, image, self.n)
        level = total / np.maximum(count, 1)
        key, index = np.unique(pairs[0] * self.n + pairs[1], return_inverse=True)
        bounded = np.minimum(heights, level[pairs].max(axis=0) + FINDING.bound)
        columns = [areas, areas * bounded, areas * heights]
        columns += [areas * (heights > level[side] + FINDING.wall) for side in pairs]
        sums = np.stack([np.bincount(index, column) for column in columns], axis=1)
        self.count, self.total = count.tolist(), total.tolist()
        self.volume = (np.bincount(labels.ravel(), minlength=self.n) * np.prod(size)).tolist()
        self.near: list[dict[int, list[float]]] = [{} for _ in range(self.n)]
        for pair, (area, low, full, one, other) in zip(key.tolist(), sums.tolist(), strict=True):
            i, j = divmod(pair, self.n)
            self.near[i][j] = [area, low, one, full]
            self.near[j][i] = [area, low, other, full]
        self.area = [sum(c[0] for c in near.values()) for near in self.near]
        self.wall = [sum(c[2] for c in near.values()) for near in self.near]

    def cost(self, i: int, j: int, ball: float) -> float:
        """Return the height of the wall between two regions; inf if they must not be joined."""
        area, height, seen, _ = self.near[i][j]
        around = self.area[i] + self.area[j] - 2 * area
        wall = self.wall[i] + self.wall[j] - seen - self.near[j][i][2]
        joined = wall / around if around > _NOTHING * area else 1.0
        if joined < max(self.enclosed(i), self.enclosed(j)):
            return float("inf")
        level = max(self.total[i] / self.count[i], self.total[j] / self.count[j])
        relative = ((self.volume[i] + self.volume[j]) / ball) ** (1 / 3)
        return (height / area - level) * min(max(relative, FINDING.ready[0]), FINDING.ready[1])

    def enclosed(self, i: int) -> float:
        return self.wall[i] / self.area[i] if self.area[i] > 0 else 0.0

    def height(self, i: int) -> float:
        if self.area[i] <= 0:
            return 0.0
        mean = sum(contact[3] for contact in self.near[i].values()) / self.area[i]
        return mean - self.total[i] / self.count[i]

    def join(self, i: int, j: int) -> None:
        """Make region j a part of region i."""
        for column in (self.count, self.total, self.volume, self.area, self.wall):
            column[i] += column[j]
        self.area[i] -= 2 * self.near[i][j][0]
        self.wall[i] -= self.near[i].pop(j)[2] + self.near[j].pop(i)[2]
        for k, seen in self.near[j].items():
            back = self.near[k].pop(j)
            for here, there, more in ((i, k, seen), (k, i, back)):
                old = self.near[here].get(there, [0.0] * 4)
                self.near[here][there] = [a + b for a, b in zip(old, more, strict=True)]
        self.near[j] = {}
        self.volume[j] = 0.0


def join_regions(labels: Labels, image: Image, size: FloatArray, ball: float) -> Regions:
    """Join neighbours that no wall divides, the lowest wall first.

    Parameters
    ----------
    labels : (Z, Y, X) int32 from 1, every voxel in a region; 0 where the image is missing.
    image : (Z, Y, X), bright walls.
    size : um, of a voxel.
    ball : um^3, the volume of a typical cell.
    """
    graph = _Graph(labels, image, size)
    owner, version = list(range(graph.n)), [0] * graph.n
    heap = [
        (cost, i, j, 0, 0)
        for i, near in enumerate(graph.near)
        for j in near
        if i < j and (cost := graph.cost(i, j, ball)) <= FINDING.join_below
    ]
    heapq.heapify(heap)
    while heap:
        _, i, j, one, other = heapq.heappop(heap)
        if version[i] != one or version[j] != other:
            continue  # one of them has changed since
        graph.join(i, j)
        owner[j] = i
        version[i] += 1
        version[j] = -1
        for k in graph.near[i]:
            cost = graph.cost(i, k, ball)
            if cost <= FINDING.join_below:
                heapq.heappush(heap, (cost, i, k, version[i], version[k]))
    root = np.array(owner)
    while (root[root] != root).any():
        root = root[root]
    enclosed = np.array([graph.enclosed(i) for i in range(graph.n)])
    height = np.array([graph.height(i) for i in range(graph.n)])
    return Regions(root[labels].astype(np.int32), np.array(graph.volume), enclosed, height)


def dark_half(labels: Labels, image: Image, count: int) -> tuple[FloatArray, FloatArray]:
    """Return number and sum of the darker half of each label's voxels: bright ones may be walls."""
    middle = np.zeros(count)
    middle[1:] = ndimage.median(image, labels, np.arange(1, count))
    dark = np.where(image <= middle[labels], labels, 0).ravel()
    voxels = np.bincount(dark, minlength=count).astype(np.float64)
    return voxels, np.bincount(dark, image.ravel(), count).astype(np.float64)


def faces_between(
    labels: Labels, image: Image, size: FloatArray
) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Return faces between voxels of two regions: (2, n) sorted labels, height, area (um^2).

    Label 0 does not count as a region.
    """
    pairs, heights, areas = [], [], []
    for axis, (names, values) in enumerate(faces_of_voxels(labels, image)):
        pairs.append(np.sort(np.stack(names).astype(np.int64), axis=0))
        heights.append(np.maximum(*values).astype(np.float64))
        areas.append(np.full(heights[-1].shape, np.prod(size) / size[axis]))
    return np.concatenate(pairs, axis=1), np.concatenate(heights), np.concatenate(areas)
