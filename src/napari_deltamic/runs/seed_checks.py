"""What may be wrong with seeds, and which points are concerned: told before a fit is started."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..common.words import counted
from ..errors import listed
from ..geometry.mesh import FloatArray


@dataclass(frozen=True)
class PointSet:
    """The points of one layer that are seeds.

    points, radii : um in the frame of the image; radii is None if the points are not spheres.
    rows : row of the layer for each point.
    several : whether other layers give points, too, so that sentences must name this one.
    """

    layer: Any
    points: FloatArray
    radii: FloatArray | None
    rows: NDArray[np.int64]
    several: bool = False

    def name(self, index: int) -> str:
        """A point as users know it: counted from 1, like the cells made from points."""
        number = str(int(self.rows[index]) + 1)
        return f"{number} of '{self.layer.name}'" if self.several else number


@dataclass(frozen=True)
class Remark:
    """A sentence, and the points that it is about as (layer, row)."""

    text: str
    points: tuple[tuple[Any, int], ...] = ()


Place = tuple[int, int]  # which set, which point of it


def all_remarks(
    sets: Sequence[PointSet],
    labels: Sequence[tuple[Any, NDArray[Any]]],
    shape: Sequence[int],
    size: Sequence[float],
    problems: Sequence[tuple[str, Sequence[int]]],
) -> list[Remark]:
    """Remarks on everything that may be wrong with seeds.

    Parameters
    ----------
    labels : Labels layers that are seeds, too, each with its voxels.
    shape, size : shape of the image, voxels, and its voxel size, um.
    problems : what the engine reports on points, which it numbers from 1 over all sets.
    """
    remarks = outside(sets, shape, size) + in_one_sphere(sets) + in_labels(sets, labels, size)
    told = (of_engine(sets, text, numbers) for text, numbers in problems)
    return remarks + [remark for remark in told if remark is not None]


def outside(sets: Sequence[PointSet], shape: Sequence[int], size: Sequence[float]) -> list[Remark]:
    """A remark on points outside the image, which cannot be fitted."""
    found: list[Place] = []
    for k, one in enumerate(sets):
        voxels = np.floor(one.points / np.asarray(size) + 0.5)
        inside = ((voxels >= 0) & (voxels < np.asarray(shape))).all(axis=1)
        found += [(k, int(i)) for i in np.flatnonzero(~inside)]
    if not found:
        return []
    it = "it" if len(found) == 1 else "them"
    lies = "lies" if len(found) == 1 else "lie"
    return [_remark(sets, found, f"{{}} {lies} outside the image: move or delete {it}")]


def in_one_sphere(sets: Sequence[PointSet]) -> list[Remark]:
    """Remarks on pairs where one centre lies in the other's sphere: two seeds in one cell."""
    places = [
        (k, i)
        for k, one in enumerate(sets)
        if one.radii is not None
        for i in range(len(one.points))
    ]
    if len(places) < 2:
        return []
    points = np.array([sets[k].points[i] for k, i in places])
    radii = np.array([float(_radii(sets[k])[i]) for k, i in places])
    tree = cKDTree(points)
    near = tree.query_ball_point(points, radii * (1 - 1e-9))
    pairs = sorted({(min(a, b), max(a, b)) for a, row in enumerate(near) for b in row if a != b})
    return [
        _remark(sets, [places[a], places[b]], "{} are in one sphere: are they in one cell?")
        for a, b in pairs
    ]


def in_labels(
    sets: Sequence[PointSet], labels: Sequence[tuple[Any, NDArray[Any]]], size: Sequence[float]
) -> list[Remark]:
    """Remarks on points in cells that a ticked Labels layer (given with its voxels) has as well."""
    remarks = []
    for layer, voxels in labels:
        if voxels.ndim != 3:
            continue  # said when the fit starts
        found: list[Place] = []
        for k, one in enumerate(sets):
            index = np.floor(one.points / np.asarray(size) + 0.5).astype(int)
            inside = ((index >= 0) & (index < voxels.shape)).all(axis=1)
            rows = np.flatnonzero(inside)
            hit = rows[np.asarray(voxels[tuple(index[rows].T)]) > 0]
            found += [(k, int(i)) for i in hit]
        if found:
            verb = "lies" if len(found) == 1 else "lie"
            text = f"{{}} {verb} in a label of '{layer.name}': two seeds in one cell"
            remarks.append(_remark(sets, found, text))
    return remarks


def beside_region(what: str, of: str, numbers: int, lost: int, cut: int = 0) -> list[Remark]:
    """A remark on cells beside the region that is fitted, or cut by its border; [] without any.

    what, of : what they are called, such as "cell", and the name of their layer.
    numbers : how many there are in all.
    lost, cut : how many lie beyond the border, and how many it cuts.
    """
    edge = "the border of the region"
    told = [
        f"{lost} {'lies' if lost == 1 else 'lie'} beyond {edge}, and will not be fitted"
        * (lost > 0),
        f"{cut} {'is' if cut == 1 else 'are'} cut by {'it' if lost else edge}" * (cut > 0),
    ]
    whole = f"Of {counted(numbers, what)} in '{of}'"
    return [Remark(f"{whole}, {'; '.join(filter(None, told))}")] if any(told) else []


def labels_beside_region(name: str, labels: NDArray[Any], box: tuple[slice, ...]) -> list[Remark]:
    """The same, counted from the labels of the whole image, of which a box is fitted."""
    whole, inside = voxels_of(labels), voxels_of(labels[box])
    cut = sum(whole[number] > count for number, count in inside.items())
    return beside_region("cell", name, len(whole), len(whole) - len(inside), cut)


def voxels_of(labels: NDArray[Any]) -> dict[int, int]:
    """Number of voxels of each label above 0, however large the labels are."""
    if labels.max(initial=0) > labels.size:
        numbers, counts = np.unique(labels, return_counts=True)
    else:  # faster, but takes memory in proportion to the largest label
        flat = labels.ravel()
        flat = flat.clip(0) if labels.min(initial=0) < 0 else flat
        counts = np.bincount(flat.astype(np.intp, copy=False))
        numbers = np.flatnonzero(counts)
        counts = counts[numbers]
    return {int(n): int(c) for n, c in zip(numbers, counts, strict=True) if n > 0}


def of_engine(sets: Sequence[PointSet], message: str, numbers: Sequence[int]) -> Remark | None:
    """The engine's message on points, which it numbers from 1 over all sets, as a remark.

    None if these points have been removed since.
    """
    places = [(k, i) for k, one in enumerate(sets) for i in range(len(one.points))]
    found = [places[n - 1] for n in numbers if 0 < n <= len(places)]
    text = re.sub(r"points? \d+( and \d+)?( \([^)]*um\))?", "{}", message, count=1)
    if "lie in the same region" in text:
        text = "{} are in the same cell: delete one"
    elif "{}" not in text:
        return Remark(message)
    return _remark(sets, found, text) if found else None


def _remark(sets: Sequence[PointSet], found: Sequence[Place], text: str) -> Remark:
    names = [sets[k].name(i) for k, i in found]
    sentence = text.format(listed("point", names))
    return Remark(
        sentence[0].upper() + sentence[1:],
        tuple((sets[k].layer, int(sets[k].rows[i])) for k, i in found),
    )


def _radii(one: PointSet) -> FloatArray:
    assert one.radii is not None
    return one.radii
