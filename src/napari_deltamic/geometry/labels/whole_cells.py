"""Labels that mark cells, such as their nuclei, and what the image shows around them.

A label that ends where the image shows nothing, well inside a region that it does show, marks that
region: the dark inside of a membrane, or something bright (:mod:`.regions_at_points`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.segmentation import watershed

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.labels.basins import noise_after
from napari_deltamic.geometry.labels.regions_at_points import closed_regions
from napari_deltamic.geometry.mesh import FloatArray

Labels = NDArray[np.int32]
Mask = NDArray[np.bool_]
Box = tuple[slice, ...]


@dataclass(frozen=True)
class MarkerRules:
    """Which labels only mark their cells.

    Attributes
    ----------
    edge
        Of the largest contrast around a label, what its own edge has at most. Measured
        (benchmarks.defaults): 0.5 to 1.5 in 330 of 340 labels of whole cells, 0.1 to 0.5 in labels
        that reach 0.4 times as far.
    reach
        Depths of a label, so far around which that is looked for: cells 3.5 times as wide.
    layers
        In one depth, of one of which the median is one of those brightnesses; chosen.
    noise
        Standard deviations of noise that the contrast has at least; chosen.
    fewest
        Voxels of a layer that counts; chosen.
    most
        Share of the labels that do not end on an edge, from which on all are taken for markers;
        chosen.
    held
        Share of a label that lies in its region, at least; chosen.
    others
        Share of another label that the region holds, at most; chosen.
    larger
        Times the volume of the label that its region has, at least. Chosen: those of 0.85 of the
        radius are found by a fit.
    apart
        Share of the label's outermost voxels that lie within the region, not on its border.
        Chosen: labels that lack a part of their cell meet its border elsewhere.
    """

    edge: float = 0.5
    reach: float = 2.5
    layers: int = 6
    noise: float = 5.0
    fewest: int = 8
    most: float = 0.5
    held: float = 0.9
    others: float = 0.5
    larger: float = 1.5
    apart: float = 0.8


RULES = MarkerRules()


@dataclass(frozen=True, eq=False)
class _Seen:
    """An image: as it is, and smoothed; um of a voxel; and contrast that is more than noise."""

    image: FloatArray
    smooth: FloatArray
    size: FloatArray
    least: float


@dataclass(frozen=True, eq=False)
class _Label:
    """Where a label is: its box, its deepest voxel, and how deep that lies, um."""

    box: Box
    voxel: NDArray[np.intp]
    depth: float


def whole_cells(image: FloatArray, labels: Labels, size: FloatArray) -> tuple[Labels, list[int]]:
    """Labels, those that only mark a cell as large as the region that the image shows; their names.

    Parameters
    ----------
    image
        (Z, Y, X), finite.
    labels
        (Z, Y, X), 0 = outside.
    size
        (3,) um of a voxel.
    """
    data, sigma = image.astype(np.float64), float(size.min()) / size
    smooth = ndimage.gaussian_filter(data, sigma, mode="nearest")
    seen = _Seen(data, smooth, size, RULES.noise * noise_after(data, sigma))
    known = dict(_each(labels, size))
    marks = [name for name, one in known.items() if _ends_on_nothing(seen, labels, name, one)]
    asked = list(known) if len(marks) >= RULES.most * len(known) else marks
    result, changed = labels, list[int]()
    for find in (_regions, _between):
        left = {name: known[name] for name in asked if name not in changed}
        if not marks or not left:
            break
        found = find(seen, result, left)
        theirs = [name for name in left if _is_of(found, labels, name)]
        result = np.where((result == 0) & np.isin(found, theirs), found, result)
        changed += theirs
    return result, sorted(changed)


def _each(labels: Labels, size: FloatArray) -> Iterator[tuple[int, _Label]]:
    for name, box in enumerate(ndimage.find_objects(labels), 1):
        if box is not None:
            depth = _depth(labels[box] == name, size)
            deepest = np.array(np.unravel_index(depth.argmax(), depth.shape))
            yield name, _Label(box, deepest + [side.start for side in box], float(depth.max()))


def _depth(own: Mask, size: FloatArray) -> FloatArray:
    """um, of the voxels of a label, which ends where the array does."""
    depth = ndimage.distance_transform_edt(np.pad(own, 1), sampling=size)
    return np.asarray(depth[1:-1, 1:-1, 1:-1])


def _regions(seen: _Seen, labels: Labels, asked: dict[int, _Label]) -> Labels:
    """(Z, Y, X) what closes around the deepest voxel of each label."""
    voxels = np.array([one.voxel for one in asked.values()])
    try:
        return closed_regions(seen.image, seen.size, voxels, list(asked))[0]
    except InputError:
        return np.zeros_like(labels)


def _between(seen: _Seen, labels: Labels, asked: dict[int, _Label]) -> Labels:
    """(Z, Y, X) the ground of each label, up to the crests around it.

    By the watershed from markers (F. Meyer and S. Beucher, 1990), of which one is what lies far
    from all of them. It also parts cells whose wall is dim in one place.
    """
    names = list(asked)
    away = ndimage.distance_transform_edt(~np.isin(labels, names), sampling=seen.size)
    outside = away > RULES.reach * np.median([one.depth for one in asked.values()])
    far = int(labels.max()) + 1
    found: Labels = watershed(seen.smooth, np.where(outside & (labels == 0), far, labels))
    border = ndimage.grey_dilation(found, (3, 3, 3)) != ndimage.grey_erosion(found, (3, 3, 3))
    crests = np.asarray(ndimage.median(seen.smooth, np.where(border, found, 0), names))
    grounds = np.asarray(ndimage.median(seen.smooth, labels, names))
    enclosed = np.array(names)[crests - grounds > seen.least]
    return np.where(np.isin(found, enclosed), found, 0)


def _ends_on_nothing(seen: _Seen, labels: Labels, name: int, at: _Label) -> bool:
    """Whether the image changes little where a label ends, and more further out."""
    every = np.maximum(at.depth / RULES.layers / seen.size, 1).astype(int)  # few voxels tell enough
    size, reach = every * seen.size, RULES.reach * at.depth
    around = _wider(at.box, reach / seen.size, labels.shape)
    part = tuple(slice(s.start, s.stop, n) for s, n in zip(around, every.tolist(), strict=True))
    light, own, free = seen.smooth[part], labels[part] == name, labels[part] == 0
    if not own.any():
        return False
    step, inner = float(size.max()), _depth(own, size)
    outer = ndimage.distance_transform_edt(~own, sampling=size)
    core = float(np.median(light[own & (inner >= inner.max() / 2)]))

    def contrast(layer: Mask) -> float:
        few = np.count_nonzero(layer) < RULES.fewest
        return 0.0 if few else float(np.median(light[layer])) - core

    layers = (free & (outer > k) & (outer <= k + step) for k in np.arange(step, reach, step))
    most = max((contrast(layer) for layer in layers), key=abs, default=0.0)
    edge = abs(contrast(own & (inner <= step)))
    if most < 0:  # what is bright ends beyond its border, what is dark before it
        edge = max(edge, abs(contrast(free & (outer <= step))))
    return abs(most) > seen.least and edge < RULES.edge * abs(most)


def _is_of(found: Labels, labels: Labels, name: int) -> bool:
    """Whether a label lies well inside the region of its name, which is larger."""
    own, region = labels == name, found == name
    held, volume = np.count_nonzero(own & region), np.count_nonzero(own)
    gained = np.count_nonzero(region & (labels == 0))
    if held < RULES.held * volume or volume + gained < RULES.larger * volume:
        return False
    of, inside = (np.bincount(labels[m]) for m in (np.isin(labels, labels[region]), region))
    if (
        np.delete(inside, [0, name]) > RULES.others * np.delete(of[: len(inside)], [0, name])
    ).any():
        return False
    (box,) = ndimage.find_objects((own | region).astype(np.uint8))
    box = _wider(box, np.zeros(3), own.shape)
    own, region = own[box], own[box] | region[box]
    # What the border of the image cuts goes on there.
    rim, within = (ndimage.binary_erosion(m, border_value=1) for m in (own, region))
    rim = own & ~rim
    return bool(np.count_nonzero(rim & within) >= RULES.apart * np.count_nonzero(rim))


def _wider(box: Box, by: FloatArray, shape: tuple[int, ...]) -> Box:
    room = np.ceil(by).astype(int) + 1
    sides = zip(box, room.tolist(), shape, strict=True)
    return tuple(slice(max(s.start - r, 0), min(s.stop + r, n)) for s, r, n in sides)
