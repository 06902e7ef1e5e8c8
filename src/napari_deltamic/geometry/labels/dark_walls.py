"""Parts clumps of bright cells at dark walls, gaps too narrow or too blurred for a threshold.

Between two cells there is a wall that is darker than both, all along; within a cell, nucleoli and
the gaps of chromatin are dark in places only. So parts of a crowd are joined where the wall between
them is not dark, and a bright thing that holds several of what is left is a clump.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skimage.segmentation import relabel_sequential

from ..contacts import faces_of_voxels
from ..mesh import FloatArray, IntArray
from ..pairs import unique_pairs
from .label_repair import label_boxes
from .region_merging import Image, Labels
from .solidity import mean_solidity, solidity
from .voxels import box_around


@dataclass(frozen=True)
class WallRules:
    """Thresholds that decide whether a wall parts two cells, and parts are cells of a clump.

    Attributes
    ----------
    dark
        Of the brightness of the dimmer of two cells, above the ground: a wall is darker, as where
        labels touch (``dark_gaps``). Measured on 34 simulated clumps of 519 cells with gaps of 1
        to 4 voxels: 0.8 finds 28 cells more than without, and in no clump fewer. With parts of
        three sizes, 0.87 found 34 more, but fewer in two clumps, one cut along its chromatin.
    along
        Share of a wall that is so dark. Chosen: its rim lies in the furrow between two cells, and
        is dark around the neck of one cell as well.
    inside
        Quantile of the brightness in a part that is its own. Chosen: towards walls it is darker.
    cover
        Share of a thing that its parts hold together. Chosen; measured: 0.75 to 0.92 in 18 clumps
        that were parted rightly, as each cell ends at half of its own brightness.
    less
        Parts of a thing are no cells if they are so much less solid than it is. Measured: up to
        0.08 in 18 clumps that were parted rightly and 0.11 in a ball of three; 0.14 in a nucleus
        that was cut along its chromatin, 0.24 and 0.33 where parts were wrong.
    """

    dark: float = 0.8
    along: float = 0.8
    inside: float = 0.75
    cover: float = 0.5
    less: float = 0.12


WALLS = WallRules()


def without_bright_walls(parts: Labels, smooth: Image, ground: float) -> NDArray[np.int32]:
    """Join parts (Z, Y, X) if the wall between them is not dark, the brightest wall first.

    ground : how bright it is beside the parts.
    """
    joined, count, within = parts.astype(np.int32), int(parts.max()) + 1, parts > 0
    while True:
        pairs, walls = _walls(joined, smooth)
        own = _quantiles(smooth[within], joined[within].astype(np.int64), count, WALLS.inside)
        bright = (walls - ground) / np.maximum(own[pairs].min(1) - ground, 1e-30)
        fresh = set(pairs.ravel().tolist())  # not yet joined to another in this round
        target = np.arange(len(own), dtype=np.int32)
        for k in np.argsort(-bright, kind="stable"):
            a, b = pairs[k].tolist()
            if bright[k] < WALLS.dark or not fresh:
                break
            if {a, b} <= fresh:
                target[b] = a
            fresh -= {a, b}  # what has a brighter wall to one that is taken waits
        if (target == np.arange(len(own))).all():
            return joined
        joined = target[joined]


def without_parted(found: Labels, parts: Labels, whole: float) -> NDArray[np.int32]:
    """Replace things found (Z, Y, X) by their parts if several parts lie mostly in one.

    whole : mean solidity from which the parts of a thing count as cells.
    """
    boxes, things = dict(label_boxes(parts)), dict(label_boxes(found))
    inside: dict[int, list[int]] = {}
    for part, box in boxes.items():
        own = parts[box] == part
        names = np.bincount(found[box][own])
        home = int(names.argmax())
        if home > 0 and names[home] > own.sum() / 2:  # for the most part, by definition
            inside.setdefault(home, []).append(part)
    apart: NDArray[np.int32] = found.astype(np.int32)
    last = int(apart.max())
    for home, several in inside.items():
        if len(several) < 2:
            continue
        box = box_around(things[home], *(boxes[part] for part in several))
        thing, held = found[box] == home, np.isin(parts[box], several)
        if mean_solidity(np.where(held, parts[box], 0)) <= max(whole, solidity(thing) - WALLS.less):
            continue
        if (held & thing).sum() < WALLS.cover * thing.sum():
            continue
        held &= thing | (found[box] == 0)
        apart[box][thing] = 0
        apart[box][held] = last + parts[box][held]
    numbered: NDArray[np.int32] = relabel_sequential(apart)[0].astype(np.int32)
    return numbered


def _walls(labels: Labels, smooth: Image) -> tuple[IntArray, FloatArray]:
    """Return (n, 2) labels that touch, and how bright the wall is almost all along."""
    met, light = [np.zeros((0, 2), labels.dtype)], [np.zeros(0, smooth.dtype)]
    for names, values in faces_of_voxels(labels, smooth):
        met.append(np.sort(np.stack(names, 1), axis=1))
        light.append(np.minimum(*values))
    pairs, number = unique_pairs(np.concatenate(met))
    return pairs, _quantiles(np.concatenate(light), number, len(pairs), WALLS.along)


def _quantiles(values: Image, groups: IntArray, count: int, share: float) -> FloatArray:
    """Return the quantile of the values in each group; 0 for an empty group."""
    order = np.lexsort((values, groups))
    many = np.bincount(groups, minlength=count)
    at = np.cumsum(many) - many + (share * np.maximum(many - 1, 0)).astype(int)
    found = np.zeros(count)
    found[many > 0] = values[order][at[many > 0]]
    return found
