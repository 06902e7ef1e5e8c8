"""Makes label images of segmentation programs fit for meshes, with a sentence for every repair.

Programs leave gaps between cells or let them overlap, leave cells in several parts or with holes,
and store numbers as floats. What can be repaired without a guess is repaired and reported; other
images are refused with advice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from ...common.doing import doing
from ...common.words import counted
from ...errors import InputError, listed
from ...images.missing import unmasked
from ..distance_transform import distance_transform, nearest_outside
from ..mesh import FloatArray
from ..three_numbers import three_numbers
from .annotated_slices import filled_between
from .voxels import depths, renumbered

_MANY = 1 << 16  # labels up to this number are found faster by number than by rank
_ROUNDING = 1e-6  # um, of distances: a gap exactly as wide as asked for is closed
_WHITE = 255  # the value of masks, by definition of 8 bits
_SPECK = 27  # voxels, chosen: a part of a mask with fewer is no cell
_SIDE, _SIDES = 0.5, 5  # background has this share of this many sides of the image; chosen
_SMALL_PART = 0.1  # a part of a label larger than this share of it may be a cell of its own


@dataclass(frozen=True, eq=False)
class RepairedLabels:
    """A label image and what was done to it.

    labels : (Z, Y, X) int32, each label in one part, without holes; 0 = outside.
    repairs : a sentence for each change.
    doubts : a sentence for each thing that may be wrong and was left as it is.
    asked : a sentence for each thing that a user hardly intended.
    """

    labels: NDArray[np.int32]
    repairs: tuple[str, ...]
    doubts: tuple[str, ...]
    asked: tuple[str, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """All sentences that a user should see."""
        return self.repairs + self.doubts + self.asked


def repair_labels(
    labels: ArrayLike | Sequence[ArrayLike],
    voxel_size: Sequence[float] | FloatArray = (1.0, 1.0, 1.0),
) -> RepairedLabels:
    """Bring a segmentation into the form that `mesh_from_labels` takes.

    Whole numbers kept as floats become integers, each large part of a mask (an image of one label)
    becomes a cell, empty slices between others that have labels are filled, holes are filled, of a
    label in several parts the largest is kept, voxels that several layers claim go to the cell that
    they lie deepest in. Labels that touch the border are kept and named: their surfaces are closed
    there, where no membrane is.

    Parameters
    ----------
    labels : (Z, Y, X) array, 0 = outside; or a list of such arrays or of masks that may overlap,
        each label of each a cell of its own.
    voxel_size : um, Z, Y, X.

    Raises
    ------
    InputError
        Not 3D, different shapes, values that are no whole numbers of 0 or more, no label, or
        most labels in many parts, none of which is the larger half.
    """
    size = three_numbers(voxel_size, "voxel size")
    if isinstance(labels, (list, tuple)) and len(labels) and np.ndim(labels[0]) == 3:
        layers = [_whole_numbers(layer) for layer in labels]
    else:
        layers = [_whole_numbers(labels)]
    repairs: list[str] = []
    numbers = layers[0] if len(layers) == 1 else _together(layers, size, repairs)
    if not numbers.any():
        raise InputError("the label image has no labels above 0")
    numbers, filled = filled_between(numbers, size)
    if filled:
        were = "was" if filled == 1 else "were"
        repairs.append(f"{counted(filled, 'slice')} without labels {were} filled in between others")
    if len(layers) == 1:
        numbers = _mask_as_cells(numbers, repairs)
    numbers = _in_one_part(numbers, repairs)
    return RepairedLabels(numbers, tuple(repairs), tuple(_doubts(numbers)), _asked(numbers))


def label_boxes(labels: NDArray[Any]) -> list[tuple[int, tuple[slice, ...]]]:
    """Return each label above 0 and the box that holds it, however large the numbers are."""
    if labels.size == 0 or labels.max() <= 0:
        return []
    if labels.max() > _MANY:
        names, rank = np.unique(labels.clip(0), return_inverse=True)
        ranked = rank.reshape(labels.shape).astype(np.int32) + int(names[0] > 0)
        found = ndimage.find_objects(ranked)
        return list(zip(names[names > 0].tolist(), found, strict=True))
    boxes = ndimage.find_objects(labels)
    return [(k, box) for k, box in enumerate(boxes, 1) if box is not None]


def _whole_numbers(labels: ArrayLike | Sequence[ArrayLike]) -> NDArray[np.int32]:
    array: NDArray[Any] = np.asarray(unmasked(labels, 0))
    if array.ndim == 2:
        raise InputError("the labels are 2D: a 3D stack (Z, Y, X) of labels is needed")
    if array.ndim != 3 or not array.size:
        raise InputError(f"labels must be a 3D array (Z, Y, X), not one of shape {array.shape}")
    if array.dtype == np.bool_:
        return array.astype(np.int32)
    if not np.issubdtype(array.dtype, np.number) or np.iscomplexobj(array):
        raise InputError(f"labels must be whole numbers, not {array.dtype}")
    if np.issubdtype(array.dtype, np.floating):
        array = np.nan_to_num(array, nan=0.0, posinf=np.inf, neginf=-np.inf)
        if not (array == np.round(array)).all():
            raise InputError(
                "the labels are not whole numbers: is this an image of probabilities or "
                "intensities? Threshold and label it first"
            )
    if (array < 0).any():
        raise InputError("labels must not be negative: 0 is outside, cells count from 1")
    if array.max() > np.iinfo(np.int32).max:
        raise InputError(f"label {array.max():.0f} is too large: number the cells from 1")
    whole: NDArray[np.int32] = array.astype(np.int32)
    return whole


def _together(
    layers: list[NDArray[np.int32]], size: FloatArray, repairs: list[str]
) -> NDArray[np.int32]:
    """Merge layers; a voxel that several cells claim goes to the one in which it lies deepest."""
    shape = layers[0].shape
    for layer in layers:
        if layer.shape != shape:
            raise InputError(f"label layers have shapes {shape} and {layer.shape}: they must agree")
    result = np.zeros(shape, np.int32)
    depth = np.zeros(shape, np.float32)
    claimed = np.zeros(shape, bool)
    number = 0
    gone = []
    for layer in layers:
        for name, box in label_boxes(layer):
            number += 1
            own = layer[box] == name
            inside = depths(own, size)
            claimed[box] |= own & (result[box] > 0)
            deeper = own & (inside > depth[box])
            result[box][deeper] = number
            depth[box][deeper] = inside[deeper]
    gone = [k for k in range(1, number + 1) if not (result == k).any()] if claimed.any() else []
    if claimed.any():
        share = claimed.sum() / max(int((result > 0).sum()), 1)
        repairs.append(
            f"cells overlap in {claimed.sum()} voxels ({share:.1%} of all): each went to the cell "
            "that it lies deepest in"
        )
    if gone:
        lies = "lies" if len(gone) == 1 else "lie"
        raise InputError(
            f"{listed('cell', gone)} (counted over all layers) {lies} wholly in others: "
            "remove one of each pair"
        )
    return result


def _mask_as_cells(numbers: NDArray[np.int32], repairs: list[str]) -> NDArray[np.int32]:
    """Number the parts of the only label if several are large; else return the labels as given.

    Thresholds, and programs that write masks, give such labels; a single cell is in one part.
    """
    names = np.unique(numbers[numbers > 0])
    if len(names) != 1:
        return numbers
    parts, _ = ndimage.label(numbers)
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    large = (sizes > _SMALL_PART * sizes.max()) & (sizes >= _SPECK)
    if large.sum() < 2:
        return numbers
    few = int(np.count_nonzero(sizes) - large.sum())
    left = f", {counted(few, 'small part')} left out" if few else ""
    repairs.append(
        f"there is one label, {names[0]}, in {large.sum()} large parts, as in a mask: each was "
        f"taken for a cell{left}; give cells numbers of their own if that is wrong"
    )
    return renumbered(parts, large[1:])


def _in_one_part(numbers: NDArray[np.int32], repairs: list[str]) -> NDArray[np.int32]:
    result = numbers.copy()
    broken, large, holes, torn = [], [], [], 0
    boxes = label_boxes(numbers)
    for name, box in boxes:
        doing()
        mask = numbers[box] == name
        parts, count = ndimage.label(mask)
        if count < 2:
            continue
        sizes = np.bincount(parts.ravel())[1:]
        result[box][mask & (parts != int(sizes.argmax()) + 1)] = 0
        broken.append(name)
        torn += 2 * sizes.max() < sizes.sum()
        if np.sort(sizes)[-2] > _SMALL_PART * mask.sum():
            large.append(name)
    if 2 * torn > len(boxes):
        raise InputError(
            f"{torn} of {len(boxes)} labels are in many parts, none larger than half: is "
            "this an intensity image? If not, give each cell its own number"
        )
    # Removed fragments of other labels leave holes, too.
    for name, box in boxes:
        doing()
        mask = result[box] == name
        hole = ndimage.binary_fill_holes(mask) & (result[box] == 0)
        if hole.any():
            result[box][hole] = name
            holes.append(name)
    if broken:
        repairs.append(f"{listed('label', broken)}: in several parts; the largest was kept")
    if large:
        repairs.append(
            f"{listed('label', large)}: another large part was left out; if it is a cell, give it "
            "a number of its own"
        )
    if holes:
        repairs.append(f"{listed('label', holes)}: holes were filled")
    return result


def share_out_gaps(numbers: NDArray[Any], spacing: FloatArray, reach: float) -> NDArray[Any]:
    """Give ground in gaps up to twice the reach (found by a ball's closing) to nearest labels."""
    room = int(np.ceil(reach / spacing.min())) + 1
    ground = np.pad(numbers == 0, room, constant_values=True)
    distance, nearest = nearest_outside(ground, spacing)
    reach += _ROUNDING
    doing()
    grown = distance <= reach
    closed = distance_transform(grown, spacing) > reach
    filled = np.take(np.pad(numbers, room), nearest)
    inner = (slice(room, -room),) * 3
    shared: NDArray[Any] = np.where(closed[inner] & (numbers == 0), filled[inner], numbers)
    return shared


def _doubts(numbers: NDArray[np.int32]) -> list[str]:
    remarks = []
    border = np.zeros(numbers.shape, bool)
    for axis in range(3):
        sides = np.moveaxis(border, axis, 0)
        sides[[0, -1]] = True
    cut = [int(k) for k in np.unique(numbers[border]) if k]
    if cut:
        remarks.append(
            f"{listed('label', cut)}: cut by the border of the image; the surface is closed there"
        )
    return remarks


def _asked(numbers: NDArray[np.int32]) -> tuple[str, ...]:
    """Report labels that are hardly intended.

    A label on most of nearly every side of the image is usually the background, and a single label
    of 255 is the mask of a program, in which touching cells are one.
    """
    if set(np.unique(numbers)) <= {0, _WHITE}:
        return (
            f"the only label is {_WHITE}, as in a mask, and is taken for one cell: if there are "
            "several, give each a number of its own",
        )
    sides = [np.take(numbers, end, axis) for axis in range(3) for end in (0, -1)]
    usual = [np.unique(side, return_counts=True) for side in sides]
    most = [int(n[c.argmax()]) for n, c in usual if c.max() > _SIDE * c.sum()]
    names = [k for k in sorted(set(most)) if k > 0 and most.count(k) >= _SIDES]
    return tuple(
        f"label {k} fills {(numbers == k).mean():.0%} of the image and most of its sides: is it "
        "the background? It should be 0"
        for k in names
    )
