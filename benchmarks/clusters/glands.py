"""Two glands with labels: fits that start from labels eroded by two voxels, grown by a watershed.

The labels are a person's corrections of a segmentation, so their borders are good to about a voxel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.segmentation import watershed

from napari_deltamic import Grid
from napari_deltamic.geometry import mesh_from_labels
from napari_deltamic.geometry.labels.voxels import voxel_labels
from napari_deltamic.images.stacks import read_image

from ..default_command import fitted
from ..figure import Figure, MissingData, Options, Row, at_most

STACKS = ("gland_WT_2017-12-04_1a", "gland_WT_2018-04-10_2a")
VOXEL_SIZE = (1.0, 2.0, 2.0)  # relative
ERODED = 2  # voxels


def boundary_error(found: NDArray, truth: NDArray) -> float:
    """Mean distance between the borders of the cells of two label images, both ways.

    Border by border: a point on the border of a cell goes with the border of the same cell.
    """
    sums = count = 0.0
    boxes = ndimage.find_objects(np.maximum(truth, found))
    for name, box in enumerate(boxes, 1):
        if box is None or not ((truth[box] == name).any() and (found[box] == name).any()):
            continue
        room = tuple(slice(max(s.start - 4, 0), s.stop + 4) for s in box)
        one, other = (_border(labels[room] == name) for labels in (truth, found))
        for a, b in ((one, other), (other, one)):
            away = ndimage.distance_transform_edt(~b, VOXEL_SIZE)[a]
            sums, count = sums + float(away.sum()), count + len(away)
    return sums / count


def _border(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    border: NDArray[np.bool_] = mask & ~ndimage.binary_erosion(mask)
    return border


def eroded(labels: NDArray) -> NDArray:
    """Labels without their outermost voxels; of thin cells half of the depth is left."""
    result = np.zeros_like(labels)
    for name, box in enumerate(ndimage.find_objects(labels), 1):
        if box is None:
            continue
        deep = ndimage.distance_transform_cdt(np.pad(labels[box] == name, 1))[1:-1, 1:-1, 1:-1]
        result[box][deep > min(ERODED, deep.max() // 2)] = name
    return result


def seeded(image: NDArray, truth: NDArray) -> tuple[NDArray, NDArray]:
    """Eroded labels, and what a watershed from them finds."""
    seeds = eroded(truth)
    outside = ndimage.distance_transform_edt(truth == 0, VOXEL_SIZE) > ERODED * VOXEL_SIZE[1]
    markers = np.where(outside, truth.max() + 1, seeds)
    flooded = watershed(ndimage.gaussian_filter(image, 0.7), markers)
    flooded[flooded == truth.max() + 1] = 0
    return seeds, flooded


def gland(options: Options, name: str) -> list[Row]:
    """Error of seeds, of a watershed from them, and of the fit."""
    image, truth = stack(options, name)
    seeds, flooded = seeded(image, truth)
    grid = Grid(image.shape, VOXEL_SIZE)
    # Seeds two voxels inside thin cells are nearer to a neighbour's membrane than to their own:
    # the fit starts where they have grown to.
    start = mesh_from_labels(flooded, VOXEL_SIZE)
    outcome = fitted(image, VOXEL_SIZE, flooded)
    found = voxel_labels(outcome.mesh, grid.shape, grid.voxel_size)
    begun_at = voxel_labels(start, grid.shape, grid.voxel_size)
    errors = {
        "seeds": boundary_error(seeds, truth),
        "watershed from them": boundary_error(flooded, truth),
        "its mesh": boundary_error(begun_at, truth),
    }
    error = boundary_error(found, truth)
    rows = [Row(f"{name}, {k}, boundary error", "", v, "um", None) for k, v in errors.items()]
    bar = min(errors.values())
    return [*rows, at_most(f"{name}, fit, boundary error", bar, error, "um", outcome.note)]


def stack(options: Options, name: str) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Image and labels, numbered from 1; MissingData where they are not at hand."""
    folder = options.data / "images"
    paths = folder / f"{name}.tif", folder / f"{name}_labels.tif"
    for path in paths:
        if not path.is_file():
            raise MissingData(f"no {path.name} at {path.parent}")
    image, labels = (read_image(path)[0] for path in paths)
    names = np.unique(labels[labels > 0])
    numbers = np.where(labels > 0, np.searchsorted(names, labels) + 1, 0)
    return image.astype(np.float32), numbers.astype(np.int32)


def glands(options: Options) -> list[Row]:
    """Both stacks."""
    stacks = STACKS[:1] if options.quick else STACKS
    return [row for name in stacks for row in gland(options, name)]


FIGURES: dict[str, Figure] = {"glands": glands}
